"""Parameters and terms in job files: matrices from files of all kinds, terms of rotation, and what is refused."""

import re
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from helpers import columns_of, refused, to_dense

import hpcred as package
from hpcred import InputError
from hpcred.cli.main import run
from hpcred.settings import read_job
from hpcred.workflows.model_of_job import model_of_job

PARAMETER = """
[[parameter]]
name = "omega"
range = [0.0, 800.0]
unit = "rad/s"
"""
JOB = """
model = "model.h5"
inputs = [[20, "z"], [22, "x"]]
""" + PARAMETER
BASIS = '[[basis]]\nkind = "modes"\ncount = 3\n'
TERM = '[[term]]\nof = "D"\nfile = "{}"\nfactor = "omega"\n'
GIVEN = PARAMETER + TERM.format("G")
CORIOLIS = PARAMETER + '[[term]]\nkind = "coriolis"\n'


@pytest.fixture
def body(folder, comm):
    """A folder with the block as model.h5, and an antisymmetric matrix of its size."""
    with package.solid((3, 2, 2), comm=comm) as model:
        package.write_model(folder / "model.h5", model)
        labels = [np.concatenate(comm.allgather(part)) for part in (model.dofs.node, model.dofs.direction)]
        size = model.size
    rng = np.random.default_rng(4)
    G = rng.normal(size=(size, size)) * (rng.random((size, size)) < 0.02)
    return folder, G - G.T, labels


def written(comm, write):
    """Have rank 0 write files."""
    if comm.rank == 0:
        write()
    comm.Barrier()


def model_of(folder, comm, text):
    written(comm, lambda: (folder / "job.toml").write_text(text + BASIS))
    return model_of_job(read_job(folder / "job.toml"), comm)


def write_labelled(path, G, labels, more=""):
    i, j = np.nonzero(G)
    node, dof = labels[0], labels[1] + 1
    lines = [f"{node[a]},{dof[a]},{node[b]},{dof[b]},{G[a, b]!r}\n" for a, b in zip(i, j, strict=True)]
    path.write_text("".join(lines).replace("np.float64(", "").replace(")", "") + more)


@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["mtx", "mat", "npz", "labelled"])
def test_matrices_of_files(body, comm, kind):
    folder, G, labels = body
    file = folder / f"gyroscopic.{kind}"

    def write():
        if kind == "mtx":
            scipy.io.mmwrite(file, scipy.sparse.coo_array(G), symmetry="skew-symmetric")
        elif kind == "mat":
            scipy.io.savemat(file, {"G": scipy.sparse.csc_array(G), "K": np.eye(len(G))})
        elif kind == "npz":
            scipy.sparse.save_npz(file, scipy.sparse.csr_array(G))
        else:  # node 1 is held, and has no rows
            write_labelled(file, G, labels, f"1,1,{labels[0][0]},1,5.0\n{labels[0][0]},1,1,1,-5.0\n")

    written(comm, write)
    more = 'variable = "G"\n' if kind == "mat" else ""
    with model_of(folder, comm, JOB + TERM.format(file.name) + more) as parametric:
        assert [item.name for item in parametric.parameters] == ["omega"]
        assert parametric.input_names == ("20:z", "22:x")
        with parametric.at(omega=300.0) as model:
            assert to_dense(model.D) == pytest.approx(300.0 * G, rel=1e-14)
            assert model.K.getValuesCSR()[1].tobytes() == model.D.getValuesCSR()[1].tobytes()


@pytest.mark.mpi
def test_a_force_that_acts_one_way(body, comm):
    """Entries above the diagonal alone, in K that is declared to be circulatory, and the response with them."""
    folder, _, _ = body
    size = len(body[1])
    N = np.zeros((size, size))
    N[2, 17], N[4, 9] = 4e7, -3e7
    written(comm, lambda: scipy.io.mmwrite(folder / "N.mtx", scipy.sparse.coo_array(N)))
    text = JOB + TERM.format("N.mtx").replace('"D"', '"K"')
    with pytest.raises(InputError, match="above the diagonal only.*; of K that .* say circulatory = true"):
        model_of(folder, comm, text)
    with model_of(folder, comm, "circulatory = true\n" + text) as parametric, parametric.at(omega=300.0) as model:
        K, M = to_dense(model.K), to_dense(model.M)
        assert K - to_dense(parametric.model.K) == pytest.approx(300.0 * N, abs=1e-12 * np.abs(K).max())
        B, C = to_dense(model.B), to_dense(model.B if model.Ct is None else model.Ct)
        s = 2j * np.pi * 200.0
        D = 0.0 if model.D is None else to_dense(model.D)
        expected = C.T @ np.linalg.solve(K + s * D + s * s * M, B)
        assert np.abs(model.frequency_response([200.0])[0] - expected).max() < 1e-9 * np.abs(expected).max()


