"""Recognise files without matrices that are often given by mistake, and name the file to give instead."""

import re
import zipfile
from pathlib import Path

from ..files.outputs import HDF5, hdf5_kind, kind_of
from ..files.text import first_bytes, shown
from ..parallel.failures import InputError
from .matrices.npz import DAMAGES

NASTRAN = "without matrices; give the .op4 or .pch that the run wrote them to, with its .bdf beside it"
ABAQUS = "without matrices; give the .inp of a run with *Matrix Generate and *Matrix Output, Stiffness, Mass"
CALCULIX = "without matrices; give the .inp or .sti of a run with *FREQUENCY, SOLVER=MATRIXSTORAGE"
MESH = "without matrices; give those that a finite-element program wrote for this mesh"
GMSH = f"{MESH}, and for its nodes and physical groups the mesh as .unv (gmsh -save mesh.msh -o mesh.unv)"
UNPACK = "unpack it first"
ARRAY = "save each matrix by scipy.sparse.save_npz(name, scipy.sparse.csr_matrix(array))"
SHEET = "save what is needed as text: lines of row, column, value, or of node, x, y, z"

BEGINNINGS = tuple(
    (re.compile(pattern), what, instead)
    for pattern, what, instead in (
        (rb"[01]?\s[^%#]{,1500}?(?:NASTRAN|N A S T R A N|MSC\.SOFTWARE)", "a listing of Nastran (.f06, .f04)", NASTRAN),
        (rb"\$(?:MeshFormat|Comments|NOD)\b", "a mesh of Gmsh", GMSH),
        (rb"\$TITLE +=[^\n]*\n\$SUBTITLE *=", "results of Nastran (.pch), no DMIG cards", NASTRAN),
        (rb"\$[^\n]*\n(?:\$[^\n]*\n|[A-Z]\w*\*? |\*)", "cards of Nastran, but first no DMIG or GRID", NASTRAN),
        (rb" {4}1C", "results of CalculiX (.frd)", CALCULIX),
        (rb"\s*(?:S T E P|E I G E N V A L U E) ", "printed results of CalculiX (.dat)", CALCULIX),
        (rb"(?:1\n)?\s*Abaqus[ /]", "a listing of Abaqus (.dat, .msg, .sta)", ABAQUS),
        (rb"\x89SIM", "a results file of Abaqus (.sim)", ABAQUS),
        (rb"\x89HDF(?!\r\n\x1a\n)", "an HDF5 file whose ends of lines were changed", "copy it again as binary"),
        (rb"\x93NUMPY", "an array of NumPy (.npy)", ARRAY),
        (rb"ISO-10303-21", "a drawing (STEP)", MESH), (rb"solid |facet ", "a surface (STL)", MESH),
        (rb"# vtk |(?:<\?xml[^>]*>\s*)?<VTKFile", "a VTK file", MESH),
        (rb"(?:\s*#[^\n]*\n|\s)*model\s*=", "a job of hpcred", "run it by `hpcred reduce`"),
        (rb"7z\xbc\xaf\x27\x1c|Rar!\x1a\x07|BZh\d|\xfd7zXZ|\x28\xb5\x2f\xfd|\x1f\x9d", "a packed file", UNPACK),
        (rb"[\s\S]{257}ustar", "a tar archive", UNPACK),
        (rb"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "a file of Office", SHEET),
    )
)
# of binary files that nothing at their beginning tells
SUFFIXES = {
    ".odb": ("results of Abaqus", ABAQUS), ".fil": ("results of Abaqus", ABAQUS),
    ".xdb": ("results of Nastran", NASTRAN), ".dball": ("a database of Nastran", NASTRAN),
    ".master": ("a database of Nastran", NASTRAN),
    ".db": ("a database of ANSYS", "give the .full of a modal analysis (ANTYPE,MODAL with WRFULL,1)"),
    ".sub": ("a substructure of ANSYS", "export its matrices by APDL Math (*DMAT, *EXPORT as DMIG), and give these by "
             "-K and -M"),
    ".mnf": ("a modal neutral file", "give the matrices of the finite-element program"),
}  # fmt: skip


def refuse_unread(path):
    """Raise InputError where a file, which is of no format that is read, is known; says what to give in its place."""
    start = first_bytes(path)
    known = next((entry[1:] for entry in BEGINNINGS if entry[0].match(start)), None)
    if known is None and start.startswith(b"PK"):
        known = _archive(path)
    if start.startswith(HDF5) and kind_of(path) == hdf5_kind("none"):
        known = "an HDF5 file of a kind that is not known", f"{ARRAY}, or make model.h5 in Python (hpcred.write_model)"
    if known is None and b"\0" in start:
        known = SUFFIXES.get(Path(path).suffix.lower())
    if known is not None:
        raise InputError(f"{path}: found {known[0]}{', ' if known[1].startswith('without') else '; '}{known[1]}")


def _archive(path):
    """Return what a zip archive without arrays is; None for one with arrays, or a damaged one."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except DAMAGES:
        return None
    if any(name.endswith(".npy") for name in names):
        return None
    if any(name.startswith("xl/") for name in names):
        return "a table of Excel (.xlsx)", SHEET
    return f"a zip archive of {', '.join(shown(name.encode(), 40) for name in sorted(names)[:3]) or 'nothing'}", UNPACK
