"""Models of parameters: the sum of their terms, which matrices of terms fit, and what is refused."""

import re

import numpy as np
import pytest
import scipy.sparse
from helpers import columns_of, dense_model, few_on_ranks, to_dense

import hpcred
from hpcred import InputError, Parameter, ParametricModel, SecondOrderModel, Term
from hpcred.linalg.matrix_estimates import symmetry_defect
from hpcred.model import second_order_model
from hpcred.model.parameters import parametric_model
from hpcred.model.parameters.definitions import check_terms
from hpcred.parallel.petsc import PETSc

OMEGA = Parameter("omega", (0.0, 8.0), unit="rad/s")
E = Parameter("e", (1.0, 2.0), reference=1.25)


class Given:
    """A solid as arrays, and terms that have entries where it has none."""

    def __init__(self, model):
        rng = np.random.default_rng(5)
        self.comm = model.comm
        self.K, self.M, self.B = dense_model(model)
        n, p = self.B.shape
        self.C = rng.normal(size=(4, n))
        gyroscopic = np.zeros((n, n))
        gyroscopic[0, n - 1], gyroscopic[n - 1, 0], gyroscopic[5, 60] = 2.0, -2.0, 3.0  # unsymmetric
        self.parts = {
            "omega": ("D", gyroscopic),
            "-omega^2": ("K", np.diag(rng.random(n)) * 1e5),
            "e - 1": ("K", self._corner(n, 40, 1e7 * rng.normal(size=(3, 3)))),
            "sqrt(e)/10": ("M", self.M),
            "omega*e": ("B", rng.normal(size=(n, p))),
            "1/e": ("C", rng.normal(size=(4, n))),
        }

    @staticmethod
    def _corner(n, at, block):
        mat = np.zeros((n, n))
        mat[at : at + 3, n - 3 :] = block
        mat[n - 3 :, at : at + 3] = block.T
        return mat

    def model(self, D=None):
        return SecondOrderModel(self.M, D, self.K, self.B, self.C, comm=self.comm)

    def terms(self, change=lambda of, mat: mat):
        return [Term(of, change(of, mat), factor) for factor, (of, mat) in self.parts.items()]

    def expected(self, key, omega, e):
        theta = {"omega": omega, "-omega^2": -(omega**2), "e - 1": e - 1, "sqrt(e)/10": np.sqrt(e) / 10,
                 "omega*e": omega * e, "1/e": 1 / e}  # fmt: skip
        constant = np.zeros_like(self.K) if key == "D" else getattr(self, key)
        return constant + sum(theta[factor] * mat for factor, (of, mat) in self.parts.items() if of == key)


@pytest.fixture
def given(solid):
    return Given(solid)


def as_petsc(like):
    """A function that distributes an array as PETSc's matrices of a model are, that of C as C^T."""
    first, last = like.getOwnershipRange()

    def change(of, mat):
        if of in "BC":
            local = (mat.T if of == "C" else mat)[first:last]
            dense = PETSc.Mat().createDense((like.getSizes()[0], (None, local.shape[1])), comm=like.comm)
            dense.setUp()
            dense.getDenseArray()[...] = local
            dense.assemble()
            return dense
        rows = scipy.sparse.csr_array(mat)[first:last]
        csr = rows.indptr.astype(PETSc.IntType), rows.indices.astype(PETSc.IntType), rows.data
        return PETSc.Mat().createAIJ(like.getSizes(), csr=csr, comm=like.comm)

    return change


