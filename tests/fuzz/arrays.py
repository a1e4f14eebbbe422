"""Matrices in files of arrays (SciPy's .npz, PETSc binary, MATLAB 7.3), one array or some bytes of them damaged.

The second readings are those of numpy, h5py and struct, of all arrays as a whole, with the rules of the formats.
"""

import io
import struct
import warnings
import zipfile

import h5py
import numpy as np

from . import readings
from .judge import Case
from .matrices import chosen, labels_of, matrix, model_numbers, places, require_places
from .mutations import bytes_changed
from .readings import Nonsense, require

MATLAB = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created by: a test".ljust(116) + bytes(8) + b"\0\2IM"
COMPRESSED = {"csr": ("indptr", "indices"), "csc": ("indptr", "indices"), "coo": ("row", "col")}


def pieces(item, form, rng=None):
    """The arrays of a sparse matrix by scipy's names; those of COO in any order."""
    turned = item.T if form == "csc" else item
    i, j = np.nonzero(turned)
    order = rng.permutation(len(i)) if form == "coo" and rng is not None else np.arange(len(i))
    if form == "coo":
        return {"row": i[order], "col": j[order], "data": item[i, j][order]}
    starts = np.searchsorted(i, np.arange(len(turned) + 1))
    return {"indptr": starts, "indices": j, "data": turned[i, j]}


def from_pieces(form, shape, arrays, ascending=False):
    """The matrix of such arrays; raises Nonsense where they do not fit each other. `ascending`: as MATLAB has it."""
    first, second = (np.asarray(arrays[name]) for name in COMPRESSED[form])
    data = np.asarray(arrays["data"])
    require(all(item.ndim == 1 and item.dtype.kind in "iu" for item in (first, second)), "no whole numbers")
    require(data.ndim == 1 and data.dtype.kind in "fiu" and len(second) == len(data), "no numbers, or not as many")
    require(all(0 < size < 10**4 for size in shape), "a size that no file of a test has")
    lines, across = shape[::-1] if form == "csc" else shape
    first, second = ([int(number) for number in item] for item in (first, second))
    if form != "coo":
        require(len(first) == lines + 1 and first[0] == 0 and first[-1] == len(data) and sorted(first) == first,
                "starts that do not ascend to the number of entries")  # fmt: skip
        if ascending:
            require(all(second[k] < second[k + 1] for low, high in zip(first, first[1:], strict=False)
                        for k in range(low, high - 1)), "an order that MATLAB does not have")  # fmt: skip
        first = [k for k in range(lines) for _ in range(first[k + 1] - first[k])]
    require(len(first) == len(data), "another number of entries")
    entries = [(i + 1, j + 1, float(value)) for i, j, value in zip(first, second, data, strict=True)]
    require(all(np.isfinite(value) for _, _, value in entries), "a value that is no number")
    found = readings.dense((lines, across), entries)
    return found.T if form == "csc" else found


def npz(form, shape, arrays, rng):
    """scipy.sparse.save_npz of the arrays, those that are None left out."""
    file = io.BytesIO()
    arrays = {"format": np.array(form.encode()), "shape": np.array(shape), **arrays}
    save = chosen(rng, np.savez, np.savez_compressed)
    save(file, **{name: array for name, array in arrays.items() if array is not None})
    return file.getvalue()


def with_another(content, name, rng):
    """A note, and the archive with a second array of a name, in reverse order, which zipfile takes for the first."""
    file, array = io.BytesIO(content), io.BytesIO()
    np.save(array, np.load(io.BytesIO(content))[name][::-1])
    with zipfile.ZipFile(file, "a") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        archive.writestr(f"{name}.npy", array.getvalue())
    return f"{name} twice", file.getvalue()


def read_npz(content: bytes):
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            require(len(set(archive.namelist())) == len(archive.namelist()), "an array twice")
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            form = file["format"][()]
            form = form.decode() if isinstance(form, bytes) else str(form)
            shape = file["shape"]
            require(form in COMPRESSED and shape.dtype.kind in "iu" and shape.shape == (2,), "no matrix")
            shape = tuple(int(number) for number in shape)
            return from_pieces(form, shape, {name: file[name] for name in (*COMPRESSED[form], "data")})
    except Nonsense:
        raise
    except Exception as error:  # whatever numpy and zipfile say of damage
        raise Nonsense(str(error)) from error


