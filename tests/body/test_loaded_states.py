"""Geometric stiffness of states that the program has computed: printed stresses, and differences of matrices."""

import numpy as np
import pytest
from helpers import face

import hpcred
from hpcred import Modes, Tangent
from hpcred.body import LoadedState, Preload
from hpcred.body.loaded_states import require_axial, stiffness_of_difference, stiffness_of_stresses
from hpcred.body.unit_states import displacements_of_states, stresses
from hpcred.fe.solids import Solids
from hpcred.parallel.failures import InputError
from hpcred.readers.stresses.calculix_dat import read_points as read

CLAMP = Tangent("left")


def beam(comm, **more):
    with hpcred.solid((8, 1, 1), (0.8, 0.02, 0.03), 3, False, comm, **more) as plain:
        return plain.with_interfaces([face("left", 0.0, kind="rigid"), face("right", 0.8, kind="rigid")])


def printed(model, state, value=1.0):
    """Lines of a .dat file of a state, of this rank."""
    solids = Solids(model)
    found = displacements_of_states(model, solids, CLAMP, np.zeros(3), ["right"], None, {state: value})
    lines, table = [], model.properties.table["hexahedron"]
    for _, _, stress in stresses(solids, found.field):
        for number, rows in zip(table[:, 0], stress[..., 0], strict=True):
            for point, (xx, yy, zz, xy, yz, zx) in enumerate(rows, 1):
                values = "".join(f"{x:20.12E}" for x in (xx, yy, zz, xy, zx, yz))
                lines.append(f"{number:10d}{point:4d} {values}")
    return lines


def written(comm, path, lines, title="stresses (elem, integ.pnt.,sxx,syy,szz,sxy,sxz,syz)", time="0.1000000E+01"):
    parts = comm.gather(lines)
    if comm.rank == 0:
        text = [f" {title} for set EALL and time  {time}", "", *sum(parts, []), ""]
        path.write_text("\n".join(["", *text]))
    comm.Barrier()
    return path


@pytest.mark.mpi
def test_printed_stresses_give_what_own_ones_give(comm, folder):
    with beam(comm) as model, hpcred.reduce(model, [Modes(count=4)], CLAMP) as rom:
        own = hpcred.geometric_stiffness(model, rom.columns, CLAMP)
        for state in ("wz^2", "right:x", "ax"):
            path = written(comm, folder / "s.dat", printed(model, state, 3.0))
            found = stiffness_of_stresses(model, rom.columns, *read(path, comm), str(path)) / 3.0
            wanted = own.of([state])[0]
            assert found == pytest.approx(wanted, abs=1e-9 * np.abs(wanted).max())


@pytest.mark.mpi
def test_stresses_of_another_mesh(comm, folder):
    with beam(comm) as model, hpcred.reduce(model, [Modes(count=2)], CLAMP) as rom:
        lines = printed(model, "wz^2")

        def refusal(mine, **more):
            path = written(comm, folder / "s.dat", mine, **more)
            with pytest.raises(InputError) as caught:
                stiffness_of_stresses(model, rom.columns, *read(path, comm), "s.dat")
            return str(caught.value)

        every = sum(comm.allgather(lines), [])
        first = every if comm.rank == 0 else []
        assert "no stresses of element 8 (hexahedron) of solid at all" in refusal(first[:-1])
        assert "found stresses at 65 integration points, expected 64" in refusal(
            [*first, *(line.replace("         8   8 ", "         9   1 ") for line in first[-1:])]
        )
        assert "found element 1, point 1 twice" in refusal([*first, *first[:1]])
        assert "found 'strains (elem" in refusal(first, title="strains (elem, integ.pnt.,exx,eyy,ezz,exy,exz,eyz)")
        two = [*first, " stresses (elem, integ.pnt.,sxx,syy,szz,sxy,sxz,syz) for set EALL and time  2.0"]
        assert "found stresses of the times 0.1000000E+01, 2.0, expected those of one" in refusal(two)
        assert "expected 8 numbers" in refusal([*first, "  9  1  0.0"])
        written(comm, folder / "s.dat", first)
        with (
            model.with_fields(properties=None) as bare,
            pytest.raises(InputError, match="the elements of solid have no numbers; convert it from its input file"),
        ):
            stiffness_of_stresses(bare, rom.columns, *read(folder / "s.dat", comm), "s.dat")


