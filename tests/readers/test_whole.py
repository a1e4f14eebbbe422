"""Cut files of formats without a mark of their end: every cut is refused, and what is whole is read."""

import gzip
import shutil
from pathlib import Path

import numpy as np
import pytest
from foreign import write
from helpers import to_dense

from hpcred import InputError
from hpcred.readers.model_source import load_export, load_source
from hpcred.settings.source import Source

pytestmark = pytest.mark.mpi(build="real")

DATA = Path(__file__).parents[1] / "data"
REFUSED = "the file is cut off|all matrices need the same size|expected 426|line break"


def block(name):
    """K and M (rows, columns, values) of a block that Abaqus wrote, with both triangles, and its input file."""
    found = {}
    for key, kind in (("K", "STIF"), ("M", "MASS")):
        with gzip.open(DATA / f"{name}_{kind}1.mtx.gz", "rt") as file:
            i, j, v = np.loadtxt(file).T
        found[key] = i.astype(int) - 1, j.astype(int) - 1, v
    return found, (DATA / f"{name}.inp").read_text()


def one_triangle(entries, order):
    """Lines of node, dof, node, dof, value of one triangle, row by row, or with the diagonal first; or of row, column,
    value of both."""
    i, j, v = entries
    if order == "both":
        return [f"{a + 1} {b + 1} {x:.15e}\n" for a, b, x in zip(i, j, v, strict=True)]
    kept = {"lower": j <= i, "upper": j >= i, "diagonal": j <= i}[order]
    i, j, v = i[kept], j[kept], v[kept]
    at = np.lexsort((j, i) if order != "diagonal" else (j, i != j, i))
    return [f"{a // 3 + 1},{a % 3 + 1}, {b // 3 + 1},{b % 3 + 1}, {x:.15e}\n"
            for a, b, x in zip(i[at], j[at], v[at], strict=True)]  # fmt: skip