@pytest.mark.mpi
@pytest.mark.parametrize("kind", few_on_ranks(["PETSc", "sparse", "arrays"], 2))
def test_sums_at_random_values(given, kind):
    rng = np.random.default_rng(3)
    with given.model() as constant:
        change = {"arrays": lambda of, mat: mat, "sparse": lambda of, mat: scipy.sparse.coo_array(mat),
                  "PETSc": as_petsc(constant.K)}[kind]  # fmt: skip
        parametric = ParametricModel(constant, [OMEGA, E], given.terms(change))
    with parametric:
        for omega, e in [(0.0, 1.0), *zip(rng.uniform(0, 8, 2), rng.uniform(1, 2, 2), strict=True)]:
            with parametric.at(omega=omega, e=e) as model:
                mats = {key: to_dense(mat) for key, mat in model.matrices.items()}
                mats |= {"B": columns_of(model.B), "C": columns_of(model.Ct).T}
                patterns = {mat.getValuesCSR()[1].tobytes() for mat in model.matrices.values()}
                assert len(patterns) == 1
                assert model.D.transpose().getValuesCSR()[1].tobytes() in patterns
                assert model.loads == () and model.input_names == parametric.input_names
            for key in "MDKBC":
                expected = given.expected(key, omega, e)
                assert np.abs(mats[key] - expected).max() <= 1e-14 * np.abs(expected).max()
        assert np.array_equal(to_dense(parametric.model.K), given.K)
        assert not to_dense(parametric.model.D).any()


@pytest.mark.mpi
def test_response_at_values(given):
    omega, e, frequencies = 2.0, 1.5, [100.0, 4000.0]
    with given.model(1e-6 * given.K) as constant, ParametricModel(constant, [OMEGA, E], given.terms()) as parametric:
        with parametric.at(omega=omega, e=e) as model:
            found = model.frequency_response(frequencies)
        K, D, M, B, C = (given.expected(key, omega, e) for key in "KDMBC")
        for f, H in zip(frequencies, found, strict=True):
            s = 2j * np.pi * f
            expected = C @ np.linalg.solve(s * s * M + s * (D + 1e-6 * given.K) + K, B)
            assert np.abs(H - expected).max() <= 1e-8 * np.abs(expected).max()


@pytest.mark.mpi
def test_models_of_other_values_have_other_digests(given):
    with given.model() as constant, ParametricModel(constant, [OMEGA, E], given.terms()) as parametric:
        keys = ("K", "M", "D", "B", "Ct", "dofs")
        parametric.model.digest_of("K")
        digests = []
        for e in (1.0, 1.0 + 1e-12, 1.5):
            with parametric.at(omega=1.0, e=e) as model:
                digests.append([model.digest_of(key) for key in keys])
        one, close, other = digests
        assert not any(one[k] == other[k] for k in (0, 1, 3, 4)) and one[2] == other[2] and one[5] is None
        assert not any(one[k] == close[k] for k in (0, 1))
        with parametric.at(omega=1.0, e=1.0) as model:
            assert [model.digest_of(key) for key in keys] == digests[0]


@pytest.mark.mpi
def test_no_term_no_copy(given):
    """Matrices without terms are those of the model, and outputs that are the inputs follow B."""
    with (SecondOrderModel(given.M, None, given.K, given.B, comm=given.comm) as constant,
          ParametricModel(constant, [E], [Term("B", given.B, "e")]) as parametric,
          parametric.at(e=2.0) as model):  # fmt: skip
        assert model.K.handle == parametric.model.K.handle == constant.K.handle
        assert model.D is None and model.Ct is None
        assert columns_of(model.B) == pytest.approx(3 * given.B)


def test_symmetry_is_measured_once(given, monkeypatch):
    """Of each matrix and term; a sum is symmetric if its parts are, without another look."""
    seen = []

    def counted(mat, **more):
        seen.append(mat)
        return symmetry_defect(mat, **more)

    for module in (parametric_model, second_order_model):
        monkeypatch.setattr(module, "symmetry_defect", counted)
    n = len(given.K)
    rng = np.random.default_rng(1)
    skew = rng.normal(size=(n, n))
    terms = [Term("K", np.eye(n), "p"), Term("M", np.eye(n), "p"), Term("D", skew - skew.T, "p")]
    with given.model() as model, ParametricModel(model, [Parameter("p", (0.0, 1.0))], terms) as whole:
        for p in (0.2, 0.4, 0.9):
            with whole.at(p=p) as there:
                before = len(seen)
                assert there.is_symmetric("K") and there.is_symmetric("M") and not there.is_symmetric("D")
                assert len(seen) == before


