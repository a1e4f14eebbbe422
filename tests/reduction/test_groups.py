"""Groups of ranks give the same model, and fail together."""

import numpy as np
import pytest

import hpcred as package
from hpcred import Buckens, Krylov, Modes, Rayleigh, SecondOrderKrylov, StaticCorrection
from hpcred.cli.main import run
from hpcred.parallel.failures import InputError

FREQUENCIES = np.linspace(5, 295, 30)
JOB = (
    'model = "model.h5"\n[[basis]]\nkind = "krylov"\nfrequency = 100.0\n[[basis]]\nkind = "krylov"\nfrequency = 900.0\n'
)


def responses(model, basis, damping=None, **options):
    with package.reduce(model, basis, Buckens(), damping, **options) as rom:
        return package.frequency_response(rom, FREQUENCIES), rom


def model_of(comm):
    return package.solid((3, 2, 2), inputs=2, comm=comm)


@pytest.mark.mpi
@pytest.mark.parametrize("groups", ["all", "auto"])
def test_groups_give_the_same_model(comm, groups):
    """Every kind of point, more points than groups, modes between; with one rank there is one group."""
    basis = [
        Krylov(frequency=40.0, order=1), Modes(index=(7, 8)), SecondOrderKrylov(frequency=150.0),
        Krylov(frequency=90.0, decay=3.0), StaticCorrection(), SecondOrderKrylov(frequency=260.0, order=1),
    ]  # fmt: skip
    damping = Rayleigh(2.0, 1e-5)
    with package.linkage(comm) as model:
        alone, one = responses(model, basis, damping)
        wanted = comm.size if groups == "all" else groups
        shared, many = responses(model, basis, damping, groups=wanted)
    assert np.abs(shared - alone).max() < 1e-8 * np.abs(alone).max()
    assert one.size == many.size and (one.record.groups, many.record.groups) == (1, comm.size)
    where = [[item.where for item in rom.record.components] for rom in (one, many)]
    assert where[0] == where[1]
    if groups == "all":
        factors = [len(rom.record.factorisations) for rom in (one, many)]
        assert factors[0] <= factors[1] <= factors[0] + 1  # the modes have one of their own
    whole = "a whole number from 1"
    for wrong, expected in ((0, whole), ("all", whole), (comm.size + 1, f"1 to {comm.size}")):
        with pytest.raises(InputError, match=f"groups: found '?{wrong}'?, expected {expected}"):
            package.reduce(model_of(comm), basis, groups=wrong)


@pytest.mark.mpi(ranks=(2,), build="real")
def test_a_refusal_in_one_group_ends_all(comm, folder, capsys):
    """The second point is an eigenfrequency; the first group has nothing against its own."""
    buckens = '[frame]\nkind = "buckens"\n'
    head, points = JOB.split("\n", 1)
    with package.linkage(comm) as model:
        package.write_model(folder / "model.h5", model)
        with package.reduce(model, [Modes(index=[7])], Buckens()) as rom:
            frequency = comm.bcast(float(rom.frequencies[0]))
    if comm.rank == 0:
        (folder / "job.toml").write_text(f"{head}\n{buckens}{points}")
    comm.Barrier()
    assert run(["reduce", str(folder / "job.toml"), "--groups", "2", "--set", f"basis.1.frequency={frequency!r}"]) == 2
    told = "".join(comm.allgather(capsys.readouterr().err))
    assert told.count("hpcred: error: ") == 1 and "is an eigenfrequency of the undamped model" in told


@pytest.mark.mpi
def test_groups_of_a_two_sided_projection(comm):
    with package.solid((6, 3, 3), inputs=2, comm=comm) as model:
        model = model.with_outputs([(96, "z"), (40, "y")])
        basis = [Krylov(frequency=500.0), Krylov(frequency=3000.0)]
        results = [
            package.reduce(model, basis, projection="two_sided", allow_unstable=True, groups=groups)
            for groups in (1, comm.size)
        ]
        alone, shared = (package.frequency_response(rom, FREQUENCIES) for rom in results)
        for rom in results:
            rom.close()
    assert np.abs(shared - alone).max() < 1e-9 * np.abs(alone).max()


@pytest.mark.mpi
@pytest.mark.parametrize("more", [{}, {"points": (20.0,)}])
def test_groups_of_a_search_that_have_nothing_to_prove(comm, more):
    """Three masses are complete after the block that is held back; one point of the user's has nothing before it."""
    K = 1e4 * (2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1))
    adaptive = package.Adaptive(tolerance=1e-6, band=(0.0, 40.0), **more)
    model = package.SecondOrderModel.from_scipy(K, np.eye(3), comm=comm, inputs=np.eye(3)[:, :1])
    with model, package.reduce(model, adaptive=adaptive, groups=comm.size) as rom:
        assert rom.record.accuracy.reached and rom.size <= 3
