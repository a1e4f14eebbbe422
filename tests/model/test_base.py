"""Bodies on a base that moves: columns and outputs against closed forms and dense partitions; and each refusal."""

import numpy as np
import pytest
import scipy.linalg
from helpers import bar, columns_of, dense_model, few_on_ranks, refused

import hpcred
from hpcred.loads import Base

pytestmark = pytest.mark.mpi(build="real")

NONE = hpcred.Dofs(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 3)))
F = np.array([3.0, 50.0, 400.0])


def straight(comm, elements=8, length=1.0, damping=0.0):
    """A free beam with stiffness-proportional damping, and its dense M, D, K."""
    with bar(comm, length, elements) as free:
        K, M, _ = dense_model(free)
    count = elements + 1
    points = np.linspace([0, 0, 0], [length, 0, 0], count)
    numbers = np.arange(1, count + 1)
    dofs = hpcred.Dofs(np.repeat(numbers, 6), np.tile(np.arange(6), count), np.repeat(points, 6, axis=0))
    D = damping * K
    return hpcred.SecondOrderModel.from_scipy(K, M, D if damping else None, comm, dofs=dofs, held=NONE), M, D, K


def absolute(M, D, K, rows, base, motion, f):
    """Displacements (F, n, k) by a dense partition: the rows `base` move by `motion` (b, k), others follow."""
    free = np.setdiff1d(np.arange(len(K)), base)
    found = np.zeros((len(f), len(K), motion.shape[1]), complex)
    for H, s in zip(found, 2j * np.pi * f, strict=True):
        A = s * s * M + s * D + K
        H[base] = motion
        H[free] = -np.linalg.solve(A[np.ix_(free, free)], A[np.ix_(free, base)] @ motion)
    return found[:, rows]


@pytest.mark.parametrize("grounded", few_on_ranks([False, True]))
def test_partition(comm, grounded):
    """Absolute accelerations over that of the base are the dense partition of the whole, free or with a spring to the
    ground beside the base; relative displacements are less the static deflection."""
    plain, M, D, K = straight(comm, damping=1e-6)
    if grounded:
        K = K.copy()
        K[50, 50] += 1e6
        D = 1e-6 * K
    with plain, hpcred.SecondOrderModel.from_scipy(K, M, D, comm, dofs=_all(plain), held=NONE) as model:
        base = Base(on=(1,), directions=("z", "ry"), absolute=((9, "z"), (1, "z")))
        with model.with_outputs([(9, "z")]) as sensed, sensed.with_bases([base]) as shaken:
            assert shaken.size == 48 and shaken.input_names == ("base:z", "base:ry")
            assert shaken.output_names == ("9:z", "absolute acceleration 9:z", "absolute acceleration 1:z")
            H = shaken.frequency_response(F, damping=hpcred.GivenDamping())
            kinds = {item.kind for item in shaken.loads}
    motion = np.eye(6)[:, [2, 4]]
    whole = absolute(M, D, K, [50, 2], np.arange(6), motion, F)
    still = absolute(M, 0 * D, K, [50], np.arange(6), motion, np.zeros(1))
    np.testing.assert_allclose(H[:, 1:], whole, rtol=1e-9, atol=1e-12)
    s = 2j * np.pi * F[:, None, None]
    np.testing.assert_allclose(H[:, :1], (whole[:, :1] - still) / s**2, rtol=1e-7, atol=1e-9 * np.abs(H[:, :1]).max())
    assert kinds == ({"support"} if grounded else {"base"})


def _all(model):
    """The labels of all rows, on every rank."""
    keys = ("node", "direction", "position")
    return hpcred.Dofs(*(np.concatenate(model.comm.allgather(getattr(model.dofs, key))) for key in keys))


def _on_base(model, place):
    """The body on its first node, which moves in the direction of the place whose absolute acceleration is known."""
    with model.with_input_columns(None, ()) as bare:
        return bare.with_bases([Base(on=(1,), directions=(place[1],), absolute=(place,))])


