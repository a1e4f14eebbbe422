"""Read frequency responses, measured or computed: universal files (dataset 58), .npz, .mat, and those of hpcred.

For the arrays of .npz and .mat see files.frf_file.
"""

from pathlib import Path

import numpy as np

from ..fe.dofs import DIRECTIONS, QUANTITIES, named_quantity, quantity_name
from ..files.frf_file import FRF, QUANTITY_NUMBERS, universal
from ..files.hdf5 import HDF5
from ..files.response_file import Responses, read_responses
from ..files.system_errors import read_bytes, reading_from
from ..files.text import LARGEST_LABEL, first_bytes, require_file
from ..parallel.failures import InputError
from ..parallel.messages import printable
from ..parallel.petsc import MPI
from ..parallel.ranges import ANYTHING
from .matlab import binary, hdf5
from .matrices.npz import read_arrays
from .nodes import uff

LARGEST = ANYTHING.high  # of frequencies and responses
NAMES = ("input_names", "output_names", "node_names")
NUMBERS = {"frequencies": "fiu", "H": "fiuc", "nodes": "fiu", "positions": "fiu"}  # and their kinds
FUNCTION, LINES_ABOVE = 58, 11  # the dataset of a function, and its lines above the numbers
COLUMNS = {78: 13, 80: 20, 66: 33}  # letters of a number, or of a pair, by those of a line; others have one item
EXPECTED = "expected frequencies, H, input_names and output_names, which are texts, in MATLAB cellstr(names)"


def read_frf(path) -> Responses:
    """Return the responses of displacements in SI of a universal file, .npz, .mat or one of hpcred, with `places`:
    number and position of nodes by name, as far as they are known. On this rank. Raises InputError."""
    path = Path(path)
    require_file(path)
    ending = path.suffix.lower()
    if ending in (".unv", ".uff", ".uf"):
        responses = _read_universal(path)
    elif ending in (".npz", ".mat"):
        responses = _read_arrays(path, ending)
    elif ending in (".h5", ".hdf5"):
        responses = read_responses(path).of_forces()
        if responses.response is None:
            responses.response = responses.full if responses.reduced is None else responses.reduced
    else:
        raise InputError(f"{path}: found the ending '{ending}', expected .unv, .uff, .npz, .mat or .h5")
    F, H = responses.frequencies, responses.response
    if H is None or H.shape != (len(F), len(responses.output_names), len(responses.input_names)) or not len(F):
        shape = "none" if H is None else H.shape
        raise InputError(f"{path}: found responses {shape}, expected one for each of {len(F)} frequencies, "
                         f"{len(responses.output_names)} outputs and {len(responses.input_names)} inputs")  # fmt: skip
    if not (np.abs(F) <= LARGEST).all() or (np.diff(F) <= 0).any() or F[0] < 0:
        raise InputError(f"{path}: found frequencies that do not ascend from 0 or more, or are not finite")
    if not (np.abs([H.real, H.imag]) <= LARGEST).all():
        raise InputError(f"{path}: found responses that are not finite, or above {LARGEST:g}")
    return _displacements(responses, path)


def _displacements(data, path) -> Responses:
    """Return responses of velocities and accelerations as those of displacements."""
    for name in (*data.input_names, *data.output_names, *(data.places or {})):
        if not (name and name.isprintable()):
            raise InputError(f"{path}: found the name '{printable(name)[:40]}' with signs that are no letters, "
                             "expected such as foot:z")  # fmt: skip
    order = [QUANTITIES.index(named_quantity(name)[0]) for name in data.output_names]
    names = tuple(named_quantity(name)[1] for name in data.output_names)
    if any(order) and data.frequencies[0] == 0:
        data.frequencies, data.response = data.frequencies[1:], data.response[1:]  # which tell nothing of rest
    s = 2j * np.pi * data.frequencies
    with np.errstate(all="ignore"):
        H = data.response / s[:, None, None] ** np.array(order)[:, None] if any(order) else data.response
    if not len(H) or not np.isfinite(H).all():
        raise InputError(f"{path}: found velocities or accelerations that no displacements belong to, at "
                         f"{data.frequencies[0] if len(H) else 0:g} Hz and above")  # fmt: skip
    if len(set(names)) < len(names) or len(set(data.input_names)) < len(data.input_names):
        raise InputError(f"{path}: found an output or an input twice, expected each once")
    return Responses(frequencies=data.frequencies, input_names=data.input_names, output_names=names, response=H,
                     places=data.places)  # fmt: skip