@pytest.mark.mpi
def test_other_inputs_and_outputs(solid):
    K = to_dense(solid.K)
    parametric = ParametricModel(solid, [E], [Term("K", K, "e - 1")])
    with parametric.with_inputs([5]) as loaded, loaded.with_outputs([7, 9]) as both:
        parametric.close()
        assert both.input_names == ("dof 5",) and both.output_names == ("dof 7", "dof 9")
        with both.at(e=2.0) as model:
            found = model.frequency_response([0.0])[0]
    assert found == pytest.approx(np.linalg.inv(2 * K)[[6, 8]][:, [4]], rel=1e-8)


def test_values_of_parameters(solid):
    with ParametricModel(solid, [OMEGA, E], [Term("K", solid.K, "omega*e")]) as parametric:
        assert parametric.reference == {"omega": 4.0, "e": 1.25}
        assert parametric.checked({"e": np.float32(1.5)}) == {"omega": 4.0, "e": 1.5}
        assert parametric.factors({"omega": 2, "e": 2}) == [4.0]
        assert parametric.size == 144 and parametric.name == "solid" and parametric.dofs is solid.dofs
        assert "1 terms over omega 0 to 8, e 1 to 2" in repr(parametric)
        assert "parameters omega 0 to 8 rad/s, e 1 to 2; terms of K (omega*e)" in str(parametric)
        with parametric.at(omega=3) as model:
            assert model.name == "solid at omega = 3, e = 1.25"
        for values, message in (
            ({"omega": 8.01}, "^parameter 'omega': found 8.01, expected 0 to 8 rad/s, its range$"),
            ({"e": 0.5}, "^parameter 'e': found 0.5, expected 1 to 2, its range$"),
            ({"e": np.nan}, "^parameter 'e': found nan, expected 1 to 2"),
            ({"e": "1"}, "^parameter 'e': found '1', expected a number"),
            ({"omgea": 1.0}, r"^parameter 'omgea': there is none of this name \(did you mean 'omega'\?\); there are "),
        ):
            for function in (lambda values: parametric.at(**values), parametric.checked, parametric.factors):
                with pytest.raises(InputError, match=message):
                    function(values)


@pytest.mark.parametrize(
    ("factor", "where"),
    [
        ("1/omega", "omega = 0"),
        ("log(omega)", "omega = 0"),
        ("sqrt(omega - 6)", "omega = 0"),
        ("(e - 2)^0.5", "e = 1"),
        ("exp(100*omega)", "omega = 0.75"),
        ("1e40*e", "e = 1"),  # finite, but whose squares are not
        ("e/0", "e = 1"),
        ("e/(omega - 1.3)", "e = .*, omega = 1.3"),  # between points that are looked at
        ("(omega - 1.3)^-2", "omega = 1.3"),
        ("1/(e*sqrt(abs(1.3 - omega)))", "e = .*, omega = 1.3"),
        ("log(abs(omega - 1.3))", "omega = 1.3"),
        ("tan(e)", "e = 1.5708"),
        ("1/(omega - 4*e)", "e = .*, omega = "),
        ("1/tan(omega - 3.1)", "omega = (3.1|6.24159)"),
        ("(omega - 3.1)^(0-1)", "omega = 3.1"),
        ("((omega - 3.1)*(omega - 3.1))^-0.5", "omega = 3.1"),
        ("1/(omega*omega - 9.61)", "omega = 3.1"),
        ("abs(omega - 3.1)^-e", "e = .*, omega = 3.1"),
        ("1/(exp(omega) - exp(3.1))", "omega = 3.1"),
        ("1/(sin(omega) - 0.04)", "omega = "),  # which is zero at 3.1016 and 6.3232
        ("1/(abs(omega - 3.1) + abs(e - 1.37))", "e = 1.37, omega = 3.1"),
    ],
)
def test_factors_without_a_value_in_the_ranges_are_refused(factor, where):
    """Early, with the term, the factor and the values; terms need no matrix for it."""
    message = (
        rf"^term of K: factor '{re.escape(factor)}': found (?:no number of -1e\+30 to 1e\+30 at|a pole, or what cannot "
        rf"be told from one, near) ({where}.*), expected a number in all of the ranges \(omega 0 to 8 rad/s, e 1 to 2"
        r"\); change the range or the factor$"
    )
    term = Term("K", None, factor)
    with pytest.raises(InputError, match=message) as error:
        check_terms((OMEGA, E), [Term("M", None, "omega*e"), term])
    found = dict(item.split(" = ") for item in re.match(message, str(error.value))[1].split(", "))
    values = {name: float(value) for name, value in found.items()}
    with pytest.raises(InputError, match="beyond|found no finite number"):
        if abs(term.expression.at(values)) > 1e4:
            raise InputError("beyond")