def test_rod_on_a_shaker(comm):
    """Transmissibility of a rod, 1 / cos(omega L / c), below and above its first resonance, where the phase turns."""
    model, M, _, K = straight(comm, elements=40)
    E, rho = K[0, 0] / M[0, 0], 1.0  # of the first element: k = EA / l, m = rho A l / 3
    c = np.sqrt(E * (1 / 40) ** 2 / 3 / rho)
    f = np.array([0.1, 0.2, 0.3]) * c
    with model, _on_base(model, (41, "x")) as shaken:
        H = shaken.frequency_response(f)[:, 0, 0]
    np.testing.assert_allclose(H.real, 1 / np.cos(2 * np.pi * f / c), rtol=2e-3)
    assert H[1].real > 0 > H[2].real


def test_beam_on_a_shaker(comm):
    """The tip of a clamped Euler-Bernoulli beam on a base that moves across it, by its closed form."""
    model, M, _, K = straight(comm, elements=20)
    # EI and rho A of slender elements of length l: K_zz = 12 EI / l^3, M_xx = rho A l / 3
    l = 1 / 20
    EI, mass = K[2, 2] * l**3 / 12, 3 * M[0, 0] / l
    f = 1.8751041**2 * np.sqrt(EI / mass) / 2 / np.pi * np.array([0.5, 2.0])
    with model, _on_base(model, (21, "z")) as shaken:
        H = shaken.frequency_response(f)[:, 0, 0]
    b = np.sqrt(2 * np.pi * f * np.sqrt(mass / EI))
    exact = (np.cos(b) + np.cosh(b)) / (1 + np.cos(b) * np.cosh(b))
    np.testing.assert_allclose(H.real, exact, rtol=2e-2)


@pytest.mark.parametrize("lumped", few_on_ranks([True, False]))
def test_held_nodes(comm, lumped):
    """What the program holds moves as the same nodes do by `on`, where no mass couples it; else a remark says so."""
    model, M, _, K = straight(comm)
    M = np.diag(M.sum(axis=1).clip(M.max() * 1e-3)) if lumped else M
    with model:
        dofs = _all(model)
    there = comm.rank == comm.size - 1
    base = Base(directions=("z",), absolute=((9, "z"),))
    responses, notes = [], []
    whole = hpcred.SecondOrderModel.from_scipy(K, M, None, comm, dofs=dofs, held=NONE)
    part = hpcred.SecondOrderModel.from_scipy(
        K[6:, 6:], M[6:, 6:], None, comm, dofs=dofs.take(np.arange(6, 54)), held=dofs.take(np.arange(6 if there else 0))
    )
    for item, moved in ((whole, Base(on=(1,), directions=("z",), absolute=((9, "z"),))), (part, base)):
        with item, item.with_bases([moved]) as shaken:
            responses.append(shaken.frequency_response(F))
            notes.append(shaken.loads[0].remark)
    if lumped:
        np.testing.assert_allclose(responses[1], responses[0], rtol=1e-9)
    assert not notes[0] and ("the mass of held dofs" in notes[1]) == (not lumped)


@pytest.mark.costly
def test_reduced_with_its_exports(comm, tmp_path):
    """Reduction to a tolerance, files and the state space have absolute accelerations as the full model has them."""
    model, *_ = straight(comm, damping=1e-5)
    folder = comm.bcast(str(tmp_path))
    base = Base(on=(1,), directions=("z",), absolute=((9, "z"),))
    with model, model.with_outputs([(5, "z")]) as sensed, sensed.with_bases([base]) as shaken:
        hpcred.write_model(f"{folder}/shaken.h5", shaken)
        H = shaken.frequency_response(F, damping=hpcred.GivenDamping())
        reduced = hpcred.reduce(shaken, [hpcred.Modes(count=16), hpcred.Krylov(frequency=0.0, order=1)],
                                damping=hpcred.GivenDamping())  # fmt: skip
        np.testing.assert_allclose(reduced.frequency_response(F), H, rtol=1e-5)
        reduced.save(f"{folder}/result.h5")
        reduced.close()
    with hpcred.read_model(f"{folder}/shaken.h5") as again:
        np.testing.assert_allclose(again.frequency_response(F, damping=hpcred.GivenDamping()), H, rtol=1e-10)
    read = hpcred.read_result(f"{folder}/result.h5").reduced
    np.testing.assert_allclose(read.frequency_response(F), H, rtol=1e-5)
    space, s = hpcred.state_space(read), 2j * np.pi * F[1]
    found = space["C"] @ np.linalg.solve(s * np.eye(len(space["A"])) - space["A"], space["B"]) + space["D"]
    np.testing.assert_allclose(found, H[1], rtol=1e-5)
    assert read.record.loads[0].is_motion