@pytest.mark.mpi
def test_inputs_and_outputs_that_depend_on_parameters(body, comm):
    folder, G, _ = body
    rng = np.random.default_rng(6)
    B, C = rng.normal(size=(len(G), 2)), rng.normal(size=(3, len(G)))

    def write():
        for name, mat in (("B.mtx", B), ("C.mtx", C), ("C1.mtx", 2 * C)):
            scipy.io.mmwrite(folder / name, mat)

    written(comm, write)
    text = JOB.replace("inputs", 'outputs = "C.mtx"\ninputs', 1) + TERM.format("B.mtx").replace('"D"', '"B"')
    with model_of(folder, comm, text + TERM.format("C1.mtx").replace('"D"', '"C"')) as parametric:
        constant = columns_of(parametric.model.B)
        with parametric.at(omega=3.0) as model:
            assert columns_of(model.B) == pytest.approx(constant + 3 * B)
            assert columns_of(model.Ct) == pytest.approx(7 * C.T)


@pytest.mark.mpi
def test_terms_of_rotation(body, comm):
    folder, _, _ = body
    text = JOB + '[[term]]\nkind = "coriolis"\naxis = "z"\nfactor = "omega"\n'
    text += '[[term]]\nkind = "spin_softening"\naxis = [0.0, 0.0, 2.0]\nfactor = "omega^2"\n'
    with model_of(folder, comm, text) as parametric, parametric.at(omega=100.0) as model:
        with package.read_model(folder / "model.h5", comm) as plain:
            terms = package.rotation_terms(plain, "z")
            assert to_dense(model.D) == pytest.approx(100 * to_dense(terms[0].matrix))
            softened = to_dense(plain.K) + 1e4 * to_dense(terms[1].matrix)
        assert to_dense(model.K) == pytest.approx(softened, abs=1e-12 * np.abs(softened).max())


@pytest.mark.mpi
def test_units(body, comm):
    """A term in the units of the files of a model is that of a model converted with it."""
    folder, G, _ = body
    units = package.units_of("mm,t,s")
    with package.read_model(folder / "model.h5", comm) as plain, package.in_si(plain, units) as converted:
        package.write_model(folder / "si.h5", converted)
    K = G @ G.T
    written(comm, lambda: scipy.io.mmwrite(folder / "K.mtx", scipy.sparse.coo_array(K)))
    text = JOB.replace("model.h5", "si.h5") + TERM.format("K.mtx").replace('"D"', '"K"')
    for words, factor in (("mm,t,s", units.energy / units.length**2), ("SI", 1.0)):
        with model_of(folder, comm, f'{text}units = "{words}"\n') as parametric:
            assert to_dense(parametric.terms[0].matrix) == pytest.approx(factor * K, rel=1e-13)
    for message, more in (
        (r'K.mtx: si.h5 was converted to SI from mm, t, s; write units = "SI", or the units of this file', ""),
        ("units: found 'm', expected SI, or three words such as mm,t,s", 'units = "m"\n'),
    ):
        with pytest.raises(InputError, match=message):
            model_of(folder, comm, text + more)
    with pytest.raises(InputError, match="found units = 'mm,t,s' of a term of K, expected those of model.h5, "):
        model_of(folder, comm, text.replace("si.h5", "model.h5") + 'units = "mm,t,s"\n')


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("write", "more", "message"),
    [
        (lambda file, G, labels: scipy.io.mmwrite(file, scipy.sparse.coo_array(G[:9, :9])), "",
         r"G.mtx: found 9 x 9, expected \d+ x \d+, as the matrices of model.h5 have"),
        (lambda file, G, labels: scipy.io.mmwrite(file, scipy.sparse.coo_array(np.triu(G))), "",
         "G.mtx: found entries above the diagonal only, expected both triangles; write it whole, or as"),
        (lambda file, G, labels: scipy.io.mmwrite(file, scipy.sparse.coo_array(G * np.nan)), "",
         "G.mtx: found the value nan in a real matrix, expected finite numbers"),
        (lambda file, G, labels: scipy.io.mmwrite(file, scipy.sparse.coo_array(G)), 'variable = "G"\n',
         "G.mtx: found the name 'G' of a variable for .*Matrix Market.*, which has none"),
        (lambda file, G, labels: scipy.io.savemat(file, {"G": G}, appendmat=False), "",
         "G.mtx: found a file of named matrices; name that of the term, such as variable = 'G'"),
        (lambda file, G, labels: scipy.io.savemat(file, {"G": G}, appendmat=False), 'variable = "N"\n',
         "G.mtx: found no variable 'N' for D; the file has G"),
        (lambda file, G, labels: write_labelled(file, G, labels, f"99999,1,{labels[0][0]},1,5.0\n"), "",
         "G.mtx: found 99999:x, a dof that model.h5 does not have"),
        (lambda file, G, labels: None, "", "G.mtx: no such file"),
    ],
)
def test_files_that_do_not_fit_are_refused(body, comm, write, more, message):
    folder, G, labels = body
    written(comm, lambda: write(folder / "G.mtx", G, labels))
    with pytest.raises(InputError, match=message):
        model_of(folder, comm, JOB + TERM.format("G.mtx") + more)