def petsc(form, shape, arrays, rng):
    """PETSc's binary file of the arrays, whatever they are."""
    lengths, columns, data = (np.ravel(arrays[name]).real if arrays[name] is not None else np.zeros(0)
                              for name in ("indptr", "indices", "data"))  # fmt: skip
    lengths = np.diff(lengths.astype(np.int64))
    head = np.array([1211216, *shape, len(data)])
    return b"".join(part.astype(kind).tobytes() for part, kind in (
        (head, ">i4"), (lengths, ">i4"), (columns, ">i4"), (data, ">f8")))  # fmt: skip


def read_petsc(content: bytes):
    require(len(content) >= 16, "no header")
    number, rows, columns, count = struct.unpack(">4i", content[:16])
    require(number == 1211216 and min(rows, columns, count) >= 0, "no sparse matrix")
    require(len(content) == 16 + 4 * rows + 12 * count, "another size")
    parts = np.split(np.frombuffer(content[16 : 16 + 4 * (rows + count)], ">i4"), [rows])
    require((parts[0] >= 0).all(), "a length below zero")
    arrays = {"indptr": np.append(0, np.cumsum(parts[0], dtype=np.int64)), "indices": parts[1],
              "data": np.frombuffer(content[16 + 4 * (rows + count) :], ">f8")}  # fmt: skip
    return from_pieces("csr", (rows, columns), arrays)


def one_wrong(arrays, rng):
    """A note, and a copy of the arrays with one of them wrong: too short, too long, of two dimensions, of another type,
    missing, or with one number changed."""
    name = chosen(rng, *arrays)
    array = np.array(arrays[name])
    how = chosen(rng, "short", "long", "2-d", "type", "missing", "number", "number", "number", "exchange", "empty")
    if how in ("number", "exchange") and array.size:
        at, other = (int(k) for k in rng.integers(array.size, size=2))
        array[at], array[other] = array[other], array[at]
        if how == "number":
            array[at] = chosen(rng, -1, 0, array[at] + 1, len(array), 2**31 - 1, 99)
            if array.dtype.kind == "f" and rng.random() < 0.6:
                array[at] = chosen(rng, np.nan, np.inf, -np.inf, 1e300, 1e59, 5e-324)
    array = {
        "short": lambda: array[: int(rng.integers(array.size or 1))], "long": lambda: np.append(array, array[-1:]),
        "2-d": lambda: array[None], "missing": lambda: None, "empty": lambda: array[:0],
        "type": lambda: array.astype(chosen(rng, "c16", "?", "S8", "f8", "f4", "i8", "u1", ">i4")),
    }.get(how, lambda: array)()  # fmt: skip
    return f"{how} {name}", {**arrays, name: array}


def matlab(variables):
    """A .mat file of version 7.3: (form, shape, arrays) are sparse matrices, arrays dense ones."""
    memory = io.BytesIO()
    with h5py.File(memory, "w", userblock_size=512) as file:
        for name, value in variables.items():
            if not isinstance(value, tuple):
                file[name] = np.asarray(value, float).T
                file[name].attrs["MATLAB_class"] = np.array(b"double")
                continue
            _, shape, arrays = value
            group = file.create_group(name)
            group.attrs["MATLAB_class"] = np.array(b"double")
            group.attrs["MATLAB_sparse"] = np.uint64(shape[0])
            for key, name_of_scipy in (("jc", "indptr"), ("ir", "indices"), ("data", "data")):
                if (array := arrays[name_of_scipy]) is not None:
                    whole = array.dtype.kind == "i" and array.min(initial=0) >= 0
                    group[key] = array.astype("u8") if whole else array
    return MATLAB + memory.getvalue()[128:]


def read_matlab(content: bytes):
    """Dense matrices by name."""
    found = {}
    with h5py.File(io.BytesIO(content)) as file:
        for name, item in sorted(file.items(), key=lambda pair: pair[0] == "D"):
            if isinstance(item, h5py.Dataset):
                require(item.ndim == 2 and item.dtype.kind == "f" and np.isfinite(item[...]).all(), "no matrix")
                found[name] = item[...].T
                continue
            arrays = {key: item[part][...] for key, part in (("indptr", "jc"), ("indices", "ir"), ("data", "data"))}
            shape = int(item.attrs["MATLAB_sparse"]), len(arrays["indptr"]) - 1
            for key in ("indices", "data"):  # MATLAB may keep room for more
                count = arrays["indptr"][-1]
                require(count.dtype.kind in "iu" and 0 <= count <= len(arrays[key]), "too few numbers")
                arrays[key] = arrays[key][:count]
            if name != "D" or shape == found["K"].shape:  # any variable of another size may have that name: it is said
                found[name] = from_pieces("csc", shape, arrays, ascending=True)
    return found