@pytest.mark.parametrize(
    "factor",
    ["1/(omega + 0.1)", "sqrt(e - 1)", "log(e)*omega", "tan(omega/6)", "1/tan(e)", "1/(1 + tan(e/1.5))", "omega^omega",
     "1/(omega^2 - 4*e + 9)", "1/((omega - 3.1)^2 + 1e-9)", "sqrt(e - 1)*omega", "sqrt(1 - (omega/8)^2)",
     "1/(omega^2 - 2*omega + 1.001)", "sqrt(omega*omega)", "abs(omega - 3)^e", "(omega - 3.1)^(3-1)"],
)  # fmt: skip
def test_factors_with_values_in_all_of_the_ranges(factor):
    check_terms((OMEGA, E), [Term("K", None, "omega*e"), Term("K", None, factor)])


def test_factors_of_many_parameters():
    many = tuple(Parameter(f"p{i}", (-1.0, 1.0)) for i in range(8))
    names = [item.name for item in many]
    check_terms(many, [Term("K", None, f"1/(9 + {' + '.join(names)})")])
    with pytest.raises(InputError, match="found a pole, or what cannot be told from one, near p0 = "):
        check_terms(many, [Term("K", None, f"1/(7.5 + {' + '.join(names)})")])


@pytest.mark.mpi
def test_zero_matrices_and_factors(solid):
    """The model is the one without these terms, and no zero makes it circulatory."""
    n, p = solid.size, len(solid.input_names)
    zero = scipy.sparse.csr_array((n, n))
    terms = [Term("K", zero, "e"), Term("M", np.zeros((n, n)), "e"), Term("D", zero, "e"),
             Term("B", np.zeros((n, p)), "e"), Term("K", solid.K, "0*e")]  # fmt: skip
    with ParametricModel(solid, [E], terms) as parametric:
        assert not parametric.model.circulatory
        with parametric.at(e=1.7) as model:
            assert np.array_equal(to_dense(model.K), to_dense(solid.K)) and not to_dense(model.D).any()
            assert model.frequency_response([100.0]) == pytest.approx(solid.frequency_response([100.0]), rel=1e-9)


def test_a_skew_term_of_k_is_circulatory(comm):
    """A shaft with internal damping d: K = k I + omega d J, so that H = (a I - omega d J) / (a^2 + (omega d)^2) with
    a = s^2 + c s + k; a symmetric term and one that acts one way declare nothing."""
    J, eye, frequencies = np.array([[0.0, 1.0], [-1.0, 0.0]]), np.eye(2), np.array([0.0, 2.0, 15.0])
    with SecondOrderModel(eye, 3.0 * eye, 9e3 * eye, eye, comm=comm) as constant:
        for mat, skew in ((J, True), (np.array([[0.0, 1.0], [1.0, 0.0]]), False), (np.triu(J), False)):
            terms = [Term("M", eye, "0*omega"), Term("K", mat, "0.8*omega")]
            with ParametricModel(constant, [OMEGA], terms) as parametric:
                assert parametric.model.circulatory == skew
        with (
            ParametricModel(constant, [OMEGA], [Term("K", J, "0.8*omega")]) as parametric,
            parametric.at(omega=7.0) as model, hpcred.reduce(model, hpcred.Krylov(frequency=1.0)) as rom,
        ):  # fmt: skip
            found = rom.frequency_response(frequencies)
    s = 2j * np.pi * frequencies[:, None, None]
    a, b = s**2 + 3.0 * s + 9e3, 5.6
    expected = (a * eye - b * J) / (a**2 + b**2)
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