@pytest.mark.parametrize(
    ("damping", "forces", "tolerance"),
    few_on_ranks([
        (hpcred.GivenDamping(), ((5, "z"), (9, "ry")), 1e-4), (hpcred.Structural(loss_factor=0.02), (), 1e-3),
    ]),
)  # fmt: skip
@pytest.mark.costly
def test_tolerance(comm, damping, forces, tolerance):
    """A reduction to a tolerance, against the dense partition of the whole in the measure that it claims: relative
    displacements and absolute accelerations, of a base alone and beside forces."""
    plain, M, D, K = straight(comm, damping=1e-5)
    base = Base(on=(1,), directions=("z",), absolute=((9, "z"), (5, "z")))
    with (plain, plain.with_inputs(forces) if forces else plain.with_input_columns(None, ()) as pushed,
          pushed.with_outputs([(9, "z")]) as sensed, sensed.with_bases([base]) as shaken):  # fmt: skip
        rom = hpcred.reduce(shaken, tolerance=tolerance, band=(0.0, 600.0), damping=damping)
    f = np.linspace(1.0, 600.0, 300)
    s = 2j * np.pi * f[:, None, None]
    K, D = (K, D) if forces else (K * (1 + damping.loss_factor * 1j), 0 * D)
    # forces on rows 26 and 52, and the inertia of the body that moves with its base
    pushes = np.eye(54)[:, [26, 52][: len(forces)]]
    B = np.hstack([pushes, -M @ np.tile(np.eye(6)[2], 9)[:, None]])[6:]
    C = np.eye(54)[[50, 50, 26], 6:]
    states = np.linalg.solve((s * s * M + s * D + K)[:, 6:, 6:], np.broadcast_to(B, (len(f), *B.shape)))
    H = C @ states
    H[:, 1:] *= s * s
    H[:, 1:, -1:] = absolute(M, D, K, [50, 26], np.arange(6), np.eye(6)[:, [2]], f)
    accuracy, drive = rom.record.accuracy, np.einsum("ij,fij->fj", B, states)
    eps = accuracy.measure.eps(rom.frequency_response(f) - H, H, drive).max()
    assert accuracy.stopped == "reached" and eps <= accuracy.largest + 1e-9 and accuracy.largest <= tolerance
    assert eps > 0.1 * accuracy.largest
    np.testing.assert_allclose(rom.feedthrough[:, -1], [0, 1, 1], atol=1e-9)


def test_inputs_of_before(comm):
    """Forces on the base go, other forces stay with their outputs; the body keeps its interfaces."""
    model, *_ = straight(comm)
    ends = [hpcred.Interface(name=name, nodes=(node,), kind="rigid") for name, node in (("foot", 1), ("tip", 9))]
    base = Base(name="foot", on="foot", directions=("y", "rz"))
    with (model, model.with_input_columns(None, ()) as bare, bare.with_interfaces(ends) as marked,
          marked.with_bases([base]) as shaken):  # fmt: skip
        assert shaken.input_names[-2:] == ("foot:y", "foot:rz") and len(shaken.input_names) == 8
        assert [item.name for item in shaken.interfaces] == ["tip"]
        assert shaken.output_names == shaken.input_names[:6]
        assert "left out the inputs foot:x" in shaken.loads[0].notes[0]
        mass = shaken.loads[-2].force[1]
        whole = columns_of(shaken.B)
    assert np.isfinite(whole).all() and mass < 0


@pytest.mark.parametrize(
    ("base", "message"),
    few_on_ranks([
        ({}, "has no held nodes that could move"),
        ({"on": (1,), "directions": ("up",)}, "found the direction 'up', expected one of x, y, z"),
        ({"on": (1,), "directions": ("x", "x")}, "each once"),
        ({"on": (99,)}, "node 99 does not exist"),
        ({"on": "FOOT"}, "has no node set or interface 'FOOT'"),
        ({"on": tuple(range(1, 10))}, "nothing is left to vibrate"),
        ({"on": (1,), "name": "9"}, "base.name: found '9'"),
        ({"on": (1,), "absolute": ((77, "z"),)}, "node 77 does not exist"),
    ]),
)  # fmt: skip
def test_refused(comm, base, message):
    model, *_ = straight(comm)
    with model, pytest.raises(hpcred.InputError, match="(?s)" + message.replace("(", r"\(")):
        model.with_outputs([(9, "z")]).with_bases([Base(**base)])