@pytest.fixture
def job(linkage_folder):
    """A function that writes the job with more tables."""
    text = Path("job.toml").read_text()
    return lambda more: Path("job.toml").write_text(text + more)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (PARAMETER, "parameters: found no parameter, or no term; expected one of each at least"),
        (TERM.format("G.mtx"), "found no parameter, or no term"),
        (PARAMETER.replace("800.0", "-8.0") + TERM.format("G"), r"parameter 'omega': range: found \[0.0, -8.0\], "),
        (PARAMETER + "reference = 900.0\n" + TERM.format("G"), "reference: found 900, expected a value in 0 to 800"),
        (PARAMETER.replace('"omega"', '"2"') + TERM.format("G"), "parameter.name: found '2', expected letters, digits"),
        (PARAMETER.replace("unit", "units") + TERM.format("G"), r"parameter\[0\].units: unknown key .*'unit'"),
        (GIVEN.replace('factor = "omega"', 'factor = "omgea"'), r"found 'omgea' \(did you mean 'omega'\?\), "),
        (GIVEN.replace('factor = "omega"', 'factor = "omega +"'), r"expression 'omega \+': found .*syntax"),
        (GIVEN.replace('factor = "omega"', 'factor = "1/omega"'),
         r"term of D: factor '1/omega': found no number .* at omega = 0, expected a number .*omega 0 to 800 rad/s"),
        (GIVEN.replace("[0.0, 800.0]", "[300.0, 300.0]"), "found .300.0, 300.0., .*; a parameter of one value is none"),
        (GIVEN.replace('factor = "omega"', "factor = 2.0"), r"term\[0\].factor: found 2.0, expected a text"),
        (GIVEN.replace('"D"', '"G"'), r"term\[0\].of: found 'G', expected 'M' or 'D' or 'K'"),
        (GIVEN + 'axis = "z"\n', "term of kind 'matrix': found axis, expected of, file, variab"),
        (PARAMETER + '[[term]]\nof = "D"\nfactor = "omega"\n', "term of kind 'matrix': file: missing; expected of"),
        (CORIOLIS + 'factor = "omega"\n', "term of kind 'coriolis': axis: missing; expec"),
        (CORIOLIS + 'axis = "w"\nfactor = "omega"\n', "axis: found 'w', expected 'x', "),
        (CORIOLIS + 'axis = "z"\nof = "K"\nfactor = "omega"\n', "found of, expe"),
        (PARAMETER + '[[term]]\nkind = "corioli"\naxis = "z"\nfactor = "omega"\n', "found 'corioli', expected"),
        (CORIOLIS + 'axis = "z"\nfactor = "omega"\n', "has mass in rotations"),
        (GIVEN, "G: no such file"),
    ],
)
def test_tables_that_are_wrong_are_refused(job, more, says, capsys):
    job(more)
    assert re.search(says, refused(capsys, "reduce", "job.toml"))


def test_info_lists_parameters_and_terms(job, capsys):
    job(PARAMETER + TERM.format("G.mtx") + '[[term]]\nkind = "spin_softening"\naxis = "x"\nfactor = "omega^2"\n')
    assert run(["info", "job.toml", "--json", "found.json"]) == 0
    said = capsys.readouterr().out
    assert "spin softening about x" in said and "omega^2" in said and "rad/s" in said
    found = package.describe_file("job.toml")
    assert found["parameters"] == [
        {"parameter": "omega", "lowest": 0.0, "highest": 800.0, "reference": 400.0, "unit": "rad/s"}
    ]
    assert [item["of"] for item in found["terms"]] == ["D", "K"]
    assert Path(found["terms"][0]["matrix"]) == Path("G.mtx")


def test_file_names_are_relative_to_the_job(job, tmp_path):
    job(PARAMETER + TERM.format("G.mtx"))
    (tmp_path / "other").mkdir()
    Path("job.toml").rename("other/job.toml")
    found = read_job("other/job.toml")
    assert found.term[0].file == "other/G.mtx" and "other/G.mtx" in found.files
