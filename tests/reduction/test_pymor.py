"""Models to pyMOR and back: the same transfer functions, and pyMOR's own reductors on ours."""

import sys

import numpy as np
import pytest
import scipy.sparse

import hpcred
from hpcred import InputError, Parameter, ParametricModel, Term

N = 40
K = scipy.sparse.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(N, N), format="csr") * 1e6
M = scipy.sparse.eye(N, format="csr") * 0.1
D = 1e-5 * K + 2 * M + scipy.sparse.diags([1.0, -1.0], [-1, 1], shape=(N, N))  # with a gyroscopic part
B = np.eye(N)[:, [10, 30]]
F = np.linspace(1.0, 300.0, 15)
EPS = 1e-12


def by_pymor(model, mu=None):
    return np.array([model.transfer_function.eval_tf(2j * np.pi * f, mu=mu) for f in F])


def close(H, expected, eps=EPS):
    return np.abs(H - expected).max() < eps * np.abs(expected).max()


@pytest.fixture
def pymor_model():
    """A function that makes pyMOR's model of the chain."""
    from pymor.models.iosys import SecondOrderModel

    def make(C=B.T, **more):
        return SecondOrderModel.from_matrices(M, D, K, B, C, name="chain", **more)

    return make


@pytest.mark.peers("pymor")
@pytest.mark.parametrize("outputs", [{}, {"C": B.T[:1]}, {"C": 2 * B.T, "Cv": 1e-3 * B.T}])
def test_a_model_of_pymor_becomes_ours(pymor_model, outputs):
    model = pymor_model(**outputs)
    found = hpcred.from_pymor(model, input_names=("left", "right"))
    assert (found.name, found.input_names) == ("chain", ("left", "right"))
    assert (found.Ct is None) == (not outputs)  # C = B^T is found
    assert close(found.frequency_response(F), by_pymor(model))
    assert close(hpcred.reduce(found, tolerance=1e-4, band=(0, 300)).frequency_response(F), by_pymor(model), 1e-3)


@pytest.mark.peers("pymor")
def test_velocities_of_fewer_outputs_than_inputs(pymor_model):
    """Here pyMOR's own transfer function has the conjugate of Cp + s Cv; that of its first-order form is right."""
    model = pymor_model(C=B.T[:1], Cv=1e-3 * B.T[:1])
    assert close(hpcred.from_pymor(model).frequency_response(F), by_pymor(model.to_lti()))


SCRIPT = """
import numpy as np, hpcred
{}
model = hpcred.solid((2, 2, 2), inputs=1)
rom = hpcred.reduce(model, hpcred.Modes(count=3))
again = hpcred.from_pymor(rom.to_pymor())
assert again.comm.size == 2
H = rom.frequency_response([10.0])
print("equal", np.abs(again.frequency_response([10.0]) - H).max() < 1e-12 * np.abs(H).max())
"""


@pytest.mark.peers("pymor")
def test_pymor_on_several_ranks(tmp_path, hpcred):
    """It would keep the second rank for ever."""
    refused = hpcred(ranks=2, program=("-c", SCRIPT.format("")))
    assert refused.returncode == 1 and "to_pymor: found 2 ranks, of which pyMOR takes all" in refused.stderr
    setting = "'pymor.tools.mpi.event_loop_settings.auto_launch'"
    (tmp_path / "pymor_defaults.py").write_text("d = {" + setting + ": False}")
    done = hpcred(ranks=2, program=("-c", SCRIPT.format("import pymor")))
    assert done.returncode == 0 and done.stdout.count("equal True") == 2


@pytest.mark.peers("pymor")
@pytest.mark.parametrize("rates", [{}, {"Cv": B.T}, {"Cv": B.T, "Ca": 2 * B.T}])
def test_a_reduced_model_becomes_one_of_pymor(rates):
    rom = hpcred.reduce(hpcred.SecondOrderModel(M, D, K, B, **rates), hpcred.Modes(count=6))
    model = rom.to_pymor()
    H = rom.frequency_response(F)
    assert model.order == rom.size and close(by_pymor(model), H)
    if "Ca" in rates:
        with pytest.raises(InputError, match="found outputs D u, which follow the inputs at once, expected D = 0"):
            hpcred.from_pymor(model)
    else:
        assert close(hpcred.from_pymor(model).frequency_response(F), H)


@pytest.mark.peers("pymor")
def test_circulatory_forces_are_declared(pymor_model):
    given = pymor_model()
    given = given.with_(K=given.K.with_(matrix=K + 2e4 * (D - D.T)))
    tolerance = {"tolerance": 1e-4, "band": (0, 300)}
    with pytest.raises(InputError, match="circulatory: found 'yes', expected True or False"):
        hpcred.from_pymor(given, circulatory="yes")
    with pytest.raises(InputError, match="chain: matrix K is not symmetric.*say circulatory = true"):
        hpcred.reduce(hpcred.from_pymor(given), **tolerance)
    rom = hpcred.reduce(hpcred.from_pymor(given, circulatory=True), **tolerance)
    assert close(rom.frequency_response(F), by_pymor(given), 1e-3)
    again = hpcred.from_pymor(rom.to_pymor(), circulatory=True)
    assert again.circulatory and close(again.frequency_response(F), rom.frequency_response(F))