@pytest.mark.parametrize("order", ["lower", pytest.param("upper", marks=pytest.mark.slow), "diagonal", "both"])
@pytest.mark.parametrize("name", ["blockC3D8", "blockC3D10"])  # with a diagonal mass, and a consistent one
@pytest.mark.costly
def test_no_cut_of_abaqus_matrices_is_read(comm, folder, name, order):
    """At lines in the middle of a row and at its end, of K and of M; a diagonal M had only lost its mass."""
    found, deck = block(name)
    lines = {key: one_triangle(part, order) for key, part in found.items()}
    write(folder / "b.inp", deck, comm)
    endings = {"K": "STIF", "M": "MASS"}
    for key, text in lines.items():
        write(folder / f"b_{endings[key]}1.mtx", "".join(text), comm)
    with load_export(folder / "b.inp", comm) as model:
        assert model.size == 1 + found["K"][0].max() and not any("no mass" in item for item in model.remarks)
    for key, text in lines.items():
        rows = np.array([line.replace(",", " ").split()[0] for line in text])
        ends = np.flatnonzero(rows[1:] != rows[:-1]) + 1  # between two nodes, or two rows
        cuts = {len(text) - 1, len(text) * 7 // 9, len(text) // 2 + 1, int(ends[len(ends) // 2]), int(ends[-2])}
        for cut in cuts - ({len(text) - 1} if order == "diagonal" else set()):  # of the last row itself
            write(folder / f"b_{endings[key]}1.mtx", "".join(text[:cut]), comm)
            with pytest.raises(InputError, match=REFUSED):
                load_export(folder / "b.inp", comm).close()
        write(folder / f"b_{endings[key]}1.mtx", "".join(text), comm)


def test_nodes_without_mass_are_read_where_they_are_meant(comm, folder):
    """A spring between nodes, of which the last one has none, and a part of a material without density."""
    write(
        folder / "K.mtx",
        "".join(f"{n},1,{n},1,2.\n{n},1,{n + 1},1,-1.\n" for n in range(1, 40)) + "40,1,40,1,2.\n",
        comm,
    )
    write(folder / "M.mtx", "".join(f"{n},1,{n},1,3.\n" for n in range(1, 40) if n != 7), comm)
    nodes = write(folder / "n.txt", "".join(f"{n} {n} 0 0\n" for n in range(1, 41)), comm)
    source = Source(K=str(folder / "K.mtx"), M=str(folder / "M.mtx"), nodes=str(nodes))
    with load_source(source, comm) as model:
        assert model.size == 40 and np.trace(to_dense(model.M)) == 38 * 3
        assert any("the last 1 nodes of K have no mass" in item for item in model.remarks)


MAEWING = "sol103_maewing1_femv5p1.pch1"


@pytest.fixture
def maewing(comm, folder):
    """The lines of the punch file, and where those of M begin and end."""
    if comm.rank == 0:
        for file in (DATA / "nastran" / "maewing1").iterdir():
            shutil.copy(file, folder)
        with gzip.open(folder / f"{MAEWING}.gz", "rt") as file:
            (folder / MAEWING).write_text(file.read())
    comm.Barrier()
    lines = (folder / MAEWING).read_text().splitlines(True)
    first = next(k for k, line in enumerate(lines) if line.startswith("DMIG    MAAX"))
    return lines, first, next(k for k, line in enumerate(lines) if line.startswith("DMIG    VAX"))


LISTING = """
0                           MASS AXIS SYSTEM (S)     MASS              X-C.G.        Y-C.G.        Z-C.G.
                                  X            {:.6E}      0.000000E+00  2.528650E-06  0.000000E+00
                                  Y            {:.6E}      9.167286E-03  0.000000E+00  0.000000E+00
"""
WEIGHT = 13.77485  # of the grid point weight generator of this run, of which PARAM,WTMASS makes a mass


@pytest.mark.parametrize("share", [0.1, 0.5, 0.75, 0.95])
def test_a_cut_mass_of_dmig_is_refused(comm, folder, maewing, share):
    """By the point masses of the input file, by the nodes behind it, or by the listing of the run."""
    lines, first, end = maewing
    cut = first + int(share * (end - first))
    write(folder / MAEWING, "".join(lines[:cut] + lines[end:]), comm)
    with pytest.raises(InputError, match="CONM2 of .* sum up to 0.01767|no mass at .* nodes|none on the diagonal"):
        load_export(folder / MAEWING, comm).close()
    write(folder / MAEWING.replace("pch1", "f06"), LISTING.format(WEIGHT, WEIGHT), comm)
    with pytest.raises(InputError, match="grid point weight in .* says 0.03569|none on the diagonal"):
        load_export(folder / MAEWING, comm).close()


@pytest.mark.costly
def test_the_mass_of_a_listing_is_compared(comm, folder, maewing):
    """It is that of M with PARAM,WTMASS; another one is of another run."""
    write(folder / MAEWING.replace("pch1", "f06"), LISTING.format(WEIGHT, WEIGHT), comm)
    with load_export(folder / MAEWING, comm) as model:
        assert any("the mass of M, 0.0356906, is what the grid point" in item for item in model.remarks)
    write(folder / MAEWING.replace("pch1", "f06"), LISTING.format(WEIGHT / 2, WEIGHT / 2), comm)
    with load_export(folder / MAEWING, comm) as model:
        assert any("the two are of different runs" in item for item in model.remarks)
    write(folder / MAEWING.replace("pch1", "f06"), LISTING.format(2 * WEIGHT, 2 * WEIGHT), comm)
    with pytest.raises(InputError, match="grid point weight"):
        load_export(folder / MAEWING, comm).close()


CHAIN = {(i, i): 2.0 for i in range(1, 10)} | {
    (i, i + k): -1.0 for i in range(1, 10) for k in (-1, 1) if 0 < i + k < 10
}


def triplets(entries, header):
    lines = [f"{i} {j} {value}\n" for (i, j), value in entries]
    head = f"%%MatrixMarket matrix coordinate real general\n9 9 {len(lines)}\n" if header else ""
    return head + "".join(lines)


@pytest.mark.parametrize("header", [True, False])
def test_entries_at_one_place_are_counted(comm, folder, header):
    """They are added, as element matrices mean it, and said; a file that stands in itself twice is refused."""
    whole, M = list(CHAIN.items()), [((i, i), 1.0) for i in range(1, 10)]
    again = [((4, 4), 0.5), ((5, 5), 0.5), ((4, 5), -0.5), ((5, 4), -0.5)]
    files = {"K": folder / "K.txt", "M": folder / "M.txt"}
    source = Source(**{key: str(file) for key, file in files.items()})
    write(files["K"], triplets(whole + again, header), comm)
    write(files["M"], triplets(M, header), comm)
    with load_source(source, comm) as model:
        assert any("4 entries of K stand at places that were given before" in item for item in model.remarks)
        assert np.diag(to_dense(model.K)).tolist() == [2, 2, 2, 2.5, 2.5, 2, 2, 2, 2]
    for key, parts in (("K", (2 * whole, M)), ("M", (whole, 2 * M))):
        for name, part in zip("KM", parts, strict=True):
            write(files[name], triplets(part, header), comm)
        with pytest.raises(InputError, match=f"every entry of {key} more than once"):
            load_source(source, comm).close()