def test_base_that_does_not_hold(comm):
    """A base of one node of a solid leaves it free to turn."""
    base = Base(on=(1,), directions=("z",))
    with (hpcred.solid((2, 1, 1), clamped=False, comm=comm) as model,
          pytest.raises(hpcred.InputError, match="the body moves freely")):  # fmt: skip
        model.with_bases([base])


@pytest.mark.mpi(ranks=(1,))
def test_job(comm, tmp_path, monkeypatch, capsys):
    """A job with [[base]], evaluated against its full model, which is made again from its record."""
    from hpcred.cli.main import run
    from hpcred.readers.frf import read_frf

    monkeypatch.chdir(tmp_path)
    model, *_ = straight(comm, damping=1e-5)
    with model, model.with_input_columns(None, ()) as bare:
        hpcred.write_model("model.h5", bare)
    job = """
    model = "model.h5"
    output = "result.h5"
    outputs = [[9, "z"]]
    [damping]
    kind = "given"
    [[basis]]
    kind = "modes"
    count = 5
    [[base]]
    on = [1]
    directions = ["z"]
    absolute = [[9, "z"]]
    """
    (tmp_path / "job.toml").write_text(job)
    assert run(["reduce", "job.toml"]) == 0
    report = hpcred.evaluate("result.h5", "model.h5", frequencies=[3.0, 50.0], output="responses.h5")
    assert max(report["eps"]) < 1e-2
    # the file may have the base already, or another one beside which the job names its own
    with hpcred.read_model("model.h5") as bare, bare.with_outputs([(9, "z")]) as sensed:
        with sensed.with_bases([Base(on=(1,), directions=("z",), absolute=((9, "z"),))]) as shaken:
            hpcred.write_model("shaken.h5", shaken)
        with sensed.with_bases([Base(name="foot", on=(1,), directions=("x", "z"))]) as shaken:
            hpcred.write_model("foot.h5", shaken)
    again = hpcred.evaluate("result.h5", "shaken.h5", frequencies=[3.0, 50.0])
    np.testing.assert_allclose(again["eps"], report["eps"])
    (tmp_path / "two.toml").write_text(job.replace("model.h5", "foot.h5").replace("result.h5", "two.h5").replace(
        "on = [1]", "on = [9]").replace("[[9, \"z\"]]", "[[5, \"z\"]]"))
    assert run(["reduce", "two.toml"]) == 0
    assert hpcred.read_result("two.h5").reduced.input_names == ("foot:x", "foot:z", "base:z")
    assert max(hpcred.evaluate("two.h5", "foot.h5", frequencies=[3.0, 50.0])["eps"]) < 0.2
    # an acceleration is no force at a node called base
    with pytest.raises(hpcred.InputError, match="found no input but base:z, accelerations of bases"):
        read_frf("responses.h5")
    assert refused(capsys, "evaluate", "result.h5", "model.h5", "--frequencies", "3,50", "-o", "responses.unv")
    (bases,) = hpcred.info("job.toml")["bases"]
    assert bases == {"base": "base", "inputs": "base:z", "on": "(1,)", "absolute": "9:z"}
    (tmp_path / "machine.toml").write_text(
        'output = "machine.h5"\n[[body]]\nname = "beam"\nresult = "result.h5"\n[[joint]]\n'
        'bodies = ["beam.9", "ground"]\nkind = "rigid"\n'
    )
    assert "moves relative to a base of its own" in refused(capsys, "assemble", "machine.toml")
    (tmp_path / "job.toml").write_text(job.replace("on = [1]", ""))
    assert "base 'base': model.h5 has no held nodes" in refused(capsys, "reduce", "job.toml")