@pytest.mark.mpi
def test_a_difference_of_matrices_is_the_stiffness_of_the_stress(comm):
    """Of models at a preload, of a centrifugal load with spin softening, and of opposite axial forces."""
    with beam(comm) as model, hpcred.reduce(model, [Modes(count=4)], CLAMP) as rom:
        own = hpcred.geometric_stiffness(model, rom.columns, CLAMP)
        spin = LoadedState(state="wz^2", value=1e4, file="spin.h5")
        with hpcred.preloaded(model, Preload(omega=(0.0, 0.0, 100.0)), CLAMP) as loaded:
            found = stiffness_of_difference(model, rom.columns, spin, loaded) / spin.value
            wanted = own.of(["wz^2"])[0]
            assert found == pytest.approx(wanted, abs=1e-7 * np.abs(wanted).max())
            with pytest.raises(InputError, match="a difference of matrices holds the stiffness of the displacements"):
                stiffness_of_difference(model, rom.columns, LoadedState(state="ay", value=1.0, file="a"), loaded)
        with pytest.raises(InputError, match="spin.h5: found the K of solid, expected that under the load 'wz.2'; let"):
            stiffness_of_difference(model, rom.columns, spin, model)
        pull = LoadedState(state="right:x", value=1e3, file="pull.h5", opposite="push.h5")
        with (
            hpcred.preloaded(model, Preload(forces={"right:x": 1e3}), CLAMP) as one,
            hpcred.preloaded(model, Preload(forces={"right:x": -1e3}), CLAMP) as other,
        ):
            found = stiffness_of_difference(model, rom.columns, pull, one, other) / pull.value
        wanted = own.of(["right:x"])[0]
        assert found == pytest.approx(wanted, abs=1e-7 * np.abs(wanted).max())
        with hpcred.solid((7, 1, 1), (0.8, 0.02, 0.03), 3, False, comm) as shorter, pytest.raises(
            InputError, match=r"pull.h5: found 96 rows, expected the 108 rows of solid .*another mesh"
        ):
            stiffness_of_difference(model, rom.columns, pull, shorter)
        with beam(comm, density=1.0) as lighter, pytest.raises(
            InputError, match=r"pull.h5: found another mass matrix than that of solid \(by 1.0e\+00\)"
        ):
            stiffness_of_difference(model, rom.columns, pull, lighter)


@pytest.mark.mpi
def test_axial_loads_of_slender_bodies_only(comm):
    with beam(comm) as model:
        for state in ("wx^2", "ax", "right:x"):
            require_axial(model, state)
        for state in ("ay", "wx wy", "alphaz", "right:y", "right:rx", "5:x"):
            with pytest.raises(InputError, match=f"geometric_stiffness: '{state}': a difference of matrices holds"):
                require_axial(model, state)
    # the least moment of inertia is 1, 0.28 and 0.15 of the next one, 2 / (1 + (length / width)^2)
    for length in (2, 5, 7):
        with hpcred.solid((length, 2, 2), None, 3, False, comm) as block:
            if length == 7:
                require_axial(block, "ax")
                continue
            with pytest.raises(InputError, match="axial or centrifugal"):
                require_axial(block, "ax")


WRONG = [
    ({"state": "wz", "file": "a"}, "found the state 'wz', expected one of"),
    ({"state": "wz^2"}, "expected one of `stresses` and `file`, found both or neither"),
    ({"state": "wz^2", "file": "a", "stresses": "b"}, "found both or neither"),
    ({"state": "wz^2", "stresses": "a", "opposite": "b"}, "opposite: belongs to `file`"),
    ({"state": "wz^2", "stresses": "a", "value": 0.0}, "value: found 0, expected the value of the state 'wz.2'"),
    ({"state": "wx^2", "stresses": "a", "value": -1e4}, "value: found -10000, expected the value of the state 'wx.2'"),
    ({"state": "wz^2", "stresses": "a", "units": "parsec"}, "units"),
]


@pytest.mark.parametrize("keys, says", WRONG)
def test_tables_that_make_no_sense(keys, says):
    with pytest.raises(InputError, match=says):
        LoadedState(**{"value": 1.0, **keys})
