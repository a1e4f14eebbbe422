"""Read input files of Abaqus and CalculiX with the matrix files beside them, which determine the program."""

from ..parallel.failures import InputError, agreed
from ..settings.source import Source
from .abaqus import input_file, matrices
from .base import Reader
from .calculix import matrix_storage
from .source_parts import read_source


def abaqus_source(path) -> Source:
    """Return the matrices of Abaqus beside an input file: block.inp with block_STIF1.mtx, block_MASS1.mtx."""
    return Source(**matrices.files_beside(path), nodes=str(path))


class AbaqusInput(Reader):
    """An input file with its matrices."""

    name = "an Abaqus or CalculiX input file with its matrices beside it"
    told_by = "a keyword such as *Node"
    companions = "x_STIF1.mtx, x_MASS1.mtx, x_DMPV1.mtx; x.sti, x.mas, x.dof (.gz)"
    begins = staticmethod(input_file.begins)

    def read_model(self, path, comm):
        with agreed(comm):
            of_calculix = "K" in matrix_storage.files_of(path)
            if of_calculix and matrices.matrices_beside(path):
                raise InputError(
                    f"{path}: found matrices of both Abaqus and CalculiX beside it; give the .sti file in place of it, "
                    "or -K and -M of Abaqus with --nodes"
                )
            source = None if of_calculix else abaqus_source(path)
        return matrix_storage.read_parts(path, comm) if of_calculix else read_source(source, comm)
