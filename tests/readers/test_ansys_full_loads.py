"""The load vector of ANSYS' .full files: put into a real file, and into made ones."""

import numpy as np
import pytest
from ansys_files import record, turn, write_full, write_rst
from foreign import gathered, write
from shared_data import unpacked

import hpcred
from hpcred import InputError
from hpcred.readers.ansys.full_loads import read_loads
from hpcred.readers.entries import STRIDE
from hpcred.readers.model_source import load_export

NODES = [(7, 3), (2, 3), (30, 3), (4, 3)]  # in the order of the rows
PLACES = np.array([[7, 0, 0, 0, 0, 0, 0], [2, 1, 0, 0, 30, -40, 55], [30, 0, 1, 0, 0, 0, 0], [4, 0, 0, 1, 0, 0, 0.0]])
LOADS = np.random.default_rng(3).standard_normal(12)
K = np.diag(np.arange(2.0, 14.0))


def static(comm, folder, held=(), rst=True, name="static.full", **options):
    """A file of a static analysis, and nodes of which the second has axes of its own."""
    if comm.rank == 0:
        write_full(folder / name, {"K": K}, NODES, held=held, **{"item4": 0, "loads": LOADS} | options)
        if rst:
            write_rst(folder / "static.rst", PLACES)
    comm.Barrier()
    return folder / name


@pytest.mark.mpi
def test_weight_in_a_real_file_is_the_weight(comm, folder):
    """HexBeam.full of a modal analysis, made static: its load vector of zeros gets M g, without its held rows."""
    path = unpacked(comm, folder, "ansys/HexBeam.full", "ansys/HexBeam.cdb")
    weight = hpcred.loads.Gravity(name="weight", value=(1.0, -2.0, 0.5))
    with load_export(path, comm) as model, model.with_loads([weight]) as loaded:
        node, direction = gathered(comm, model.dofs.node, model.dofs.direction)
        (column,) = gathered(comm, loaded.B.getDenseArray()[:, -1].real)
        words = np.fromfile(path, "<i4")
        header = words[105:205]  # behind it three dofs a node (6 words), and 321 nodes
        nodes = words[206 + 6 + 2 :][:321].tolist()
        force = dict(zip(zip(node.tolist(), direction.tolist(), strict=True), column, strict=True))
        loads = record(np.array([force.get((n, d), 0.0) for n in nodes for d in range(3)]))
        words[header[37] : header[37] + len(loads)] = loads
        header[[3, 4, 26, 27, 33]] = 1, 0, 0, 0, 0  # one matrix, static, no mass
        write(folder / "HexBeam2.full", words.tobytes(), comm)
        with model.with_loads([hpcred.loads.DeckLoad(name="w", file=str(folder / "HexBeam2.full"))]) as found:
            (again,) = gathered(comm, found.B.getDenseArray()[:, -1].real)
            assert again == pytest.approx(column, rel=1e-14) and np.abs(column).max() > 0
            assert "no loads on the 63 dofs that are held there" in found.loads[-1].remark


@pytest.mark.mpi
def test_loads_along_axes_of_nodes_become_global(comm, folder):
    found = read_loads(static(comm, folder), comm)
    assert not comm.allreduce(len(found.unknown)) and not found.remarks
    node, value = gathered(comm, *found.nodal[0])
    wanted = {n: LOADS[3 * k : 3 * k + 3] for k, (n, _) in enumerate(NODES)}
    wanted[2] = turn(PLACES[1, 4:]) @ wanted[2]
    assert sorted(node.tolist()) == [2, 4, 7, 30]
    for n, row in zip(node.tolist(), value, strict=True):
        assert row == pytest.approx([*wanted[n], 0, 0, 0], rel=1e-12)


@pytest.mark.mpi
def test_loads_of_held_dofs_are_not_known(comm, folder):
    """Of a node with axes of its own, in no direction that has a part of the held one; factors of 1 mean nothing."""
    found = read_loads(static(comm, folder, held=[0, 4], scaling=np.ones(12)), comm)
    (unknown,) = gathered(comm, found.unknown)
    assert sorted(unknown) == (STRIDE * np.array([2, 2, 2, 7]) + [0, 1, 2, 0]).tolist()
    assert "2 dofs that are held" in found.remarks[0]
    node, value = gathered(comm, *found.nodal[0])
    given = LOADS[3:6] * [1, 0, 1]
    assert value[node.tolist().index(2), :3] == pytest.approx(turn(PLACES[1, 4:]) @ given, rel=1e-12)


def test_files_whose_loads_are_not_known_are_refused(comm, folder):
    def says(text, **options):
        static(comm, folder, **options)
        with pytest.raises(InputError, match=text):
            read_loads(folder / "static.full", comm)

    says("found a modal analysis, expected those of a static analysis; run ANTYPE,STATIC with WRFULL,1", item4=2)
    says("found a buckling analysis, .* expected those of a static analysis", item4=1)
    says("found no load vector, expected one; run ANTYPE,STATIC", loads=None)
    says("found an imaginary load vector, expected real loads", item24=500)
    says("found the load vector of 11 numbers, expected 12,", loads=LOADS[:11])
    says("found the load vector of integers", loads=np.arange(12))
    says("the value nan in a load", loads=np.where(np.arange(12) == 3, np.nan, LOADS))
    says("found prescribed displacements that are not zero", held=[1], prescribed=0.5)
    says("found a load on 2:x, which follows others by a constraint equation or coupling", slaves=[3])
    loads = np.where(np.arange(12) == 3, 0.0, LOADS)
    says("found constraint equations with constants, expected homogeneous ones", slaves=[3], loads=loads, constant=1.0)
    says("found rows that are scaled", scaling=np.arange(12.0))
    says("found the part of one process of a distributed run, expected the whole file", item62=1)
    says("the file is damaged", item37=99999999)
    static(comm, folder, slaves=[3], loads=loads)
    unknown = read_loads(folder / "static.full", comm).unknown
    assert unknown.tolist() == [2 * STRIDE, 2 * STRIDE + 1, 2 * STRIDE + 2]
    (folder / "static.rst").unlink()
    says("found neither .cdb nor .rst file beside it, which tells of nodes with axes", rst=False)


def test_loads_that_do_not_fit_the_model_are_refused(comm, folder):
    write_full(folder / "model.full", {"K": K, "M": K}, NODES)
    write_rst(folder / "static.rst", PLACES)
    held = static(comm, folder, held=[0])
    with load_export(folder / "model.full", comm) as model:
        with pytest.raises(InputError, match="load 'f': 7:x is held, or follows others, in .*static.full, so that its"):
            model.with_loads([hpcred.loads.DeckLoad(name="f", file=str(held))])
        with pytest.raises(InputError, match="is a .full file of ANSYS; expected neither `step` nor `sid`"):
            model.with_loads([hpcred.loads.DeckLoad(name="f", file=str(held), step=1)])
        write_full(folder / "other.full", {"K": K}, [(n + 100, 3) for n, _ in NODES], item4=0, loads=LOADS)
        with pytest.raises(InputError, match="load 'f': node 10. of .*other.full has no row in"):
            model.with_loads([hpcred.loads.DeckLoad(name="f", file=str(folder / "other.full"))])
        file = str(static(comm, folder))
        with model.with_loads([hpcred.loads.DeckLoad(name="f", file=file)]) as loaded:
            assert loaded.loads[0].remark == "" and len(loaded.loads) == 1