def test_mass_on_a_spring(comm):
    """Transmissibility of a mass on a spring and a damper, (k + s d) / (k + s d + s^2 m), and Miles' equation."""
    m, k, d = 2.0, 8e4, 40.0
    spring = np.array([[1.0, -1.0], [-1.0, 1.0]])
    dofs = hpcred.Dofs(np.array([1, 2]), np.array([2, 2]), np.array([[0.0, 0, 0], [0, 0, 1]]))
    base = Base(on=(1,), directions=("z",), absolute=((2, "z"),))
    with (hpcred.SecondOrderModel.from_scipy(k * spring, np.diag([1.0, m]), d * spring, comm, dofs=dofs, held=NONE)
          as model, model.with_bases([base]) as shaken):  # fmt: skip
        reduced = hpcred.reduce(shaken, [hpcred.Modes(count=1)], damping=hpcred.GivenDamping())
        H = shaken.frequency_response(F, damping=hpcred.GivenDamping())[:, 0, 0]
    s = 2j * np.pi * F
    exact = (k + s * d) / (k + s * d + s * s * m)
    np.testing.assert_allclose(H, exact, rtol=1e-10)
    np.testing.assert_allclose(reduced.frequency_response(F)[:, 0, 0], exact, rtol=1e-10)
    ratio = d / 2 / np.sqrt(k * m)
    found = hpcred.analysis.random_response(reduced, [1e-2, 1e5], np.ones((2, 1))).rms[0] ** 2
    assert found == pytest.approx(np.sqrt(k / m) / 8 / ratio * (1 + 4 * ratio**2), rel=2e-3)


def test_large_mass(comm):
    """A mass far heavier than the body, pushed as it needs for this acceleration, moves the body alike."""
    model, M, D, K = straight(comm, damping=1e-5)
    with model, _on_base(model, (9, "z")) as shaken:
        H = shaken.frequency_response(F, damping=hpcred.GivenDamping())[:, 0, 0]
    rows, large = np.setdiff1d(np.arange(54), [0, 1, 3, 4, 5]), 1e7 * np.trace(M)
    at, found = np.flatnonzero(rows == 2)[0], []
    heavy = M.copy()
    heavy[2, 2] += large
    for s in 2j * np.pi * F:
        A = (s * s * heavy + s * D + K)[np.ix_(rows, rows)]
        found.append(s * s * np.linalg.solve(A, large * np.eye(len(rows))[at])[rows == 50][0])
    np.testing.assert_allclose(H, found, rtol=1e-4)


@pytest.mark.parametrize("quantity", few_on_ranks(["displacement", "velocity"]))
@pytest.mark.costly
def test_other_motions_as_input(comm, quantity, tmp_path):
    """Displacements and velocities of a base as inputs, alone and beside a force, in the matrices of the state space:
    as the accelerations times powers of s; outputs that would need their derivatives go."""
    model, *_ = straight(comm, damping=1e-5)
    base = Base(on=(1,), directions=("z", "ry"), absolute=((9, "z"),))
    order = {"displacement": 2, "velocity": 1}[quantity]
    outputs = [(9, "z"), hpcred.outputs.MotionOutput(node=5, direction="z", quantity="velocity")]
    for forces in ((), ((5, "z"),)):
        with (model.with_inputs(forces) if forces else model.with_input_columns(None, ()) as pushed,
              pushed.with_outputs(outputs) as sensed, sensed.with_bases([base]) as shaken):  # fmt: skip
            reduced = hpcred.reduce(shaken, [hpcred.Modes(count=12)], damping=hpcred.GivenDamping())
            H, s = reduced.transfer_function(2j * np.pi * F), 2j * np.pi * F[:, None, None]
            driven = reduced.driven_by(quantity)
            reduced.close()
        names = ["9:z", *["velocity 5:z"] * (order == 1), f"absolute {quantity} 9:z"]
        assert list(driven.output_names) == names and driven.size == 12 * (1 + bool(forces))
        # an absolute acceleration over s^k b'' is what the absolute motion is over b; over a force it is s^k times more
        kept = H[:, [0, 1, 2] if order == 1 else [0, 2]]
        of_base = kept * np.where(np.arange(len(names)) < len(names) - 1, s[:, :, 0] ** order, 1.0)[:, :, None]
        of_force = kept * np.where(np.arange(len(names)) < len(names) - 1, 1.0, s[:, :, 0] ** -order)[:, :, None]
        expected = np.concatenate([of_force[:, :, : len(forces)], of_base[:, :, len(forces) :]], axis=2)
        np.testing.assert_allclose(driven.transfer_function(2j * np.pi * F), expected, rtol=1e-9, atol=1e-16)
        space = hpcred.state_space(driven)
        at = 2j * np.pi * F[1]
        found = space["C"] @ np.linalg.solve(at * np.eye(len(space["A"])) - space["A"], space["B"]) + space["D"]
        np.testing.assert_allclose(found, expected[1], rtol=1e-7, atol=1e-12)
    model.close()
    with pytest.raises(hpcred.InputError, match="no accelerations of bases any more"):
        driven.driven_by(quantity)
    with pytest.raises(hpcred.InputError, match="found 'jerk', expected one of displacement"):
        driven.driven_by("jerk")