@pytest.mark.peers("pymor")
def test_reductors_of_pymor_work_on_ours():
    from pymor.reductors.sobt import SOBTfvReductor, SOBTpReductor

    rom = hpcred.reduce(hpcred.SecondOrderModel(M, D + 500 * M, K, B), tolerance=1e-5, band=(0, 300))
    H = rom.frequency_response(F)
    small = [kind(rom.to_pymor()).reduce(rom.size - 2) for kind in (SOBTpReductor, SOBTfvReductor)]
    assert all(close(by_pymor(model), H, 0.02) for model in small)
    assert close(hpcred.from_pymor(small[1]).frequency_response(F), by_pymor(small[1]))


def chain_of(terms, names="ew", **outputs):
    parameters = [Parameter(name, (0.5, 2.0)) for name in names]
    return ParametricModel(hpcred.SecondOrderModel(M, D, K, B, **outputs), parameters, [Term(*item) for item in terms])


@pytest.mark.peers("pymor")
def test_parameters_stay_parameters():
    terms = [("K", K, "e^2 + 0.1*sqrt(e) - e"), ("K", K, " 0.25"), ("D", M, "-w/pi"), ("M", M, "abs(w)*0.1*exp(e/2)"),
             ("B", B, "1 + cos(e)")]  # fmt: skip
    rom = hpcred.reduce(chain_of(terms), hpcred.Modes(count=6))
    model = rom.to_pymor()
    assert dict(model.parameters) == {"e": 1, "w": 1}
    for values in ({"e": 0.7, "w": 1.9}, {"e": 1.3, "w": 0.5}):
        H = rom.frequency_response(F, **values)
        assert close(by_pymor(model, model.parameters.parse(values)), H)
        assert close(hpcred.from_pymor(model, values).frequency_response(F), H)
        assert close(by_pymor(rom.at(**values).to_pymor()), H)
    with pytest.raises(InputError, match="found parameters e, w, expected their values in `mu`"):
        hpcred.from_pymor(model)
    with pytest.raises(InputError, match=r"mu: .*incompatible with Parameters"):
        hpcred.from_pymor(model, {"e": 1.0})


@pytest.mark.peers("pymor")
def test_maxwell_elements_beside_parameters_are_coordinates():
    law = hpcred.laws.Maxwell(factors=[0.5, 2.0], times=[1e-3, 1e-4])
    with hpcred.SecondOrderModel(M, D, K, B) as plain, plain.with_viscoelastic([hpcred.Viscoelastic(K, law)]) as model:
        terms = [Term("K", K, "e"), Term("M", M, "e/2"), Term("B", B, "e - 1")]
        rom = hpcred.reduce(ParametricModel(model, [Parameter("e", (0.5, 2.0))], terms), hpcred.Modes(count=4))
    by_parameters = rom.to_pymor()
    assert by_parameters.order == rom.size + 2 * rom.size
    H = rom.frequency_response(F, e=1.7)
    assert close(by_pymor(by_parameters, by_parameters.parameters.parse({"e": 1.7})), H)
    assert close(by_pymor(rom.at(e=1.7).to_pymor()), H)


@pytest.mark.peers("pymor")
def test_an_exponent_of_a_number_is_no_parameter():
    rom = hpcred.reduce(chain_of([("K", K, "1e-1*e1 + 1.e1*e1^2/100")], ["e1"]), hpcred.Modes(count=3))
    model = rom.to_pymor()
    assert close(by_pymor(model, model.parameters.parse({"e1": 1.7})), rom.frequency_response(F, e1=1.7))


@pytest.mark.peers("pymor")
@pytest.mark.parametrize("given, said", [
    ({"damping": hpcred.ModalDamping(0.02)}, "found damping that follows the eigenfrequencies, which is no sum of"),
    ({"damping": hpcred.Structural(0.02)}, "found structural damping, expected viscous or none; take rom.at"),
    ({"outputs": {"Ca": B.T}}, "found outputs that are accelerations, which are no sum of terms in pyMOR"),
    ({"names": "s"}, "found the parameter 's', a name that pyMOR uses itself"),
])  # fmt: skip
def test_parametric_models_that_are_refused(given, said):
    names = given.get("names", "e")
    fom = chain_of([("K", K, names)], names, **given.get("outputs", {}))
    rom = hpcred.reduce(fom, hpcred.Modes(count=3), damping=given.get("damping"))
    with pytest.raises(InputError, match=said):
        rom.to_pymor()
    if names == "s":
        assert rom.at(s=1.0).to_pymor().order == 3


@pytest.mark.peers("pymor")
@pytest.mark.parametrize("made, said", [
    (lambda model: model(sampling_time=0.1), "chain: found discrete time in steps of 0.1 s, expected continuous time"),
    (lambda model: model(D=np.eye(2)), "chain: found outputs D u, which follow the inputs at once, expected D = 0"),
    (lambda model: model().to_lti(), "from_pymor: found LTIModel, expected a SecondOrderModel of pyMOR"),
    (lambda model: model().with_(M=2j * model().M), "found 40 entries with imaginary parts, expected real ones"),
])  # fmt: skip
def test_models_of_pymor_that_are_refused(pymor_model, made, said):
    with pytest.raises(InputError, match=said):
        hpcred.from_pymor(made(pymor_model))


def test_pymor_may_be_missing(monkeypatch):
    rom = hpcred.reduce(hpcred.SecondOrderModel(M, D, K, B), hpcred.Modes(count=3))
    monkeypatch.setitem(sys.modules, "pymor", None)
    monkeypatch.setitem(sys.modules, "pymor.models.iosys", None)
    with pytest.raises(InputError, match="pyMOR is missing .*; install it by `pip install pymor`"):
        rom.to_pymor()
