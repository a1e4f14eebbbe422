"""Describe files that hpcred wrote for other programs and for people, by plain numbers and texts.

Each function takes the name of a file, on one rank.
"""

from __future__ import annotations

import csv
import json
import mmap
import re
import zipfile
from pathlib import Path
from xml.etree import ElementTree

from numpy.lib import format as npy

from ..files import outputs
from ..parallel.petsc import MPI
from ..parallel.plugins import blamed
from ..readers.nodes import uff
from ..writers import vtk as vtk_file
from ..writers.registry import WRITERS

LARGEST_XML = 2**26  # bytes
SHAPE = re.compile(rb"(?m)^ {4}-1\r?\n {4}55\r?\n(.*?)\r?$")  # the name of a dataset 55
SUPERELEMENTS = {  # how they begin, and the name and number of each interface node in them
    "** superelement": ("user element of Abaqus", r"(?m)^\*\* (?!modal coordinates$)(.+)\n(\d+), "),
    "! superelement": ("input of ANSYS that makes a MATRIX50", r"(?m)^N,(\d+),.*! (?!modal coordinates$)(.+)$"),
    "$ external superelement": ("cards of Nastran beside OP4 matrices", r"(?m)^\$ (.+)\nGRID\* +(\d+) "),
}


def universal(path) -> dict:
    """Nodes, elements and shapes of a universal file."""
    nodes, elements = uff.read(path, MPI.COMM_SELF)
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as text:
        shapes = [found[1].decode(errors="replace").strip() for found in SHAPE.finditer(text)]
    return {
        "format": "universal file (UFF)",
        "nodes": len(nodes.label),
        "elements": {kind: len(part) for kind, part in elements.items()} or "none",
        "shapes": shapes,
    }


def vtk(path) -> dict:
    """Points, cells and arrays of a .vtu, or the times of a .pvd."""
    with open(path, "rb") as file:
        collection = b'type="Collection"' in file.read(500)
    if collection:
        times = [float(item.get("timestep")) for item in ElementTree.parse(path).iter("DataSet")]
        return {"format": "ParaView collection (.pvd)", "times": len(times), "end_s": times[-1] if times else None}
    return {"format": "VTK file (.vtu)", **vtk_file.describe(path)}


def mbdyn(path) -> dict:
    """Nodes, modes and mass of a .fem file."""
    with open(path, encoding="latin-1") as file:
        groups = re.split(r"(?m)^\*\* RECORD GROUP (\d+),", file.read())
    words = {number: [line for line in text.splitlines()[1:] if not line.startswith("**")]
             for number, text in zip(groups[1::2], groups[2::2], strict=True)}  # fmt: skip
    return {
        "format": ".fem file of MBDyn's modal joint",
        "coordinates": int(words["1"][0].split()[2]),
        "interface_nodes": " ".join(words["2"]).split(),
        "mass": float(words["12"][0].split()[0]),  # in units that the file does not say
    }


def fmu(path) -> dict:
    """Name, variables and platforms of an FMU."""
    with zipfile.ZipFile(path) as archive:
        about = archive.getinfo("modelDescription.xml")
        if about.file_size > LARGEST_XML:
            raise ValueError(f"{about.filename} unpacks to {about.file_size / 1e6:.0f} MB")
        root = ElementTree.fromstring(archive.read(about))
        platforms = sorted({name.split("/")[1] for name in archive.namelist() if name.startswith("binaries/")})
    variables = list(root.iter("ScalarVariable"))
    by = {key: [item.get("name") for item in variables if item.get("causality") == key] for key in ("input", "output")}
    return {
        "format": f"FMU, FMI {root.get('fmiVersion')}",
        "model": root.get("modelName"),
        "made_by": root.get("generationTool") or "not known",
        "inputs": by["input"],
        "outputs": by["output"],
        "states": sum(real.get("derivative") is not None for real in root.iter("Real")),
        "platforms": platforms,
    }


def arrays(path) -> dict:
    """The arrays of a .npz by name."""
    found = {}
    with zipfile.ZipFile(path) as archive:
        for name in archive.namelist():
            with archive.open(name) as file:  # the head alone
                heads = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
                shape = heads[npy.read_magic(file)](file)[0]
            found[name.removesuffix(".npy")] = " x ".join(map(str, shape)) or "1"
    return {"format": "NumPy arrays (.npz)", "arrays": found}


def superelement(path) -> dict:
    """The interface nodes of a superelement."""
    text = Path(path).read_text(encoding="utf-8", errors="replace")
    name, pattern = next(item for begins, item in SUPERELEMENTS.items() if text.startswith(begins))
    pairs = (sorted(pair, key=str.isdigit) for pair in re.findall(pattern, text))
    return {"format": f"superelement: {name}", "interface_nodes": {name: int(node) for name, node in pairs}}


def table(path) -> dict:
    """Columns and number of lines of a .csv."""
    with open(path, encoding="utf-8", newline="") as file:
        rows = csv.reader(file)
        return {"format": "table (.csv)", "columns": next(rows), "rows": sum(1 for _ in rows)}


def data(path) -> dict:
    """The keys of a JSON file."""
    found = json.loads(Path(path).read_text(encoding="utf-8"))
    keys = list(found if isinstance(found, dict) else found[0] if found else [])
    return {"format": "JSON", "keys": keys, **({} if isinstance(found, dict) else {"rows": len(found)})}


def picture(path) -> dict:
    """Size and frames of a picture in pixels."""
    from PIL import Image

    with Image.open(path) as image:
        size = f"{image.width} x {image.height} pixels"
        frames = getattr(image, "n_frames", 1)
        return {"format": f"{image.format} picture", "size": size, **({"frames": frames} if frames > 1 else {})}


def page(path) -> dict:
    """The title of a report."""
    with open(path, encoding="utf-8") as file:
        title = re.search("<title>(.*?)</title>", file.read(4096), re.S)
    return {"format": "HTML report", "about": title[1] if title else "not known"}


KINDS = {
    outputs.UFF: universal, outputs.VTK: vtk, outputs.MBDYN: mbdyn, outputs.JSON: data, outputs.HTML: page,
    outputs.CSV_OF_RESPONSES: table, outputs.CSV_OF_MOTION: table,
    **dict.fromkeys((outputs.PNG, outputs.GIF, outputs.WEBP), picture),
}  # fmt: skip


def of_other_package(path) -> dict | None:
    """What the package says of a file that its writer takes for its own, or None."""
    with open(path, "rb") as file:
        start = file.read(4096)
    entry = WRITERS.first(lambda writer: writer.begins(start), WRITERS.others) if start else None
    if entry is None:
        return None
    writer = WRITERS.load(entry)
    with blamed(writer):
        return {"format": f"{writer.name} (of the package {writer.package})", **writer.describe(path)}


def description_of(path):
    """The function of this module for a file that no reader of matrices takes, or None."""
    kind = outputs.kind_of(path)
    if kind.startswith(outputs.ZIP):
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
        if "modelDescription.xml" in names:
            return fmu
        return arrays if sum(name.endswith(".npy") for name in names) > 1 and "data.npy" not in names else None
    if kind == outputs.SUPERELEMENT:
        with open(path, "rb") as file:
            start = file.read(30).decode(errors="replace")
        return superelement if start.startswith(tuple(SUPERELEMENTS)) else None
    if kind.startswith(".csv table"):
        return table
    if kind in (outputs.SVG, outputs.PDF) or kind.endswith("of a sweep"):
        return lambda _: {"format": kind}
    return KINDS.get(kind)
