"""Which files a model is in; nothing is read here, so that a job which names a model.h5 loads no reader of others."""

from dataclasses import dataclass

from .toml_file import check_file_names

FILES = ("K", "M", "D", "B", "C", "Cv", "Ca", "nodes", "dofs")


@dataclass(frozen=True)
class Source:
    """The files of a model: K and M, perhaps D, B, C, Cv and Ca; y = C q + Cv q' + Ca q''.

    Parameters
    ----------
    K, M, D : str
        Files of the matrices; D is optional.
    B : str, optional
        Inputs, (n, p).
    C, Cv, Ca : str, optional
        Outputs, (r, n); without Cv and Ca displacements, y = C q.
    nodes : str, optional
        An input file of Abaqus, CalculiX or Nastran, results of CalculiX (.frd), nodes of ANSYS, a universal file, or
        text lines of node, x, y, z in the order of the rows.
    dofs : str, optional
        Text lines of node, direction (1 to 6), one a row of the matrices, or what ANSYS (.mapping) or CalculiX (.dof)
        writes; without it every node has the same number of dofs (1 to 3 displacements, or 6), unless the matrices name
        their rows themselves.
    variables : dict, optional
        Names by K, M, D, B, C, Cv, Ca of matrices in files that hold several.
    """

    K: str
    M: str
    D: str | None = None
    B: str | None = None
    C: str | None = None
    nodes: str | None = None
    dofs: str | None = None
    variables: dict[str, str] | None = None
    Cv: str | None = None
    Ca: str | None = None

    def __post_init__(self):
        check_file_names(**{key: getattr(self, key) for key in FILES})

    @property
    def files(self) -> list[str]:
        """All that are given."""
        return [name for key in FILES if (name := getattr(self, key)) is not None]
