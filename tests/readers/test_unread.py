"""Files that are often given in place of one with matrices: the sentence says what they are and what to give."""

import io
import struct
import zipfile

import h5py
import numpy as np
import pytest
from foreign import assembled, write

from hpcred import InputError
from hpcred.readers.matrix_formats import read_entries
from hpcred.readers.model_source import load_export
from hpcred.readers.source_parts import read_source
from hpcred.settings.source import Source
from hpcred.workflows.info import describe_file

pytestmark = pytest.mark.mpi(build="real")


def archive(*names):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as packed:
        for name in names:
            packed.writestr(name, "*Node\n1, 0., 0., 0.\n")
    return file.getvalue()


FILES = {
    "a.f06": (b"1\n \n \n  TRADE SECRET OF MSC.SOFTWARE CORPORATION\n", "a listing of Nastran", "the .op4"),
    "b.f06": (b"1    MODES    MAY  16, 2018  MSC NASTRAN   PAGE 1\n", "a listing of Nastran", "the .op4"),
    "a.pch": (b"$TITLE   = ROD  1\n$SUBTITLE=    2\n   1   G   0.0\n", "results of Nastran", "or .pch"),
    "b.pch": (b"$\n$  UPDATED ENTRIES\n$\nDESVAR *              10PBAR101\n", "cards of Nastran, but first", "or .pch"),
    "a.xdb": (b"\x00\x04\x00\x00" + 60 * b"\0", "results of Nastran", "the .op4"),
    "a.frd": (b"    1C\n    1UUSER\n", "results of CalculiX", r"SOLVER=MATRIXSTORAGE"),
    "a.dat": (b"\n                        S T E P       1\n\n", "printed results of CalculiX", "SOLVER=MATRIXSTORAGE"),
    "b.dat": (b"\n     E I G E N V A L U E   O U T P U T\n", "printed results of CalculiX", "SOLVER=MATRIXSTORAGE"),
    "c.dat": (b"1\n\n   Abaqus 2023.HF4          Date 02-Apr-2025\n", "a listing of Abaqus", r"\*Matrix Output"),
    "a.sim": (b"\x89SIM\r\n\x1a\n\x06" + 60 * b"\0", "a results file of Abaqus", r"\*Matrix Output"),
    "a.sub": (b"d\0\0\0d\0\0\0" + 60 * b"\0", "a substructure of ANSYS", "APDL Math"),
    "a.odb": (b"?\x01" + 60 * b"\0", "results of Abaqus", r"\*Matrix Output"),
    "a.db": (b"\x07\x01" + 60 * b"\0", "a database of ANSYS", "WRFULL"),
    "a.xlsx": (archive("[Content_Types].xml", "xl/workbook.xml"), "a table of Excel", "as text"),
    "a.zip": (archive("a.inp"), "a zip archive of a.inp", "unpack it first"),
    "a.7z": (b"7z\xbc\xaf\x27\x1c0000", "a packed file", "unpack it first"),
    "a.tar": (257 * b"\0" + b"ustar\x0000" + 249 * b"\0", "a tar archive", "unpack it first"),
    "a.step": (b"ISO-10303-21;\nHEADER;\n", "a drawing", "for this mesh"),
    "a.stl": (b"solid part\n facet normal 0 0 1\n", "a surface", "for this mesh"),
    "a.msh": (b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n", "a mesh of Gmsh", "the mesh as .unv"),
    "a.vtu": (b'<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid">\n', "a VTK file", "for this mesh"),
    "a.toml": (b'# a job\n\nmodel = "model.h5"\n', "a job of hpcred", "hpcred reduce"),
    "a.npy": (b"\x93NUMPY\x01\x00v\x00{'descr'" + 60 * b"\0", "an array of NumPy", "save_npz"),
    "a.h5": (b"\x89HDF\n\x1a\n" + 60 * b"\0", "an HDF5 file whose ends of lines", "copy it again"),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_what_a_file_is_and_what_to_give(comm, folder, name):
    content, what, instead = FILES[name]
    path = write(folder / name, content, comm)
    K = write(folder / "K.txt", "1 1 2.0\n", comm)
    readings = [lambda: load_export(path, comm), lambda: read_entries(path, comm)]
    if name != "a.frd":  # which has nodes
        readings.append(lambda: read_source(Source(str(K), str(K), nodes=str(path)), comm))
    if name not in ("a.vtu", "a.toml"):  # hpcred writes or runs such files, and `info` reads them
        readings.append(lambda: describe_file(path, comm=comm))
    for read in readings:
        with pytest.raises(InputError, match=f"{name}: found {what}.*{instead}"):
            read()


def test_hdf5_of_a_script(comm, folder):
    if comm.rank == 0:
        with h5py.File(folder / "a.h5", "w") as file:
            file["K"] = np.eye(3)
    comm.Barrier()
    for read in (load_export, read_entries):
        with pytest.raises(InputError, match="a.h5: found an HDF5 file of a kind that is not known; save .*save_npz"):
            read(folder / "a.h5", comm)


@pytest.mark.parametrize("number, what", [(2, "element"), (8, "substructure"), (9, "mode shape"), (12, "result")])
def test_other_binary_files_of_ansys(comm, folder, number, what):
    words = [100, -(2**31), number, *99 * [0], 100]
    path = write(folder / "a.rst", struct.pack("<103i", *words) + bytes(4096), comm)
    with pytest.raises(InputError, match=f"kind {number} .{what} file., expected the .full file of a modal analysis"):
        load_export(path, comm)


@pytest.mark.parametrize("head", ["", "\n% of NASTRAN\n", " % N A S T R A N\n", "# Abaqus/Standard\n", "\n\n"])
def test_lines_of_numbers_are_read_whatever_their_remarks_say(comm, folder, head):
    path = write(folder / "a.txt", head + "1 1 2.0\n2 2 3.0\n", comm)
    assert assembled(path, comm).tolist() == [[2, 0], [0, 3]]
