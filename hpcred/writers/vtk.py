"""Write the shapes of a result for ParaView as one .vtu.

Shapes are those of the basis, whatever damping, inputs and outputs the reduced model has. Names of arrays have only
letters, digits, dots and underscores, which every part of ParaView takes.
"""

import re
from xml.etree import ElementTree

import numpy as np

from ..files.outputs import VTK
from ..files.result_points import Points
from ..parallel.failures import InputError
from ..parallel.petsc import MPI
from .base import Writer
from .vtk_series import mesh_rows, write_instants


def array_name(name: str) -> str:
    """A name without blanks, colons and hyphens: pseudo_mode_07_123.4_Hz."""
    return re.sub(r"[^A-Za-z0-9.]+", "_", name)


def describe(path) -> dict:
    """Return the numbers of points and cells of a .vtu of any program, and the names of its point data. Raises
    InputError for other files of VTK."""
    points, cells, names, group = 0, 0, [], None
    # the file piece by piece, since it may be large
    for event, element in ElementTree.iterparse(path, ("start", "end")):
        if element.tag == "AppendedData":  # bytes that are no XML
            break
        if event == "end":
            element.clear()
        elif element.tag == "VTKFile" and element.get("type") != "UnstructuredGrid":
            raise InputError(f"{path}: found a VTK file of the type {element.get('type')}, expected UnstructuredGrid")
        elif element.tag == "Piece":
            points, cells = points + int(element.get("NumberOfPoints")), cells + int(element.get("NumberOfCells"))
        elif element.tag in ("PointData", "CellData", "Points", "Cells"):
            group = element.tag
        elif element.tag == "DataArray" and group == "PointData" and element.get("Name") not in names:
            names.append(element.get("Name"))
    return {"points": points, "cells": cells, "point_data": names}


class VtkFile(Writer):
    """Shapes for ParaView: all columns as point data, and the node numbers."""

    suffix, needs, kind = ".vtu", "shapes", VTK

    def write(self, target, source):
        with source.shapes() as shapes:
            data = {array_name(name): shapes.displacement(k)[None] for k, name in enumerate(shapes.names)}
            none = np.zeros((0, 3 * len(shapes.nodes)))
            points = Points(shapes.nodes, shapes.points, none, 0, len(shapes.nodes), cells=shapes.cells)
            mesh = mesh_rows(points, MPI.COMM_SELF)
            write_instants([target], mesh, points, data, MPI.COMM_SELF, "<f8")
        return list(data)

    def describe(self, path):
        with open(path, "rb") as file:
            collection = b'type="Collection"' in file.read(500)
        if collection:
            times = [float(dataset.get("timestep")) for dataset in ElementTree.parse(path).iter("DataSet")]
            return {"format": "ParaView collection (.pvd)", "times": len(times), "end_s": times[-1] if times else None}
        return {"format": "VTK file (.vtu)", **describe(path)}
