"""Write a Superelement for Mechanical APDL: matrices as Matrix Market, and the input that takes them.

MATRIX50 is read from a binary .sub file, which the program itself makes of the matrices: *DMAT,,IMPORT,MMF takes them,
*EXPORT,,SUB writes them with a table of node and direction of each row (Command Reference, *DMAT, *EXPORT and SE; APDL
Guide, APDL Math). Modal coordinates are displacements UX, UY and UZ of further nodes.
"""

import re

import numpy as np

from ..body.body import check_viscous
from ..parallel.failures import InputError
from .base import SuperelementWriter

LONGEST = 32  # characters of a file name in *EXPORT
ON_A_LINE = 10  # values in one assignment of an array


def _position(position):
    return ",".join(f"{value:.16g}" for value in position)


class Matrix50(SuperelementWriter):
    """Superelements of ANSYS."""

    suffix = "_ansys.inp"
    title, begin = "input of ANSYS that makes a MATRIX50", "! superelement"
    nodes = r"(?m)^N,(?P<node>\d+),.*! (?!modal coordinates$)(?P<name>.+)$"

    def make(self, element, stem):
        check_viscous(element, "a superelement of ANSYS")
        if len(stem) + len("_K.mtx") > LONGEST:
            raise InputError(f"output {stem}: found a name of {len(stem)} characters, expected at most "
                             f"{LONGEST - len('_K.mtx')}, which ANSYS reads; choose a shorter one by -o")  # fmt: skip
        if not re.fullmatch(r"[A-Za-z0-9_-]+", stem):  # a comma ends an argument, a blank or a dot the name
            raise InputError(f"output {stem}: found a name that commands of ANSYS cannot hold, expected letters, "
                             "digits, '_' and '-'; choose another by -o")  # fmt: skip
        # the table of node and direction of each row
        labels = element.labels(directions=3)
        matrices = {"K": ("STIFF", element.K), "M": ("MASS", element.M)}
        if element.D is not None:
            matrices["D"] = ("DAMP", element.D)
        lines = ["! superelement; HPC_R: node and direction (1 to 6: UX to ROTZ) of each row",
                 f"*DIM,HPC_R,ARRAY,{element.size},2"]  # fmt: skip
        for column in range(2):
            for low in range(0, element.size, ON_A_LINE):
                values = ",".join(map(str, labels[low : low + ON_A_LINE, column]))
                lines.append(f"HPC_R({low + 1},{column + 1})={values}")
        lines.append("*DMAT,HPC_ROWS,I,IMPORT,APDL,HPC_R")
        # matrices go into one .sub file, of which the last one closes it
        lines += [f"*DMAT,HPC_{key},D,IMPORT,MMF,{stem}_{key}.mtx" for key in matrices]
        for key, (kind, _) in matrices.items():
            step = "DONE" if key == list(matrices)[-1] else "WAIT"
            lines.append(f"*EXPORT,HPC_{key},SUB,{stem}.sub,{kind},HPC_ROWS,{step}")
        lines += [f"*FREE,HPC_{key}" for key in [*matrices, "ROWS"]]
        lines.append("*DEL,HPC_R,,NOPR")  # or the *DIM of the next body finds an array of another size
        # the element, its nodes, and points of modal coordinates
        lines += ["/PREP7", "*GET,HPC_T,ETYP,0,NUM,MAX", "HPC_T=HPC_T+1", "ET,HPC_T,MATRIX50"]
        for interface in element.interfaces:
            lines.append(f"N,{interface.node},{_position(interface.position)}  ! {interface.name}")
        modal = np.unique(labels[6 * len(element.interfaces) :, 0]).tolist()
        lines += [f"N,{node},{_position(element.centre)}  ! modal coordinates" for node in modal]
        lines += ["TYPE,HPC_T", f"SE,{stem}", "FINISH"]
        # dense matrices, column by column
        head = f"%%MatrixMarket matrix array real general\n{element.size} {element.size}\n"
        files = {f"_{key}.mtx": head + "".join(f"{value:.16e}\n" for value in matrix.ravel(order="F"))
                 for key, (_, matrix) in matrices.items()}  # fmt: skip
        return "\n".join(lines) + "\n", files, [
            *element.remark_on_modal_points(modal),
            "the input follows the manuals and was not tried in the program: compare SELIST and a first modal analysis",
            *element.remarks,
        ]