@pytest.mark.mpi
def test_mass_that_turns_negative_is_refused(solid):
    message = r"^solid at e = 1.5: the mass matrix has a negative diagonal entry"
    with ParametricModel(solid, [E], [Term("M", to_dense(solid.M), "-e")]) as parametric:
        with parametric.at(e=1.0) as model:
            assert not to_dense(model.M).any()
        with pytest.raises(InputError, match=message):
            parametric.at(e=1.5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("2w", (0.0, 1.0)), "^parameter.name: found '2w', expected letters, digits and _, a letter first"),
        (("lambda", (0.0, 1.0)), "^parameter.name: found 'lambda', expected .* words of Python, such as lambda"),
        (("pi", (0.0, 1.0)), "^parameter.name: found 'pi', expected .* none of sqrt, .*, pi"),
        (("e", (2.0, 1.0)), r"^parameter 'e': range: found \[2.0, 1.0\], expected a lower and a higher value"),
        (("e", (1.0, 1.0)), r"expected a lower and a higher value; a parameter of one value is none: "),
        (("e", (1e9, 1e9 + 1e-6)), "expected a lower and a higher value"),
        (("e", (0.0, np.inf)), "^parameter 'e': range: found inf, expected a finite number"),
        (("e", (0.0, 1.0), 1.5), "^parameter 'e': reference: found 1.5, expected a value in 0 to 1"),
        (("e", (0.0, 1.0), np.nan), "reference: found nan"),
        (("e", 3.0), "^parameter.range: found 3.0, expected"),
    ],
)
def test_parameters_that_are_none_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        Parameter(*arguments)


SIZE = 144


@pytest.mark.parametrize(
    ("of", "change", "message"),
    [
        ("K", lambda mat: mat[:9, :9], "^term of K, factor 'e': found a matrix of 9 x 9, expected 144 x 144, as that"),
        ("K", lambda mat: mat[:9], "^term of K, factor 'e': found .*, expected a square matrix of numbers"),
        ("M", lambda mat: "M.mtx", "^term of M, factor 'e': found .*, expected a square matrix of numbers"),
        ("K", lambda mat: mat + 1j, "^term of K, factor 'e': found .* entries with imaginary parts, expected real"),
        ("D", lambda mat: mat * np.nan, "^term of D, factor 'e': found NaN or Inf, expected finite numbers"),
        ("B", lambda mat: mat[:, :2], "^term of B, factor 'e': found a matrix of 144 x 2, expected 144 x 3"),
        ("B", lambda mat: mat[:, :3] * np.nan, "^term of B, factor 'e': found NaN or Inf in column 1"),
        ("B", lambda mat: mat[0], r"^term of B, factor 'e': found a matrix of 144, expected 144 x 3"),
        ("C", lambda mat: mat[:3], r"^term of C, factor 'e': solid has the inputs as outputs, C = B\^T; give it out"),
        ("K", lambda mat: PETSc.Mat().createAIJ((144, 144), comm=PETSc.COMM_SELF), "matrix is not assembled; call"),
    ],
)
def test_matrices_that_do_not_fit_are_refused(solid, of, change, message):
    with pytest.raises(InputError, match=message):
        ParametricModel(solid, [E], [Term(of, change(to_dense(solid.K)), "e")])


