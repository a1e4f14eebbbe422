"""Damage of every kind to every dataset of every file is refused in a sentence; parts are checked as the whole is."""

import shutil

import h5py
import numpy as np
import pytest
import xxhash
from helpers import SIMULATION, bar, reduce_linkage

import hpcred
from hpcred.cli.main import run
from hpcred.files import checksums, model_file, motion_file, opened_hdf5, response_file, result_file
from hpcred.files.checked import CheckedFile
from hpcred.files.checksums import ROWS_OF_SUM, sums_of, sums_of_parts, tag_of
from hpcred.files.hdf5 import reading, writing
from hpcred.files.response_file import read_responses
from hpcred.parallel.failures import ComputationError, InputError
from hpcred.parallel.shares import row_range
from hpcred.workflows.info_of_output import OUTPUTS, read_whole, verify_file

ROOMS = {"model.h5": model_file, "result.h5": result_file, "e.h5": response_file, "simulation.h5": motion_file}
SMALL_JOB = """
model = "model.h5"
output = "result.h5"
inputs = [[2, "z"]]
[frame]
kind = "tangent"
node = 1
[[basis]]
kind = "modes"
index = [1, 2]
"""
SMALL_MOTION = 'body = "result.h5"\nend = 0.001\nsteps = 1\nobserve = [2]\n'


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    reduce_linkage(folder)
    (folder / "sim.toml").write_text(SIMULATION.replace("end = 0.05", "end = 0.002").replace("steps = 20", "steps = 2"))
    assert run(["simulate", str(folder / "sim.toml")]) == 0
    assert run(["evaluate", str(folder / "result.h5"), "--points", "3", "-o", str(folder / "e.h5")]) == 0
    return folder


@pytest.fixture
def files(made, tmp_path):
    """A folder with a model, a result, responses and a simulation."""
    for path in made.glob("*.h5"):
        shutil.copy(path, tmp_path)
    return tmp_path


def read(path):
    """Read a file as the commands do."""
    if path.name == "model.h5":
        hpcred.read_model(path).close()
    elif path.name == "result.h5":
        result = hpcred.read_result(path)
        result.body([10])
        with result.shapes() as shapes:
            for column in range(result.reduced.size):
                shapes.displacement(column)
    elif path.name == "e.h5":
        read_responses(path)
    else:
        read_whole(OUTPUTS["hpcred-simulation"], path, None)


READ = (
    "matrices/K", "matrices/indices", "dofs/position", "reduced/K", "basis/V", "record", "interface/phi",
    "floating_frame/Ct", "frequencies", "t", "provenance", "nodes/displacement",
)  # fmt: skip