def _read_arrays(path, ending) -> Responses:
    data = read_arrays(path, (*NUMBERS, *NAMES)) if ending == ".npz" else _of_matlab(path)
    if missing := [key for key in ("frequencies", "H", "input_names", "output_names") if key not in data]:
        raise InputError(f"{path}: found no {missing[0]}, {EXPECTED}")
    names = {key: _texts(path, key, data[key]) for key in NAMES if key in data}
    for key, kinds in NUMBERS.items():
        if key in data and data[key].dtype.kind not in kinds:
            raise InputError(f"{path}: found {key} of the type {data[key].dtype}, expected "
                             f"{'' if 'c' in kinds else 'real '}numbers")  # fmt: skip
    F, H = np.ravel(data["frequencies"]).astype(float), np.asarray(data["H"], dtype=complex)
    shape = len(F), len(names["output_names"]), len(names["input_names"])
    if H.ndim < 3 and H.size == np.prod(shape) and (len(H) == len(F) or H.size == len(F)):  # one input or one output
        H = H.reshape(shape)
    places = {}
    if {"node_names", "nodes", "positions"} <= data.keys():
        numbers, positions = np.ravel(data["nodes"]), np.atleast_2d(data["positions"]).astype(float)
        if not len(names["node_names"]) == len(numbers) == len(positions) or positions.shape[1:] != (3,):
            raise InputError(f"{path}: found {len(names['node_names'])} node_names, {len(numbers)} nodes and positions "
                             f"{positions.shape}, expected as many of each, (k, 3)")  # fmt: skip
        if not ((np.abs(numbers) <= LARGEST_LABEL) & (numbers == np.floor(numbers))).all() or np.isinf(positions).any():
            raise InputError(f"{path}: found nodes that are no whole numbers, or positions that are infinite")
        rows = zip(names["node_names"], numbers.tolist(), positions, strict=True)
        places = {name: (int(number), place) for name, number, place in rows}
    return Responses(frequencies=F, response=H, input_names=names["input_names"], output_names=names["output_names"],
                     places=places)  # fmt: skip


def _of_matlab(path) -> dict:
    if (start := first_bytes(path)).startswith(HDF5) or hdf5.begins(start):
        raise InputError(f"{path}: found a MATLAB file of version 7.3, expected one that save wrote with '-v7'")
    numbers, texts = binary.arrays(path, (*NUMBERS, *NAMES))
    return numbers | {key: np.array(words) for key, words in texts.items()}


def _texts(path, key, array) -> tuple[str, ...]:
    """Return the names in an array. Raises InputError where they are no texts."""
    if array.dtype.kind not in "US":
        raise InputError(f"{path}: found {key} of the type {array.dtype}, {EXPECTED}")
    return tuple((name.decode(errors="replace") if isinstance(name, bytes) else str(name)).strip()
                 for name in np.ravel(array))  # fmt: skip


def _read_universal(path) -> Responses:
    pyuff = universal()
    there = []
    for number, start, stop in uff.datasets(path, MPI.COMM_SELF):
        there.append(number)
        if number == FUNCTION:
            _require_columns(path, start, stop)
    try:
        with reading_from(path):
            sets = pyuff.UFF(str(path)).read_sets()
        sets = sets if isinstance(sets, list) else [sets]
        return _responses(path, sets, there)
    except InputError:
        raise
    except Exception as error:  # pyuff believes what damaged files say of themselves
        raise InputError(f"{path}: cannot be read ({str(error)[:80]}), expected a universal file with datasets 58"
                         ) from error  # fmt: skip


def _require_columns(path, start, stop):
    """Raise InputError where lines of numbers of a function of text have lost letters, which shifts their columns."""
    if b"\0" in (text := read_bytes(path, start, stop)):  # binary
        return
    *lengths, last = [len(line.rstrip()) for line in text.splitlines()[LINES_ABOVE:] if line.strip()] or [0]
    full = lengths[0] if lengths else last
    if len(set(lengths)) > 1 or last > full or last % COLUMNS.get(full, full or 1):
        wrong = next((k for k, length in enumerate(lengths) if length != full), len(lengths))
        raise InputError(f"{path}: found lines of numbers of different lengths in a function, at line {wrong + 1} of "
                         "them, expected columns; the file is damaged")  # fmt: skip


