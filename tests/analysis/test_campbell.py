"""Campbell diagrams against closed formulae: crossings, veering, whirl, stability limits and critical speeds."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg
from helpers import to_dense
from rotor import HELD, RANGE, overhung_rotor
from scipy.optimize import brentq

import hpcred
from hpcred.analysis import campbell_diagram
from hpcred.analysis.campbell import _orbits
from hpcred.analysis.damped_modes import damped_modes
from hpcred.analysis.pole_tracking import Poles, PoleTracker, growth_of
from hpcred.analysis.whirl import orbits
from hpcred.reduction.result.maxwell_states import maxwell_states

TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])
PLANE = [SimpleNamespace(phi=np.eye(3)[:, :2])]  # a node that moves by the first two coordinates
OMEGA0 = 10.0


class Family:
    """A model over a parameter, from a function that gives M, D, K."""

    def __init__(self, function):
        self.function = function

    def at(self, **values):
        M, D, K = self.function(**values)
        return SimpleNamespace(M=M, D=D, K=K, loss_factor=0.0)


def jeffcott(external=0.2, internal=0.1):
    """A disk in the middle of a shaft, of mass 1 and frequency OMEGA0, with damping of its bearings and of its shaft,
    which turns with it."""
    return Family(lambda omega: (
        np.eye(2), (external + internal) * np.eye(2), OMEGA0**2 * np.eye(2) + internal * omega * TURN,
    ))  # fmt: skip


def overhung(polar, transverse=1.0, stiffness=100.0):
    """Tilts of a disk about x and y on a massless shaft along z; its rim moves along y and -x with them."""
    return Family(lambda omega: (
        transverse * np.eye(2), polar * omega * TURN, stiffness * np.eye(2),
    ))  # fmt: skip


def test_a_gyroscopic_disk_whirls_forward_and_backward():
    """omega = +-Jp Omega / 2 Jt + sqrt((Jp Omega / 2 Jt)^2 + k / Jt); a disk flatter than a sphere has no forward
    critical speed."""
    polar = 1.8
    # tilts rx, ry move a point before the disk by (ry, -rx, 0)
    nodes = [SimpleNamespace(phi=np.array([[0.0, 1.0], [-1.0, 0.0], [0.0, 0.0]]))]
    found = hpcred.campbell(overhung(polar), values=np.linspace(0, 40, 9), nodes=nodes)
    half = polar * found.values / 2
    exact = np.sqrt(half**2 + 100.0)[:, None] + half[:, None] * [[1.0, -1.0]]
    order = np.argsort(-found.poles[-1].imag)
    assert found.poles[:, order].imag == pytest.approx(exact, rel=1e-12)
    assert [np.array(found.whirl)[-1, k] for k in order] == ["forward", "backward"]
    assert found.orbits[1:, order] == pytest.approx(np.tile([1.0, -1.0], (8, 1)))
    assert found.whirl[0] == ["none", "none"]  # at rest the plane of a mode is any
    assert found.stability_limit is None
    backward, = found.critical_speeds
    assert backward.value == pytest.approx(np.sqrt(100.0 / (1 + polar)), rel=1e-9) and backward.whirl == "backward"


def test_internal_damping_makes_a_rotor_unstable_at_the_known_speed():
    """Omega = omega0 (1 + ce / ci), by forward whirl at omega0 (Jeffcott rotor with damping that rotates)."""
    found = hpcred.campbell(jeffcott(), values=np.linspace(0, 47, 12), nodes=PLANE)
    assert found.stability_limit == pytest.approx(OMEGA0 * 3, rel=1e-7)
    assert found.unstable_frequency == pytest.approx(OMEGA0 / (2 * np.pi), rel=1e-9)
    unstable = int(np.argmin(found.damping_ratios[-1]))
    assert found.whirl[-1][unstable] == "forward" and found.damping_ratios[-1, unstable] < 0
    assert hpcred.campbell(jeffcott(), values=[0.0, 10.0, 29.9]).stability_limit is None
    assert hpcred.campbell(jeffcott(), values=[31.0, 40.0]).stability_limit == 31.0


def test_in_a_rotating_frame_frequencies_are_shifted_by_the_speed():
    """|omega0 -+ Omega|: Coriolis forces and spin softening; forward whirl passes zero where the frame overtakes it."""
    rotating = Family(lambda omega: (np.eye(2), -2 * omega * TURN, (OMEGA0**2 - omega**2) * np.eye(2)))
    for count in (11, 12):  # one with a value at omega0, one without
        found = hpcred.campbell(rotating, values=np.linspace(0, 25, count), nodes=PLANE)
        speed = found.values
        order = np.argsort(found.poles[-1].imag)
        exact = np.stack([np.abs(OMEGA0 - speed), OMEGA0 + speed], axis=1)
        assert found.poles.shape[1] == 2
        assert found.poles[:, order].imag == pytest.approx(exact, abs=1e-6)
        words = np.array(found.whirl)[:, order]
        assert set(words[(speed > 0) & (speed < 9.9), 0]) == {"forward"}
        assert set(words[speed > 10.1, 0]) == {"backward"}  # as seen from the faster frame
        assert set(words[1:, 1]) == {"backward"} and found.stability_limit is None


def test_modes_of_other_shapes_cross_and_coupled_ones_veer():
    """Frequencies 10 and 8 + p: with a coupling c they stay apart by c / omega, however coarse the values are."""
    def mats(p, coupling):
        return np.eye(2), 0.001 * np.eye(2), np.array([[100.0, coupling], [coupling, (8 + p) ** 2]])

    for values in ([0.0, 2.0, 4.0], [0.0, 4.0]):
        crossing = hpcred.campbell(Family(lambda p: mats(p, 0.0)), "p", values)
        assert crossing.poles[-1].imag == pytest.approx([12.0, 10.0], rel=1e-6)
        veering = hpcred.campbell(Family(lambda p: mats(p, 0.1)), "p", values)
        apart = veering.poles[:, 1].imag - veering.poles[:, 0].imag
        assert (apart > 0.0099).all() and apart.min() < 0.03 and len(veering.values) > 8
        assert not veering.warnings and veering.unit == "" and veering.speeds is None


def test_symmetric_pairs_keep_their_shapes_through_a_coincidence():
    """Two pairs that meet exactly at a value, where any mixture of their vectors is a mode."""
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(4, 4)))[0]

    def mats(p):
        return np.eye(4), np.zeros((4, 4)), turn @ np.diag([10.0, 10.0, 8 + p, 8 + p]) ** 2 @ turn.T

    found = hpcred.campbell(Family(mats), "p", [0.0, 1.0, 2.0, 3.0, 4.0])
    assert np.sort(found.poles[0].imag) == pytest.approx([8, 8, 10, 10])
    for column in found.poles.T.imag:
        change = column[-1] - column[0]
        assert change == pytest.approx(4.0 if column[0] < 9 else 0.0, abs=1e-6)
    assert len(found.values) == 5


def test_an_overdamped_mode_parts_into_two():
    """At a damping of 2 a pair of poles of omega0 = 1 gets real: one of the two begins a column; the slow one lives."""
    found = hpcred.campbell(Family(lambda p: (np.eye(1), p * np.eye(1), np.eye(1))), "p", np.linspace(0.5, 4, 8),
                            highest=1.0)  # fmt: skip
    assert found.poles.shape[1] == 2 and np.isnan(found.poles[0, 1])
    exact = -2 + np.sqrt(3), -2 - np.sqrt(3)
    assert np.sort(found.poles[-1].real) == pytest.approx(np.sort(exact))
    assert np.nanmax(found.damping_ratios) == 1.0


def test_divergence_is_found_by_a_real_pole():
    """Stiffness 4 - p gets negative at 4."""
    found = hpcred.campbell(Family(lambda p: (np.eye(1), 0.1 * np.eye(1), np.array([[4.0 - p]]))), "p", [0, 3, 6])
    assert found.stability_limit == pytest.approx(4.0, rel=1e-6) and found.unstable_frequency == 0.0


def test_flutter_of_an_undamped_follower_force():
    """Circulatory coupling p merges frequencies 1 and 2 at p = (4 - 1) / 2."""
    def mats(p):
        return np.eye(2), np.zeros((2, 2)), np.array([[1.0, p], [-p, 4.0]])

    found = hpcred.campbell(Family(mats), "p", np.linspace(0, 2, 9))
    assert found.stability_limit == pytest.approx(1.5, rel=1e-6)
    assert found.unstable_frequency == pytest.approx(np.sqrt(2.5) / (2 * np.pi), rel=1e-3)


def test_critical_speeds_of_several_orders_and_units():
    """1x and 2x of a constant frequency of 10 rad/s, in rpm."""
    found = hpcred.campbell(Family(lambda n: (np.eye(1), 0.02 * np.eye(1), 100 * np.eye(1))), "n",
                            np.linspace(0, 200, 5), unit="rpm", orders=(1, 2))  # fmt: skip
    damped = 10 * np.sqrt(1 - 0.001**2)
    assert [item.order for item in found.critical_speeds] == [1.0, 2.0]
    values = [item.value for item in found.critical_speeds]
    assert values == pytest.approx([damped * 30 / np.pi, damped * 15 / np.pi], rel=1e-9)
    assert found.speeds[-1] == pytest.approx(200 * np.pi / 30)
    assert found.critical_speeds[0].damping_ratio == pytest.approx(0.001)
    assert found.critical_speeds[0].whirl == "unknown"


def test_a_free_axial_motion_is_no_critical_speed():
    """Beside the lateral ones of a Jeffcott rotor, with a stiffness that is round-off."""
    free = Family(lambda omega: (np.eye(3), np.diag([0.1, 0.1, 0.0]), np.diag([100.0, 1e6, 1e-11])))
    found = hpcred.campbell(free, values=np.linspace(0, 40, 9))
    assert [item.value for item in found.critical_speeds] == pytest.approx([10.0], rel=1e-3)


def test_models_that_are_diagonalised_at_each_value_are_taken_before():
    """Parametric reduced models have coordinates of their own at each value, and common ones by `matrices`."""
    plain = overhung(1.2)

    class Turned:
        loss_factor = 0.0
        parameters = (hpcred.Parameter("omega", (0.0, 30.0), unit="rpm"),)

        def matrices(self, values):
            return dict(zip("MDK", plain.function(**values), strict=True))

    expected = hpcred.campbell(plain, values=np.linspace(0, 30, 41), nodes=PLANE, unit="rpm")
    found = hpcred.campbell(Turned(), nodes=PLANE)
    assert found.poles == pytest.approx(expected.poles, rel=1e-9) and found.unit == "rpm"
    assert found.orbits == pytest.approx(expected.orbits, abs=1e-9)
    with pytest.raises(hpcred.InputError, match="found the parameter 'speed', expected one of omega"):
        hpcred.campbell(Turned(), "speed")


def test_orbits_by_phase():
    """Circles in both senses, a line, an ellipse with half axes 2 and 1, and motion along the axis."""
    modes = np.array([[1, -1j, 0], [1, 1j, 0], [1, 1, 0], [2, -1j, 0], [1e-9, -1e-9j, 1]]).T[None]
    assert orbits(modes, np.array([0.0, 0.0, 1.0])) == pytest.approx([1, -1, 0, 0.8, 0])
    assert orbits(modes, np.array([0.0, 0.0, -1.0])) == pytest.approx([-1, 1, 0, -0.8, 0])


def test_torsion_has_no_whirl_and_what_nodes_do_not_show_is_unknown():
    """A disk on a shaft: two displacements, two tilts with the gyroscopic moment, torsion, and a mode elsewhere. Where
    the node does not move but turns, its tilts tell, in the sense of their shapes."""
    polar, noise = 2.5, 1e-17 * np.random.default_rng(5).standard_normal((3, 6))
    gyroscopic = np.zeros((6, 6))
    gyroscopic[2, 3], gyroscopic[3, 2] = polar, -polar
    squares = np.array([9.0, 9.0, 225.0, 225.0, 2500.0, 3600.0])
    shaft = Family(lambda omega: (np.eye(6), omega * gyroscopic, np.diag(squares)))
    values = np.linspace(1.0, 9.0, 5)
    phi, psi = np.zeros((3, 6)), np.zeros((3, 6))
    phi[:2, :2] = psi[:2, 2:4] = np.eye(2)
    psi[2, 4] = 1.0
    for turns, torsion in ((psi, "none"), (0 * psi, "unknown")):
        node = SimpleNamespace(phi=phi + noise, psi=turns + noise * bool(turns.any()))
        found = hpcred.campbell(shaft, "omega", values, nodes=[node], axis="z", highest=10.0)
        for frequencies, words in zip(found.frequencies, found.whirl, strict=True):
            by_mode = dict(zip(np.round((2 * np.pi * frequencies) ** 2).tolist(), words, strict=True))
            assert by_mode[2500.0] == torsion and by_mode[3600.0] == "unknown" and by_mode[9.0] == "none"
            tilts = [word for square, word in sorted(by_mode.items()) if square not in (9.0, 2500.0, 3600.0)]
            assert tilts == (["backward", "forward"] if torsion == "none" else ["unknown"] * 2)


def test_steps_that_do_not_decide_are_told():
    """A matrix that jumps at a value."""
    def mats(p):
        turn = np.linalg.qr(np.random.default_rng(int(p > 0.3)).normal(size=(4, 4)))[0]
        return np.eye(4), np.zeros((4, 4)), turn @ np.diag([1.0, 4.0, 9.0, 16.0]) @ turn.T

    found = hpcred.campbell(Family(mats), "p", [0.0, 1.0])
    assert found.warnings and "the smallest step does not tell which mode goes on as which" in found.warnings[0]


def test_growth_above_the_limit_does_not_count():
    """What a reduction makes of high frequencies is told apart."""
    model = Family(lambda p: (np.eye(2), np.diag([0.1, 0.1 - p]), np.diag([1.0, 1e4])))
    found = hpcred.campbell(model, "p", [0.0, 1.0], highest=1.0)
    assert found.stability_limit is None and "a pole above 1 Hz is unstable" in found.warnings[0]
    tracker = PoleTracker(lambda p: model.function(p), 0.0, np.inf)
    assert tracker.growth(1.0)[0] > 0


@pytest.mark.parametrize(
    "arguments, says",
    [
        ({"values": [1.0]}, "values: found 1 values of omega, expected at least 2 that ascend"),
        ({"values": [1.0, 1.0]}, "values: found 2 values of omega"),
        ({}, "values: the model has no range of the parameter"),
        ({"values": [0.0, np.nan]}, "values: found nan"),
        ({"values": [0, 1], "orders": [0.0]}, "orders: found 0, expected"),
        ({"values": [0, 1], "axis": "w"}, "axis: found 'w'"),
        ({"values": [0, 1], "axis": [0, 0, 0]}, "expected 'x', 'y', 'z' or a vector of three numbers"),
        ({"values": [0, 1], "highest": 0.0}, "highest: found 0"),
    ],
)
def test_refusals(arguments, says):
    with pytest.raises(hpcred.InputError, match=says):
        hpcred.campbell(jeffcott(), **arguments)


def test_structural_damping_is_refused():
    model = SimpleNamespace(at=lambda omega: SimpleNamespace(loss_factor=0.02))
    with pytest.raises(hpcred.InputError, match="structural damping .loss factor 0.02. has no poles"):
        hpcred.campbell(model, values=[0, 1])


def test_fractional_laws_are_refused():
    part = hpcred.Viscoelastic(np.eye(2), hpcred.laws.Fractional(low=1.0, high=2.0, time=0.1, exponent=0.5), "core")
    model = SimpleNamespace(at=lambda omega: SimpleNamespace(loss_factor=0.0, added=(part,)))
    with pytest.raises(hpcred.InputError, match="core is fractional, .* of states has in a Campbell diagram; take"):
        hpcred.campbell(model, values=[0, 1])


class Viscoelastic(Family):
    """The same with viscoelastic parts beside M, D, K."""

    def __init__(self, function, parts):
        super().__init__(function)
        self.added = parts

    def at(self, **values):
        found = super().at(**values)
        found.added = self.added
        return found


def test_a_rotor_in_viscoelastic_bearings_against_its_polynomial():
    """z = x + i y of a Jeffcott rotor: (1 + time s) (s^2 + d s + k - i c omega) + g time s = 0."""
    internal, factor, time = 0.2, 30.0, 0.05
    shaft = jeffcott(external=0.0, internal=internal)
    law = hpcred.laws.Maxwell(factors=[factor], times=[time])
    model = Viscoelastic(shaft.function, (hpcred.Viscoelastic(np.eye(2), law),))

    def exact(omega):
        stiffness = OMEGA0**2 - 1j * internal * omega
        roots = np.roots([time, 1 + time * internal, internal + time * (stiffness + factor), stiffness])
        return roots[np.abs(roots.imag) > 1.0]  # without the relaxation

    def growth(omega):
        return exact(omega).real.max()

    limit = brentq(growth, 1.0, 200.0, xtol=1e-12)
    found = hpcred.campbell(model, values=np.linspace(0, 1.2 * limit, 13), nodes=PLANE)
    assert found.poles.shape == (len(found.values), 2)
    for value, poles in zip(found.values, found.poles, strict=True):
        roots = exact(value)
        assert np.sort(poles.imag) == pytest.approx(np.sort(np.abs(roots.imag)), rel=1e-9)
        assert np.sort(poles.real) == pytest.approx(np.sort(roots.real), abs=1e-9)
    assert found.stability_limit == pytest.approx(limit, rel=1e-7)
    alone = hpcred.campbell(shaft, values=np.linspace(0, 1.2 * limit, 13))
    assert alone.stability_limit < 0.2 * limit


def test_modes_that_are_relaxations_are_left_out():
    """Of a body in oil, at all values, or from a damping ratio of 0.9 on."""
    part = hpcred.Viscoelastic(1e-6 * np.eye(2), hpcred.laws.Maxwell([1.0], [1.0]))
    for first, shown in ((100.0, []), (0.0, [0.0, 6.0, 12.0])):
        values = first + np.array([0.0, 6.0, 12.0, 24.0])
        model = Viscoelastic(lambda omega: (np.eye(2), omega * np.eye(2), 100.0 * np.eye(2)), (part,))
        found = hpcred.campbell(model, values=values, nodes=PLANE)
        there = np.isfinite(found.poles[np.isin(found.values, values)]).any(axis=1)
        assert values[there].tolist() == shown and found.stability_limit is None


@pytest.mark.parametrize("seed", range(6))
def test_maxwell_elements_against_a_singular_pencil(seed):
    """Random models with two laws, in the form whose elements have no mass; each step keeps its mode."""
    rng = np.random.default_rng(seed)
    size = int(rng.integers(3, 7))
    A, G, N, *V = (rng.normal(size=(size, size)) for _ in range(5))
    M, K = np.eye(size) + 0.05 * A @ A.T, np.diag(rng.uniform(5, 30, size) ** 2) + A @ A.T
    laws = hpcred.laws.Maxwell([1.0, 0.5], [0.3, 0.01]), hpcred.laws.Maxwell([2.0], [1e-4])
    parts = tuple(hpcred.Viscoelastic(part[:, :2] @ part[:, :2].T, law) for part, law in zip(V, laws, strict=True))
    model = Viscoelastic(lambda p: (M, 0.002 * K + p * (G - G.T), K - 0.05 * p**2 * N @ N.T), parts)
    found = hpcred.campbell(model, "p", np.linspace(0, 3, 7), highest=100.0)
    states = maxwell_states(parts)
    for value, row in zip(found.values[[0, -1]], found.poles[[0, -1]], strict=True):
        M_, D_, K_ = states.second_order(*model.function(value))
        one = np.eye(len(M_))
        poles = scipy.linalg.eigvals(np.block([[0 * one, one], [-K_, -D_]]), scipy.linalg.block_diag(one, M_))
        poles = poles[np.isfinite(poles) & (poles.imag > 0) & (-poles.real <= 0.9 * np.abs(poles))]
        there = row[row.imag > 0]
        assert len(there) == len(poles)
        assert np.sort_complex(there) == pytest.approx(np.sort_complex(poles), rel=1e-7)
    coarse = hpcred.campbell(model, "p", [0.0, 3.0], highest=100.0)
    ends = [[mode[[0, -1]] for mode in each.poles.T] for each in (found, coarse)]
    fine, coarse = (sorted(pairs, key=lambda pair: (np.nan_to_num(pair[0]).imag, pair[1].real)) for pairs in ends)
    assert np.allclose(coarse, fine, rtol=1e-6, atol=1e-6, equal_nan=True)


def test_a_reduced_rotor_with_viscoelastic_parts(comm):
    """One that keeps all modes, beside that of the matrices."""
    law = hpcred.laws.Maxwell(factors=[0.5, 0.2], times=[1e-3, 1e-5])
    with overhung_rotor(comm, elements=2) as rotor:
        K, M, D, G = (to_dense(mat)[6:, 6:] for mat in (rotor.model.K, rotor.model.M, rotor.model.D,
                                                        rotor.terms[0].matrix))  # fmt: skip
        part = hpcred.Viscoelastic(0.1 * to_dense(rotor.model.K), law, "core")
        with rotor.model.with_viscoelastic([part]) as model:
            whole = hpcred.ParametricModel(model, rotor.parameters, rotor.terms)
    with whole, hpcred.reduce(whole, hpcred.Modes(count=12), HELD, damping=hpcred.GivenDamping()) as rom:
        found = hpcred.campbell(rom, values=np.linspace(*RANGE, 5), highest=3000.0)
    K = K + 0.1 * law.static * K
    full = Viscoelastic(lambda omega: (M, D + omega * G, K), (hpcred.Viscoelastic(part.matrix[6:, 6:], law),))
    beside = hpcred.campbell(full, values=np.linspace(*RANGE, 5), highest=3000.0)
    assert found.poles.shape == beside.poles.shape and 6 <= found.poles.shape[1] <= 12
    assert np.allclose(*(np.sort_complex(each.poles) for each in (found, beside)), rtol=1e-6, equal_nan=True)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.costly
def test_a_full_rotor_beside(comm):
    """The lowest modes of an overhung rotor with gyroscopic moments, against all its modes in numpy."""
    with overhung_rotor(comm) as rotor:
        K, M, D, G = (to_dense(mat)[6:, 6:] for mat in (rotor.model.K, rotor.model.M, rotor.model.D,
                                                        rotor.terms[0].matrix))  # fmt: skip
        end = np.eye(len(K))[-6:-3]
        found = hpcred.campbell(Family(lambda omega: (M, D + omega * G, K)), values=np.linspace(*RANGE, 9), axis="x",
                                nodes=[SimpleNamespace(phi=end)], highest=400.0)  # fmt: skip
        beside = found.with_full(rotor, frame=HELD)
    assert [item.value for item in beside.full] == [0.0, 1000.0, 2000.0, 3000.0, 4000.0]
    assert max(item.residual for item in beside.full) < 1e-8 and not beside.warnings
    rows = beside.full_rows
    assert len(rows) >= 5 * 4 and max(row["distance"] for row in rows) < 1e-7
    assert max(row["frequency"] for row in rows) <= 400.0
    whirl = np.array(found.whirl)[-1]
    assert list(whirl[:2]) in (["backward", "forward"], ["forward", "backward"])
    forward = found.frequencies[:, list(whirl).index("forward")]
    assert (np.diff(forward) > 0).all()


def test_full_models_have_as_many_modes_as_there_are_at_each_value(monkeypatch):
    """Oscillators that stiffen with the parameter, so that fewer and fewer are below the highest frequency."""
    residuals = []

    def watched(*arguments, **more):
        solved = damped_modes(*arguments, **more)
        residuals.append(np.arange(1.0, 1 + len(solved.poles)))
        return replace(solved, residuals=residuals[-1])

    monkeypatch.setattr(campbell_diagram, "damped_modes", watched)
    K = np.diag(np.arange(1.0, 13.0) ** 2)
    found = hpcred.campbell(Family(lambda p: (np.eye(12), 0.0 * K, (1 + 99.0 * p) * K)), "p", np.linspace(0, 1, 5),
                            highest=11.0 / (2 * np.pi))  # fmt: skip
    model = hpcred.SecondOrderModel.from_scipy(K, np.eye(12))
    with model, hpcred.ParametricModel(model, [hpcred.Parameter("p", (0.0, 1.0))],
                                       [hpcred.Term("K", 99.0 * K, "p")]) as whole:  # fmt: skip
        beside = found.with_full(whole, values=[0.0, 1.0])
    for item, below in zip(beside.full, (11, 1), strict=True):
        omega = np.sqrt(1 + 99.0 * item.value) * np.arange(1, 13)
        assert below <= len(item.poles) and item.poles.imag == pytest.approx(omega[: len(item.poles)], rel=1e-8)
        assert item.residual == len(item.poles)
        assert len(item.poles) <= below + 3


@pytest.mark.parametrize("seed", range(12))
def test_coarse_values_give_the_modes_of_fine_ones(seed):
    """Random gyroscopic, softened and damped models: each mode ends where small steps lead it."""
    rng = np.random.default_rng(seed)
    size = int(rng.integers(2, 9))
    A, G, N = (rng.normal(size=(size, size)) for _ in range(3))
    turn = np.linalg.qr(rng.normal(size=(size, size)))[0]
    M, K = np.eye(size) + 0.05 * A @ A.T, turn @ np.diag(rng.uniform(5, 30, size) ** 2) @ turn.T
    model = Family(lambda p: (M, 0.002 * K + p * (G - G.T), K - 0.05 * p**2 * N @ N.T))
    ends = [
        [mode[[0, -1]] for mode in hpcred.campbell(model, "p", np.linspace(0, 6, count), highest=100.0).poles.T]
        for count in (4, 241)
    ]
    coarse, fine = (sorted(pairs, key=lambda pair: (np.nan_to_num(pair[0]).imag, pair[1].real)) for pairs in ends)
    assert np.allclose(coarse, fine, rtol=1e-6, atol=1e-6, equal_nan=True)


def test_a_mode_that_parts_in_the_last_step_is_there():
    """The unstable one of two real poles begins at the last value."""
    found = hpcred.campbell(Family(lambda p: (np.eye(1), 0.1 * np.eye(1), np.array([[4.0 - p]]))), "p", [0.0, 3.0, 5.0])
    assert found.poles.shape[1] == 2 and np.nanmax(found.poles.real) == pytest.approx(-0.05 + np.sqrt(1.0025))


def test_narrow_ranges_of_instability_are_found():
    """A shaft of two stiffnesses in its turning frame is unstable between its two frequencies; a circulatory coupling
    of two modes that meet makes flutter where they are nearer than it. Both are much narrower than the steps."""
    stiffness = np.diag([10.0**2, 10.05**2])
    shaft = Family(lambda omega: (np.eye(2), -2 * omega * TURN, stiffness - omega**2 * np.eye(2)))
    for count in (4, 41):
        found = hpcred.campbell(shaft, values=np.linspace(0, 23.7, count))
        assert found.stability_limit == pytest.approx(10.0, rel=1e-6)
    coupling = 1.0
    meeting = Family(lambda p: (np.eye(2), np.zeros((2, 2)), np.diag([100.0, 64 + p]) + coupling * TURN))
    found = hpcred.campbell(meeting, "p", np.linspace(0, 73, 8))
    assert found.stability_limit == pytest.approx(36 - 2 * coupling, rel=1e-6)


def test_what_does_not_vibrate_has_no_orbit():
    """A rigid-body motion and an overdamped one; of a circle the sense is that of the rotation."""
    shapes, modes = np.eye(3)[None], np.array([[1, 0, 0], [1, 0, 0], [1, -1j, 0]]).T
    for speed in (5.0, -5.0):
        part = SimpleNamespace(value=speed, poles=np.array([0.0, -3.0, 2j]), shapes=modes, single=np.full(3, True))
        assert _orbits(part, shapes, np.array([0.0, 0.0, 1.0]), "speed") == pytest.approx([0, 0, np.sign(speed)])


@pytest.mark.parametrize(("real", "grows"), [(5e-13, False), (5e-12, True)])
def test_growth_is_more_than_round_off_of_the_largest_pole(real, grows):
    of_one = np.zeros((1, 1)), np.zeros((2, 1)), np.ones(1, bool)
    growth, pole = growth_of(Poles(0.0, np.array([real + 1e-3j]), *of_one, size=1.0), limit=1.0)
    assert (growth > 0) == grows and pole == real + 1e-3j