def flip(file, name):
    raw = file[name].id
    values = np.array(file[name][()])
    bits = values.reshape(-1).view("u1")
    bits[len(bits) // 2] ^= 16
    raw.write(h5py.h5s.ALL, h5py.h5s.ALL, values)


def replaced(change):
    def damage(file, name):
        values = change(np.asarray(file[name][()], file[name].dtype))
        del file[name]
        file[name] = values

    return damage


def remove(file, name):
    del file[name]


def link(file, name):
    del file[name]
    file[name] = h5py.ExternalLink("elsewhere.h5", "/x")


def exchange(file, name):
    """The first and the last number change places."""
    values = np.array(file[name][()])
    if values.size < 2 or values.reshape(-1)[0] == values.reshape(-1)[-1]:
        return flip(file, name)
    flat = values.reshape(-1)
    flat[[0, -1]] = flat[[-1, 0]]
    file[name].write_direct(values)
    return None


DAMAGES = {
    "flipped": flip,
    "longer": replaced(lambda values: np.concatenate([np.atleast_1d(values)] * 2)),
    "of another type": replaced(lambda v: v.view("i8") if v.dtype == "f8" and v.ndim else np.array(b"x")),
    "missing": remove,
    "a link": link,
    "exchanged": exchange,
}


@pytest.mark.parametrize("name", ["model.h5", "e.h5", *(pytest.param(name, marks=pytest.mark.slow)
                                                      for name in ("result.h5", "simulation.h5"))])  # fmt: skip
def test_damage_to_every_dataset_is_refused(files, name):
    read(files / name)
    assert verify_file(files / name)["verified_datasets"] >= 5
    with h5py.File(files / name) as file:
        datasets = []
        file.visititems(lambda key, item: datasets.append(key) if isinstance(item, h5py.Dataset) else None)
    own = [key for key in datasets if not key.startswith("checksums/")]
    assert len(datasets) == 2 * len(own)
    (files / "bad").mkdir()
    bad, unseen = files / "bad" / name, []
    for turn, key in enumerate(datasets):
        # each kind of damage meets every sixth dataset, and every other sum
        kind = [*DAMAGES][turn % len(DAMAGES)] if key in own else ("flipped", "missing")[turn % 2]
        shutil.copy(files / name, bad)
        with h5py.File(bad, "a") as file:
            if not file[key].size:
                continue
            DAMAGES[kind](file, key)
        try:
            verify_file(bad)
            unseen.append(f"{key} {kind}")
        except InputError as error:
            assert str(bad) in str(error) and "damaged" in str(error)
        if key in READ:  # the last damage, as the commands meet it
            with pytest.raises(InputError):
                read(bad)
    assert not unseen


@pytest.mark.parametrize("name", ["format", "version", "size", "rows_per_block", "loss_factor", "xxh3"])
def test_damage_to_attributes_is_refused(files, name):
    for path in (files / "model.h5", files / "result.h5"):
        with h5py.File(path, "a") as file:
            if name not in file.attrs:
                continue
            file.attrs[name] = file.attrs[name] + 1 if name != "format" else "hpcred-modem"
        with pytest.raises(InputError):
            read(path)


@pytest.fixture(scope="module")
def small(tmp_path_factory, comm):
    """A model of 12 dofs, its result, responses and a simulation: few bytes."""
    folder = tmp_path_factory.mktemp("small")
    with bar(comm, 1.0, 1) as model:
        hpcred.write_model(folder / "model.h5", model)
    (folder / "job.toml").write_text(SMALL_JOB)
    (folder / "sim.toml").write_text(SMALL_MOTION)
    assert run(["reduce", str(folder / "job.toml")]) == 0
    assert run(["simulate", str(folder / "sim.toml")]) == 0
    assert run(["evaluate", str(folder / "result.h5"), "--frequencies", "10,20", "-o", str(folder / "e.h5")]) == 0
    return folder


def everything(path):
    """All that the commands can read of a file."""
    room = ROOMS[path.name]
    with reading(path, room.FORMAT, room.VERSION, room.SCHEMA) as file:
        return {name: (item.shape, item[...].tobytes()) for name, item in file.datasets.items()} | {
            key: str(value) for key, value in file.attrs.items()}  # fmt: skip


@pytest.mark.parametrize("name", ROOMS)
@pytest.mark.parametrize("count", [7, pytest.param(None, marks=pytest.mark.slow)])
def test_bytes_anywhere_in_a_file_are_refused_or_of_no_account(small, tmp_path, name, count):
    """One bit of every byte (of `count` bytes) turned, and the file cut there: what is read is the same, or nothing."""
    whole, expected, path = (small / name).read_bytes(), everything(small / name), tmp_path / name
    taken = []
    for place in range(0, len(whole), 1 if count is None else len(whole) // count):
        turned = bytearray(whole)
        turned[place] ^= 1 << place % 8
        for kind, bad in (("turned", turned), ("cut", whole[:place])):
            path.write_bytes(bad)
            try:
                found = everything(path)
            except InputError as error:
                assert str(error).startswith(str(path)) and "\n" not in str(error)
            else:
                assert found == expected, (place, kind)
                taken.append(place)
    first, last = whole.rindex(b'{"data": '), len(whole)
    assert all(first <= place < last for place in taken)  # the seal itself, without which the file is as good


def test_sealed_files_need_no_other_process_and_others_one_each(files, monkeypatch):
    """A process reads a file without a seal before HDF5 does, once however often it is opened."""
    begun, plain = [], opened_hdf5.subprocess.run
    monkeypatch.setattr(opened_hdf5.subprocess, "run", lambda *args, **how: begun.append(args) or plain(*args, **how))
    for name in ROOMS:
        read(files / name)
    assert not begun
    with h5py.File(files / "result.h5", "r+") as file:  # takes the seal off
        del file.attrs["xxh3"]
    for _ in range(3):
        read(files / "result.h5")
    assert len(begun) == 1


def test_files_of_before_there_were_checksums_are_read(files, capsys):
    for name in ("model.h5", "result.h5", "e.h5", "simulation.h5"):
        with h5py.File(files / name, "a") as file:
            del file.attrs["xxh3"], file["checksums"]
        read(files / name)
        with pytest.raises(InputError, match="has no checksums, or other ones, made by an older hpcred"):
            verify_file(files / name)


def test_other_sums_of_earlier_files_are_not_looked_at(files):
    for name in ("model.h5", "result.h5"):
        with h5py.File(files / name, "a") as file:
            key = "matrices/K" if name == "model.h5" else "reduced/K"
            file.attrs["checksum"] = 12345
            del file.attrs["xxh3"]
            file[f"checksums/{key}"][...] = 1
        read(files / name)
        with pytest.raises(InputError, match="made by an older hpcred"):
            verify_file(files / name)


def test_shapes_of_files_without_checksums_are_checked(files):
    with h5py.File(files / "model.h5", "a") as file:
        del file.attrs["xxh3"], file["checksums"], file["dofs/node"]
        file["dofs/node"] = np.arange(7)
    with pytest.raises(InputError, match=r"/dofs/node is int64 of shape \(7,\), expected integer of shape \(120,\)"):
        read(files / "model.h5")


def write_rows(path, comm, arrays):
    """Arrays by name, each with the axis whose rows are shared out to the ranks."""
    with writing(path, comm) as file:
        file.attribute("format", "test")
        for name, (array, axis) in arrays.items():
            low, high = row_range(comm, array.shape[axis])
            file.rows(name, np.take(array, np.arange(low, high), axis=axis), axis=axis)


@pytest.mark.mpi
def test_sums_do_not_depend_on_ranks(comm, folder):
    """Parts of rows on any ranks, numbers of one word and of several, and chunks with rows of several ranks."""
    draw = np.random.default_rng(4)
    arrays = {
        "line": (draw.normal(size=3 * ROWS_OF_SUM + 5), 0), "wide": (draw.normal(size=(3, 2 * ROWS_OF_SUM + 1)), 1),
        "points": (draw.normal(size=(ROWS_OF_SUM + 7, 3)), 0), "small": (np.arange(2, dtype=np.int32), 0),
        "complex": (draw.normal(size=(40, 2)) + 1j, 0), "none": (np.zeros((0, 4)), 0),
    }  # fmt: skip
    write_rows(folder / "a.h5", comm, arrays)
    with reading(folder / "a.h5", "test") as file:
        assert file.verify() == len(arrays)
        for name, (array, axis) in arrays.items():
            with h5py.File(folder / "a.h5") as plain:
                sums = plain[f"checksums/{name}"][...]
            assert (sums == sums_of(array, axis, tag_of(array.dtype, array.shape, axis))).all()
            assert (file[name][...] == array).all()
        line, wide, end = file["line"], file["wide"], 2 * ROWS_OF_SUM
        assert (line[1000:end] == arrays["line"][0][1000:end]).all() and line[5:5].size == 0
        assert (line[np.array([end + 9, 2, ROWS_OF_SUM])] == arrays["line"][0][[end + 9, 2, ROWS_OF_SUM]]).all()
        assert (wide[:, 7 : end - 5] == arrays["wide"][0][:, 7 : end - 5]).all()
        assert (wide[2] == arrays["wide"][0][2]).all() and (wide[:, end] == arrays["wide"][0][:, end]).all()
        assert (wide[:, np.array([3, end])] == arrays["wide"][0][:, [3, end]]).all()
    comm.Barrier()


@pytest.mark.mpi
def test_chunks_with_rows_of_several_ranks_are_sent_in_parts(comm, monkeypatch):
    """Also where ranks have no rows, one, or whole chunks only: the sums are those of one rank."""
    monkeypatch.setattr(checksums, "MESSAGE", 1)  # line by line
    whole = np.random.default_rng(7).normal(size=(5, 2 * ROWS_OF_SUM + 3, 2))
    alone = sums_of(whole, 1, 9)
    total = whole.shape[1]
    for ends in ([0, 0, total], [1, 2, total], [ROWS_OF_SUM, ROWS_OF_SUM, total], [5, total - 1, total], [total] * 3):
        bounds = [0, *ends[: comm.size - 1], total]
        low, high = bounds[comm.rank], bounds[comm.rank + 1]
        found = sums_of_parts(comm, whole[:, low:high], 1, low, 9)
        assert (found == alone[:, -(-low // ROWS_OF_SUM) : -(-high // ROWS_OF_SUM)]).all()
        assert found.shape == (5, -(-high // ROWS_OF_SUM) + -low // ROWS_OF_SUM)


def test_sums_are_hashes_of_the_bytes_of_chunks():
    """As another program would compute them; and the hash is XXH3, by the value that its authors give for no bytes."""
    array = np.random.default_rng(8).normal(size=(2, ROWS_OF_SUM + 3, 3)).astype("f4")
    found = sums_of(array, 1, 12345)
    for line in range(2):
        for chunk, content in enumerate((array[line, :ROWS_OF_SUM], array[line, ROWS_OF_SUM:])):
            assert found[line, chunk] == xxhash.xxh3_64(content.tobytes()).intdigest() ^ 12345
    assert sums_of(np.zeros((1, 0)), 0, 0).tolist() == [[0x2D06800538D394C2]]


def test_a_changed_bit_changes_the_sum():
    """Also the highest bit of a word alone, those of two words, and two words that are exchanged."""
    values = np.arange(ROWS_OF_SUM, dtype=np.uint64)
    before, highest = sums_of(values, 0, 1), np.uint64(1) << np.uint64(63)
    for bit in range(64):
        changed = values.copy()
        changed[77] ^= np.uint64(1) << np.uint64(bit)
        assert sums_of(changed, 0, 1) != before
    changed = values.copy()
    changed[[3, 4]] = changed[[4, 3]]
    assert sums_of(changed, 0, 1) != before
    changed = values.copy()
    changed[[5, 900]] ^= highest
    assert sums_of(changed, 0, 1) != before


def test_damage_to_several_words_changes_the_sum():
    """Two to five words of a chunk, each by one bit, the same bit for all, or to 0: none of 3,000 goes unseen."""
    draw = np.random.default_rng(5)
    values = draw.normal(size=ROWS_OF_SUM).view(np.uint64)
    before, unseen = sums_of(values, 0, 1), 0
    for number in range(3000):
        places = draw.choice(ROWS_OF_SUM, 2 + number % 4, replace=False)
        changed = values.copy()
        if number % 3 == 2:
            changed[places] = 0
        else:
            changed[places] ^= np.uint64(1) << draw.integers(0, 64, len(places) if number % 3 else 1, np.uint64)
        unseen += sums_of(changed, 0, 1) == before
    assert unseen == 0


@pytest.mark.mpi
def test_parts_along_any_axis_and_of_any_type_are_read_as_h5py_reads_them(comm, folder):
    """The last axis, more than one of them before it, and numbers, texts and flags of several types."""
    draw, rows = np.random.default_rng(6), ROWS_OF_SUM + 9
    arrays = {
        "points": (draw.normal(size=(rows, 3)), 0), "page": (draw.normal(size=(2, 4, rows)), 2),
        "half": (draw.normal(size=rows).astype("f4"), 0), "flags": (draw.normal(size=rows) > 0, 0),
        "names": (np.array([b"a", b"bcd"] * rows), 0), "complex": (draw.normal(size=(2, rows)) * 1j, 1),
    }  # fmt: skip
    write_rows(folder / "a.h5", comm, arrays)
    with reading(folder / "a.h5", "test") as file:
        for name, (array, axis) in arrays.items():
            place = (*[slice(None)] * axis, slice(5, ROWS_OF_SUM + 3))
            found = file[name][place]
            assert found.dtype == array.dtype and (found == array[place]).all()
            if array.dtype.kind in "fc":
                comm.Bcast(np.ascontiguousarray(found), root=0)  # a type that MPI knows
    comm.Barrier()


@pytest.mark.mpi
def test_numbers_that_are_not_finite_are_not_written(comm, folder):
    bad = np.array([1.0, np.nan if comm.rank == comm.size - 1 else 1.0])
    with (
        pytest.raises(ComputationError, match="basis/V has 1 of 2 numbers that are not finite"),
        writing(folder / "a.h5", comm) as file,
    ):
        file.rows("basis/V", bad)
    comm.Barrier()
    assert not list(folder.iterdir())


def test_a_file_is_not_read_where_it_is_a_door_to_another(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["a"] = h5py.SoftLink("/b")
    with h5py.File(tmp_path / "a.h5") as file, pytest.raises(InputError, match="/a is a link to something else"):
        CheckedFile(file, "a.h5")
