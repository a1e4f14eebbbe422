"""Tables that CalculiX prints into .dat files, of two bricks with a linear stress."""

import numpy as np

DECK = """*NODE
1,0.,0.,0.\n2,1.,0.,0.\n3,1.,1.,0.\n4,0.,1.,0.\n5,0.,0.,1.\n6,1.,0.,1.\n7,1.,1.,1.\n8,0.,1.,1.
9,0.,0.,2.\n10,1.,0.,2.\n11,1.,1.,2.\n12,0.,1.,2.
*ELEMENT,TYPE=C3D8
7,1,2,3,4,5,6,7,8\n3,5,6,7,8,9,10,11,12
*ELEMENT,TYPE=SPRINGA
4,1,2
*STEP
*BOUNDARY
*INCLUDE,INPUT=not_here.inc
"""
PLACES = np.array([[x, y, z] for z in (0, 1, 2) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))], float)
GAUSS = (1 - 3**-0.5) / 2, (1 + 3**-0.5) / 2
ORDER = "stresses (elem, integ.pnt.,sxx,syy,szz,sxy,sxz,syz)"
MOVED = "displacements (vx,vy,vz)"


def table(title, rows, time, name="ALL"):
    """The lines of a table, as CalculiX prints them."""
    lines = ["", f" {title} for set {name} and time{time:15.7E}", ""]
    for row in rows:
        count = len(row) - (3 if len(row) == 4 else 6)
        lines.append("".join(f"{int(k):10d}" if j == 0 else f" {int(k):3d}" for j, k in enumerate(row[:count]))
                     + "".join(f" {value:13.6E}" for value in row[count:]))  # fmt: skip
    return "\n".join(lines) + "\n"


def linear_field(seed):
    """Displacements (12, 3), and stresses xx, yy, zz, xy, yz, zx that are linear in the place, as a function."""
    rng = np.random.default_rng(seed)
    constant, slope = rng.standard_normal(6), rng.standard_normal((3, 6))
    return rng.standard_normal((12, 3)), lambda place: constant + place @ slope


def printed(field, time, elements=((7, 0.0), (3, 1.0)), sets=1):
    """Tables of a time: of each element its number and the height of its lower face, in so many sets."""
    moved, stress = field
    text, parts = "", []
    for number, height in elements:
        places = [(x, y, height + z) for z in GAUSS for y in GAUSS for x in GAUSS]
        for k, (xx, yy, zz, xy, yz, zx) in enumerate(map(stress, map(np.array, places)), 1):
            parts.append((number, k, xx, yy, zz, xy, zx, yz))
    for k in range(sets):
        text += table(ORDER, parts[k::sets], time, f"S{k}")
    return text + table(MOVED, [(k, *u) for k, u in enumerate(moved, 1)], time)
