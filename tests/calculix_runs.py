"""Input files of CalculiX for meshes of the tests, and runs of them."""

import subprocess

LONGEST = 16  # numbers in a line of an element


def input_lines(type_, points, elements):
    """Lines of nodes, elements and their material."""
    lines = ["*NODE, NSET=NALL"]
    lines += [f"{n}, " + ", ".join(f"{x:.12e}" for x in point) for n, point in enumerate(points, 1)]
    lines.append(f"*ELEMENT, TYPE={type_}, ELSET=EALL")
    for n, nodes in enumerate(elements + 1, 1):
        numbers = [n, *nodes.tolist()]
        lines += [", ".join(map(str, numbers[k : k + LONGEST])) + ("," if k + LONGEST < len(numbers) else "")
                  for k in range(0, len(numbers), LONGEST)]  # fmt: skip
    lines += ["*MATERIAL, NAME=STEEL", "*ELASTIC", "2.1E11, 0.3", "*DENSITY", "7850."]
    return [*lines, "*SOLID SECTION, ELSET=EALL, MATERIAL=STEEL"]


def run_calculix(folder, name, lines):
    (folder / f"{name}.inp").write_text("\n".join([*lines, "*END STEP", ""]))
    done = subprocess.run(["ccx", name], cwd=folder, capture_output=True, text=True)
    assert done.returncode in (0, 201), done.stdout[-2000:]  # 201: matrices were stored, and nothing solved