@pytest.mark.mpi(ranks=(2,), build="real")
def test_another_layout_is_refused(solid):
    first = solid.comm.rank == 0
    mat = PETSc.Mat().createAIJ(((100 if first else 44, SIZE), (100 if first else 44, SIZE)), comm=solid.comm)
    mat.setUp()
    mat.assemble()
    with pytest.raises(InputError, match=r"this rank has the rows \(0, 100\) of it, but the rows \(0, 72\) of the mo"):
        ParametricModel(solid, [E], [Term("K", mat, "e")])


@pytest.mark.parametrize(
    ("parameters", "terms", "message"),
    [
        ([], [("K", "2")], "^parameters: found no parameter, or no term; expected one of each at least"),
        ([E], [], "found no parameter, or no term"),
        ([E, E], [("K", "e")], "^parameters: found the names e, e, expected each once"),
        ([E], [("K", "e*omega")], "^term of K: factor 'e.omega': found 'omega', expected the parameters e"),
        ([E, OMEGA], [("K", "e*omgea")], r"found 'omgea' \(did you mean 'omega'\?\), expected"),
        ([E, OMEGA], [("K", "e")], "^parameter 'omega': found it in the factor of no term; give its terms, or leave"),
        (E, [("K", "e")], r"^parameters: found Parameter\(.*, expected a list of"),
    ],
)
def test_parameters_and_terms_that_do_not_fit_are_refused(solid, parameters, terms, message):
    with pytest.raises(InputError, match=message):
        ParametricModel(solid, parameters, [Term(of, solid.K, factor) for of, factor in terms])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("G", None, "e"), "^term.of: found 'G', expected 'M' or 'D' or 'K' or 'B' or 'C'"),
        (("K", None, 2.0), "^term.factor: found 2.0, expected a text"),
        (("K", None, "e +"), "^expression 'e .': found .*syntax"),
    ],
)
def test_terms_that_are_none_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        Term(*arguments)


def test_a_closed_model_is_refused(solid):
    other = solid.shared()
    other.close()
    with pytest.raises(InputError, match="^solid: this model was closed"):
        ParametricModel(other, [E], [Term("K", None, "e")])


def test_inputs_that_have_terms_stay(given):
    with given.model() as constant, ParametricModel(constant, [OMEGA, E], given.terms()) as parametric:
        for what, key in (("inputs", "B"), ("outputs", "C")):
            with pytest.raises(InputError, match=f"^model: it has terms of {key}, which belong to the {what} that it"):
                getattr(parametric, f"with_{what}")([1])
    assert hpcred.Term is Term


def test_section_forces_beside_terms_of_k_are_refused():
    """They would be those of the constant part of K alone."""
    term = Term("K", np.eye(81), "omega")
    with hpcred.solid((3, 2, 2), inputs=1) as block:
        tip = np.unique(block.dofs.node[block.dofs.position[:, 0] > 0.6 * block.dofs.position[:, 0].max()])
        with block.with_fields(sets={"TIP": tip}) as body:
            cut = [hpcred.outputs.CutOutput(cut="TIP", component="fx")]
            with body.with_outputs(cut) as measured, pytest.raises(InputError, match="outputs that are section forces"):
                ParametricModel(measured, [OMEGA], [term])
            with (
                ParametricModel(body, [OMEGA], [term]) as model,
                pytest.raises(InputError, match="outputs that are section forces"),
            ):
                model.with_outputs(cut)


def test_weight_is_that_of_the_constant_mass():
    weight = hpcred.loads.Gravity(name="g", value=(0.0, 0.0, -9.81))
    with hpcred.solid((3, 2, 2), inputs=1) as block, block.with_loads([weight]) as body:
        terms = [Term("M", np.eye(81), "omega"), Term("K", np.eye(81), "omega")]
        with ParametricModel(body, [OMEGA], terms) as model, ParametricModel(body, [OMEGA], terms[1:]) as other:
            assert "that of the constant part of M" in model.model.loads[0].remark
            assert "constant part" not in other.model.loads[0].remark
            with model.at() as reference:
                assert "that of the constant part of M" in reference.loads[0].notes[0]
