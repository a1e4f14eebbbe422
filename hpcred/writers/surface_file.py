"""Write the surface of a body beside a format that has no place for it, as an OBJ file in its frame."""

from ..body.body import Body
from ..parallel.failures import InputError

HEAD = "# surface of a body"  # by which files.outputs knows it


def surface_as_obj(body: Body) -> str:
    """Return the triangles as an OBJ file, in the units of the body. Raises InputError where there are none."""
    if body.surface is None:
        raise InputError(
            "--set: surface: the result has no faces of shells or solids, no basis, or too many dofs; leave it out"
        )
    lines = [f"{HEAD}, {len(body.surface.points)} nodes, origin and axes of its frame"]
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in body.surface.points - body.floating_frame.origin]
    lines += [f"f {a} {b} {c}" for a, b, c in body.surface.triangles + 1]
    return "\n".join(lines) + "\n"