def _responses(path, sets, there) -> Responses:
    """Return the responses of the datasets that pyuff found, of those that are `there`."""
    if (read := [int(record["type"]) for record in sets]) != there:
        raise InputError(f"{path}: found the datasets {', '.join(map(str, there))}, of which {len(read)} can be read; "
                         "expected lines of four blanks and -1 around each")  # fmt: skip
    functions = [record for record in sets if record["type"] == 58 and record.get("func_type") == FRF]
    if not functions:
        raise InputError(f"{path}: found no frequency response (dataset 58, function 4), expected one for each pair")
    units = {(record["force"], record["length"]) for record in sets if record["type"] == 164} or {(1.0, 1.0)}
    if len(units) > 1 or not all(0 < value < np.inf for value in min(units)):
        raise InputError(f"{path}: found units (dataset 164) that are no numbers, or that differ; expected one of SI")
    ((force, length),) = units  # of the file in one of SI
    # one response for each pair, on the same lines
    F, columns = np.asarray(functions[0]["x"], dtype=float), {}
    for record in functions:
        if not len(record["x"]) == len(record["data"]) == record["num_pts"]:
            raise InputError(f"{path}: found {len(record['data'])} numbers of a response, expected "
                             f"{record['num_pts']} as it says; the file is damaged")  # fmt: skip
        if len(record["x"]) != len(F) or not np.allclose(record["x"], F, rtol=1e-6, atol=1e-9 * F[-1]):
            raise InputError(f"{path}: found responses at different frequencies, expected the same in all")
        signs = [np.sign(record[key]) or 1 for key in ("rsp_dir", "ref_dir")]
        output, input_ = (_name(record, key, path) for key in ("rsp", "ref"))
        number = int(record.get("ordinate_spec_data_type") or 0)
        if number not in QUANTITY_NUMBERS:
            raise InputError(f"{path}: found a response of the quantity {number}{' (unknown)' * (not number)}, "
                             "expected displacements (8), velocities (11) or accelerations (12); export it with its "
                             "quantity, or as .npz with names such as 'acceleration 20:z'")  # fmt: skip
        output = quantity_name(QUANTITIES[QUANTITY_NUMBERS.index(number)], output)
        if (output, input_) in columns:
            raise InputError(f"{path}: found the response {output}/{input_} twice, expected each once; keep one")
        # rotations and moments have other units of length
        turns, moment = (abs(int(record[key])) > 3 for key in ("rsp_dir", "ref_dir"))
        factor = force * length ** (moment - (not turns))
        columns[output, input_] = np.asarray(record["data"], dtype=complex) * factor * signs[0] * signs[1]
    outputs, inputs = (tuple(dict.fromkeys(pair[k] for pair in columns)) for k in (0, 1))
    lacking = [f"{j}/{i}" for j in outputs for i in inputs if (j, i) not in columns]
    if lacking:
        raise InputError(f"{path}: found no response {lacking[0]}, expected one for each pair of {len(outputs)} "
                         f"outputs and {len(inputs)} inputs; {len(lacking)} are missing")  # fmt: skip
    H = np.array([[columns[j, i] for i in inputs] for j in outputs]).transpose(2, 0, 1)
    # places of nodes, by the names that the responses have
    where, places = {}, {}
    if set(there) & uff.NODE_LINES.keys():
        nodes = uff.read(path, MPI.COMM_SELF).nodes
        where = dict(zip(nodes.label.tolist(), nodes.position / length, strict=True))
    for record in functions:
        for key in ("rsp", "ref"):
            number = int(record[f"{key}_node"])
            if number in where:
                places[_name(record, key, path).rpartition(":")[0]] = (number, where[number])
    return Responses(frequencies=F, response=H, input_names=inputs, output_names=outputs, places=places)


def _name(record, key, path) -> str:
    """Return the name of the output or input of a dataset 58: its entity, or else its node, and its direction."""
    direction = abs(int(record[f"{key}_dir"]))
    if not 1 <= direction <= 6:
        raise InputError(f"{path}: found the direction {record[f'{key}_dir']}, expected 1 to 6 for x to rz")
    entity = str(record.get(f"{key}_ent_name", "NONE")).strip()
    node = entity if entity not in ("", "NONE") else str(int(record[f"{key}_node"]))
    return f"{node}:{DIRECTIONS[direction - 1]}"