@pytest.mark.mpi(ranks=(1,))
@pytest.mark.costly
def test_direct_part_over_time(comm, tmp_path):
    """Absolute accelerations over time, in a simulation and by the matrices of a .mat, are those of the full model; the
    same for a displacement and a velocity of the base as for its acceleration."""
    pytest.importorskip("scipy_dae")
    from scipy.io import loadmat
    from scipy.signal import lsim

    from hpcred.simulation import Joint, Simulation, SineLoad, TableLoad
    from hpcred.simulation.loads import push_of

    model, *_ = straight(comm, damping=1e-4)
    w, joint = 2 * np.pi * 30.0, Joint(node=1, kind="fixed")
    with _on_base(model, (9, "z")) as shaken:
        whole = hpcred.reduce(shaken, [hpcred.Modes(count=48)], damping=hpcred.GivenDamping())
        t = np.linspace(0.0, 0.03, 2401)
        exact = hpcred.analysis.time_response(whole, t, np.sin(w * t)[:, None])[:, 0]
        hpcred.reduce(shaken, [hpcred.Modes(count=8)], damping=hpcred.GivenDamping()).save(str(tmp_path / "base.h5"))
    model.close()
    result = hpcred.read_result(tmp_path / "base.h5")

    def outputs(load):
        setup = Simulation(end=0.03, steps=24, observe=(9,), constraint=(joint,), load=(load,),
                           relative_tolerance=1e-6, absolute_tolerance=1e-11)  # fmt: skip
        return hpcred.simulate(result.body([1, 9]), setup).outputs[:, 0]

    np.testing.assert_allclose(outputs(SineLoad("base:z", 1.0, 30.0)), exact[::100], atol=1e-3 * np.abs(exact).max())
    # a base at rest until it moves at once: the velocity jumps, and the states with it
    space, times = result.reduced.to_state_space(), (-0.02, 0.01, 0.02, 0.06)
    table = TableLoad("base:z", times, (1 / w, 1 / w, 0.0, 2 / w), quantity="velocity")
    for load in (SineLoad("base:z", -1 / w**2, 30.0, np.pi / 4, quantity="displacement"), table,
                 SineLoad("base:z", 1 / w, 30.0, -np.pi / 2, quantity="velocity")):  # fmt: skip
        jump = {"displacement": -np.cos(load.phase), "velocity": np.sin(load.phase)}[load.quantity] / w if (
            load is not table) else 1 / w
        accelerations = np.array([load(time) for time in t])
        by_jump = lsim((space.A, space.B, space.C, space.D), accelerations, t, X0=space.B[:, 0] * jump)[1]
        np.testing.assert_allclose(outputs(load), by_jump[::100], atol=2e-3 * np.abs(by_jump).max())
    hpcred.export(tmp_path / "base.h5", path=tmp_path / "a_statespace.mat")
    arrays = loadmat(tmp_path / "a_statespace.mat")
    y = lsim(tuple(arrays[key] for key in "ABCD"), np.sin(w * t), t)[1]
    np.testing.assert_allclose(y, exact, atol=5e-3 * np.abs(exact).max())
    assert hpcred.export(tmp_path / "base.h5", path=tmp_path / "b_statespace.mat", base="velocity")["outputs"] == [
        "absolute velocity 9:z"
    ]
    with pytest.raises(hpcred.InputError, match="--base: 'sid' has no inputs for the motion of a base"):
        hpcred.export(tmp_path / "base.h5", "sid", base="velocity")
    # a force has no acceleration
    model, *_ = straight(comm)
    base = Base(on=(1,), directions=("z",), absolute=((9, "z"),))
    with model.with_inputs([(9, "z")]) as pushed, pushed.with_bases([base]) as shaken:
        hpcred.reduce(shaken, [hpcred.Modes(count=2)]).save(str(tmp_path / "pushed.h5"))
    model.close()
    with pytest.raises(hpcred.InputError, match="load.quantity: found velocity for '9:z', which is no motion"):
        load = SineLoad("9:z", 1.0, 30.0, quantity="velocity")
        push_of(load, hpcred.read_result(tmp_path / "pushed.h5").body([9]))