def single(rng, kind):
    """One of K, M and D damaged: an array wrong, or bytes of the file."""
    write, read = {".npz": (npz, read_npz), "PETSc binary": (petsc, read_petsc)}[kind]
    mats = {key: matrix(rng, symmetric=key != "D") for key in chosen(rng, "KM", "KMD")}
    role, note, files = chosen(rng, *mats), "good", {}
    for key, item in mats.items():
        form = chosen(rng, *COMPRESSED) if kind == ".npz" else "csr"
        shape, arrays = item.shape, pieces(item, form, rng)
        damage = chosen(rng, "array", "array", "shape", "bytes", "bytes", "twice", "none") if key == role else "none"
        if damage == "array":
            note, arrays = one_wrong(arrays, rng)
        elif damage == "shape":
            shape = chosen(rng, (9, 8), (10, 9), (0, 9), (9, 2**31 - 1), (-9, 9), (9, 10))
            note = f"shape {shape}"
        files[f"{key}.file"] = write(form, shape, arrays, rng)
        if damage == "twice" and kind == ".npz":
            note, files[f"{key}.file"] = with_another(files[f"{key}.file"], chosen(rng, *arrays), rng)
        elif damage == "bytes":
            note, files[f"{key}.file"] = bytes_changed(files[f"{key}.file"], rng)
    command = ["convert", *(word for key in mats for word in (f"-{key}", f"{key}.file")), "-o", "m.h5"]

    def second():
        return readings.model({key: read(files[f"{key}.file"]) for key in mats})

    return finished(f"{role}: {note}", files, command, second, note == "good")


def finished(note, files, command, second, good):
    try:
        with np.errstate(all="ignore"):
            expected = second()
    except Nonsense:
        expected = None
    assert expected is not None or not good, note
    return Case(note, files, command, expected, model_numbers, good)


def written(table):
    """A text with the numbers of a table."""
    return b"".join(b" ".join(repr(float(number)).encode() for number in row) + b"\n" for row in table)


def matlab_hdf5(rng, kind):
    """K and M, perhaps D, nodes and dofs in one file; an array is wrong."""
    where = places(rng)
    labels = labels_of(where, rng)
    variables = {key: matrix(rng) for key in chosen(rng, "KM", "KMD")}
    note = "good"
    if rng.random() < 0.6:
        variables["nodes"] = np.array([(node, *place) for node, place in where.items()])
        variables["dofs"] = np.array(labels)
    wrong = chosen(rng, *variables, "none")
    for name in "KMD":
        if name in variables and rng.random() < 0.8:
            arrays = pieces(variables[name], "csc")
            if name == wrong:
                note, arrays = one_wrong(arrays, rng)
                if arrays["data"] is not None and arrays["data"].dtype.kind == "i":
                    arrays["data"] = arrays["data"].astype(float)
            variables[name] = ("csc", (9, 9), arrays)
    if wrong in ("nodes", "dofs") and wrong in variables:
        table = variables[wrong].astype(float)
        at = tuple(int(rng.integers(size)) for size in table.shape)
        table[at] = value = chosen(rng, 0, -1, 1.5, 2**31, np.nan, np.inf, 7, 1e30, table[0, at[1]])
        variables[wrong], note = table, f"{wrong}{list(at)} = {value}"
    content = matlab(variables)

    def second():
        try:
            found = read_matlab(content)
        except Nonsense:
            raise
        except Exception as error:
            raise Nonsense(str(error)) from error
        labels = rows = None
        if "nodes" in found:
            labels = readings.nodes(written(found["nodes"]))
            require_places(labels)
            rows = readings.row_labels(written(found["dofs"]))
        return readings.model({key: found[key] for key in "KMD" if key in found}, rows, labels, np.inf)

    return finished(note, {"a.mat": content}, ["convert", "a.mat", "m.h5"], second, note == "good")


KINDS = {".npz": single, "PETSc binary": single, "MATLAB 7.3": matlab_hdf5}