@pytest.mark.ccx
@pytest.mark.mpi(ranks=(1,))
@pytest.mark.parametrize("kind", ["ACCELERATION", "DISPLACEMENT"])
def test_base_motion_of_calculix(comm, tmp_path, kind):
    """*BASE MOTION in *STEADY STATE DYNAMICS, with the same modes. CalculiX prints absolute displacements, and lets
    damping act on the absolute motion, which here is computed beside it."""
    import re

    from calculix_runs import input_lines, run_calculix
    from helpers import to_dense

    count, modes, beta = 6, 8, 1e-5
    corners = ((0, 0), (0.02, 0), (0.02, 0.03), (0, 0.03))
    points = [(*corner, z) for z in np.linspace(0, 0.3, count + 1) for corner in corners]
    bricks = np.array([4 * k + np.arange(8) for k in range(count)])
    tip = 4 * count + 1
    lines = [*input_lines("C3D8", points, bricks), "*NSET, NSET=FEET", "1, 2, 3, 4", "*NSET, NSET=TIP", str(tip),
             "*BOUNDARY", "FEET, 1, 3", "*AMPLITUDE, NAME=ONE", "0., 1., 1e9, 1.", "*STEP"]  # fmt: skip
    run_calculix(tmp_path, "matrices", [*lines, "*FREQUENCY, SOLVER=MATRIXSTORAGE", str(modes)])
    run_calculix(tmp_path, "moved", [
        *lines, "*FREQUENCY, STORAGE=YES", str(modes), "*END STEP", "*STEP", "*STEADY STATE DYNAMICS", "100., 900., 3",
        "*MODAL DAMPING, RAYLEIGH", f", , 0., {beta}", f"*BASE MOTION, DOF=1, AMPLITUDE=ONE, TYPE={kind}",
        "*NODE PRINT, NSET=TIP", "U",
    ])  # fmt: skip
    text = (tmp_path / "moved.dat").read_text().partition("P A R T I C I P A T I O N   F A C T O R S   F O R")[2]
    rows = re.findall(rf"for set TIP and time +(\S+)\s+{tip} +(\S+) +\S+ +(\S+)", text)
    f = np.array([float(row[0]) for row in rows[::2]])
    U = np.array([[float(x) + 1j * float(y) for x, y in zip(a[1:], b[1:], strict=True)]
                  for a, b in zip(rows[::2], rows[1::2], strict=True)])  # fmt: skip
    s = 2j * np.pi * f[:, None]
    U = U * s**2 if kind == "ACCELERATION" else U
    base = Base(directions=("x",), absolute=((tip, "x"), (tip, "z")))
    with (hpcred.readers.load_export(str(tmp_path / "matrices.inp"), comm) as model,
          model.with_bases([base]) as shaken):  # fmt: skip
        K, M = to_dense(model.K), to_dense(model.M)
        along = (model.dofs.direction == 0).astype(float)
        ends = [int(np.flatnonzero((model.dofs.node == tip) & (model.dofs.direction == d))[0]) for d in (0, 2)]
        with hpcred.reduce(shaken, [hpcred.Modes(count=modes)], damping=hpcred.Rayleigh(0.0, beta)) as reduced:
            found = reduced.frequency_response(f)[:, :, 0]
    squares, X = (part[..., :modes] for part in scipy.linalg.eigh(K, M))
    damped = found - beta * s * (X.T @ K @ along / (s * s + s * beta * squares + squares)) @ X[ends].T
    assert len(f) > 5
    np.testing.assert_allclose(damped, U, rtol=1e-3, atol=1e-3 * np.abs(U).max())
    assert np.abs(found.imag - U.imag).max() > 1e-3
