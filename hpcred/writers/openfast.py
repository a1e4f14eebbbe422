"""Write a Superelement for the module ExtPtfm of OpenFAST, which has the support structure of a wind turbine.

The superelement is that of one interface node: rows of M, K and D are x, y, z, rx, ry, rz of it, then modal coordinates
(OpenFAST calls them Guyan and Craig-Bampton modes). Beside it stands the input file of the module, and loads over time,
f(t) = B u(t), from a table of the inputs u. There are two layouts: that of OpenFAST 2.4 to 4, where loads are part of
the superelement, and that of OpenFAST 5, with files of their own for loads and for connection points, and with the
weight of floating bodies in the superelement.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..body.body import check_viscous
from ..files.outputs import SUPERELEMENT
from ..parallel.failures import InputError
from ..readers.motions.table import TIMES, head_of, read_columns
from .base import OF_NAMES, Writer
from .superelement import check_mass

BEGIN = "! ExtPtfm"  # of each file, by which it may be replaced
LINE = 4096  # characters that OpenFAST reads of a line of loads
WIDTH = 17  # of a number there
GRAVITY = 9.80665  # m/s^2 against z, the default of OpenFAST
EVEN = 1e-6  # of a step, by which instants may be off an even grid: OpenFAST counts them
CHANNELS = ("IntrfFx", "IntrfFy", "IntrfFz", "IntrfMx", "IntrfMy", "IntrfMz")


@dataclass(frozen=True, kw_only=True)
class OpenfastOptions:
    """`layout`: "flex" for OpenFAST 2.4 to 4, "keywords" for OpenFAST 5. `loads`: a .csv with
    a column t or time (s) and one for each input that acts, by its name; none: no loads.
    """

    layout: Literal["flex", "keywords"] = "flex"
    loads: str | None = None


class ExtPtfm(Writer):
    """Support structures of OpenFAST."""

    suffix, needs, kind, si, options = "_ExtPtfm.dat", "superelement", SUPERELEMENT, True, OpenfastOptions

    def write(self, target, source):
        element, options = source.superelement, source.options
        check_viscous(element, "OpenFAST")
        if len(element.interfaces) != 1:
            names = ", ".join(node.name for node in element.interfaces)
            raise InputError(
                f"found {len(element.interfaces)} interface nodes ({names}), expected one, on which the tower stands; "
                "moorings and other places are inputs or outputs of the reduction"
            )
        check_mass(element)
        if element.is_free:  # where OpenFAST asks for zeros, not for round-off
            K = element.K.copy()
            K[:6] = K[:, :6] = 0.0
            element = replace(element, K=K)
        # the superelement
        times, forces = _loads(options.loads, source.reduced)
        stem, flex = source.stem, options.layout == "flex"
        text = [
            f"{BEGIN} superelement of {stem} for OpenFAST, in kg, m, s and N",
            f"! Flex 5 Format; the first coordinates are x, y, z, rx, ry, rz of {element.interfaces[0].name}",
            f"!Dimension: {element.size}",
        ]
        if flex:
            step = _step(options.loads, times)
            text += [f"!Time increment in simulation: {step:.9g}",
                     f"!Total simulation time in file: {times[-1] - times[0]:.9g}"]  # fmt: skip
        matrices = {"Mass": element.M, "Stiffness": element.K,
                    "Damping": np.zeros_like(element.K) if element.D is None else element.D}  # fmt: skip
        for name, matrix in matrices.items():
            text += ["", f"!{name} Matrix", *[f"!Dimension: {element.size}"] * flex, *_lines(matrix, 16)]
        if not flex:
            weight, change = _weight(element)
            text += ["", "!Weight constant", *_lines([weight], 16), "", "!Weight stiffness", *_lines(change, 16)]
        # loads over time and connection points, in this file or beside it
        history = _history(times, forces)
        points = _points(source, element)
        if flex:
            text += ["", "!Loading", f"!Dimension: 1 time column - {element.size} force columns", *history]
        elif options.loads:
            head = [f"{BEGIN} loads of the coordinates", f"!NSteps: {len(times)}", "", "!Forcing"]
            source.beside["_forces.dat"] = "\n".join([*head, *history, ""])
        if points and not flex:
            source.beside["_points.dat"] = "\n".join(
                [f"{BEGIN} points: nodes {', '.join(node.label for node in points)}", f"!NConn: {len(points)}", "",
                 "!Connections (m)", *_lines([node.position for node in points], 16), "", "!Displacement (m)",
                 *_lines(np.concatenate([node.phi for node in points]), 16), ""]
            )  # fmt: skip
        target.write_text("\n".join([*text, ""]), encoding="utf-8", errors=OF_NAMES)
        floats = element.is_free
        source.beside["_input.dat"] = _module_input(stem, flex, bool(points), bool(options.loads), floats)
        return [*element.remarks, *_remarks(flex, floats, points)]

    def begins(self, start):
        return start.startswith(f"{BEGIN} superelement".encode())

    def describe(self, path):
        with open(path, encoding="utf-8", errors="replace") as file:
            size = next((line.partition(":")[2].strip() for line in file if line.startswith("!Dimension")), "?")
        return {"format": "superelement: ExtPtfm of OpenFAST", "coordinates": size}


def _lines(matrix, digits):
    """Return a line of numbers for each row."""
    return [" ".join(f"{value: .{digits}e}" for value in row) for row in np.asarray(matrix).tolist()]


def _weight(element):
    """Return W0 (m,) and K_W (m, m): the weight is W0 - K_W x in axes that turn with the interface; zero if held."""
    weight, change = np.zeros(element.size), np.zeros((element.size, element.size))
    if element.is_free:  # its first coordinates are motions of the rigid body, and the modal ones see its accelerations
        weight[:] = -GRAVITY * element.M[:, 2]
        change[:, 3], change[:, 4] = GRAVITY * element.M[:, 1], -GRAVITY * element.M[:, 0]
    return weight, change


def _points(source, element):
    """Return the shapes of nodes other than that of the interface."""
    return [node for node in source.result.nodes if node.node != element.interfaces[0].node]


def _loads(path, reduced):
    """Return instants (t,) and forces (t, m) of a table of the inputs; without one zeros at two instants. Raises
    InputError."""
    if not path:
        return np.array([0.0, 1.0]), np.zeros((2, reduced.size))
    names, start = head_of(path)
    if names[0].lower() not in TIMES:
        raise InputError(f"{path}: found the first column '{names[0]}', expected t or time")
    for name in names[1:]:
        if name not in reduced.input_names:
            raise InputError(
                f"{path}: found a column '{name}', expected names of inputs: {', '.join(reduced.input_names)}"
            )
    table = read_columns(path, start, len(names))
    times = table[:, 0]
    if len(times) < 2 or not (np.diff(times) > 0).all():
        raise InputError(f"{path}: found {len(times)} instants, expected two or more in ascending order")
    B = reduced.B[:, [reduced.input_names.index(name) for name in names[1:]]]
    return times, table[:, 1:] @ B.T


def _step(path, times):
    """Return the step of even instants. Raises InputError."""
    step = (times[-1] - times[0]) / (len(times) - 1)
    if np.abs(np.diff(times) - step).max() > EVEN * step or times[0]:
        raise InputError(
            f"{path}: found instants from {times[0]:g} s with steps from {np.diff(times).min():g} to "
            f"{np.diff(times).max():g} s, expected even steps from 0 in this layout; interpolate, or take "
            "openfast.layout=keywords"
        )
    return step


def _history(times, forces):
    """Return a line for each instant. Raises InputError where OpenFAST would cut it."""
    if (1 + forces.shape[1]) * WIDTH > LINE:
        raise InputError(f"found {forces.shape[1]} coordinates, expected at most {LINE // WIDTH - 1} for OpenFAST")
    return _lines(np.column_stack([times, forces]), WIDTH - 8)


def _module_input(stem, flex, points, loads, floats):
    """Return the input file of the module."""
    rule = "-" * 22

    def line(value, name, meaning):
        return f"{value:<24} {name:<16} - {meaning}"

    def section(name):
        return f"{rule} {name} {rule}"

    def file(there, ending):
        return f'"{stem}{ending}.dat"' if there else '"NA"'

    # both modules read these lists of modes and initial values, and all are off
    lists = [
        line(-1, "NActiveDOFList", "number of active modes listed in ActiveDOFList, -1 for all (integer)"),
        line(1, "ActiveDOFList", "list of active modes [unused if NActiveDOFList<=0]"),
        line(0, "NInitPosList", "number of initial positions listed in InitPosList (integer)"),
        line(0, "InitPosList", "list of initial positions [unused if NInitPosList<=0]"),
        line(0, "NInitVelList", "number of initial velocities listed in InitVelList (integer)"),
        line(0, "InitVelList", "list of initial velocities [unused if NInitVelList<=0]"),
    ]
    named = line(f'"{stem}.dat"', "Red_FileName", "the superelement")
    if flex:
        reduction = [line(1, "FileFormat", "0: Guyan, 1: FlexASCII (switch)"), named,
                     line('"NA"', "RedCst_FileName", "unused"), *lists]  # fmt: skip
    else:
        reduction = [
            line(int(floats), "RBMod", "0: fixed at the sea bed, 1: floating (switch)"), named, *lists,
            section("CONNECTIONS"),
            line(str(points), "Connections", "whether there are connection points (flag)"),
            line(file(points, "_points"), "Conn_FileName", "connection points"),
            section("USER FORCING"),
            line(str(loads), "UserForcing", "whether loads of the coordinates are prescribed (flag)"),
            line(file(loads, "_forces"), "Force_FileName", "these loads over time"),
            line("False", "ConnForcing", "whether forces at connection points are prescribed (flag)"),
            line('"NA"', "FConn_FileName", "these forces over time"),
        ]  # fmt: skip
    # the order of the lines is that of the module: it reads them by their place
    return "\n".join([
        f"{BEGIN} input file", f"superelement {stem}",
        section("SIMULATION CONTROL"),
        line("False", "Echo", "echo the input to <RootName>.ech (flag)"),
        line('"default"', "DT", "time step (s)"),
        line(3, "IntMethod", "1: RK4, 2: AB4, 3: ABM4 (switch)"),
        section("REDUCTION INPUTS"), *reduction,
        section("OUTPUT"),
        line("True", "SumPrint", "write a summary (flag)"),
        line(1, "OutFile", "unused"), line("True", "TabDelim", "unused"), line('"G0"', "OutFmt", "unused"),
        line(0, "TStart", "unused"), line("", "OutList", "the next lines list the outputs"),
        *[f'"{name}"' for name in CHANNELS], "END of the outputs", "",
    ])  # fmt: skip


def _remarks(flex, floats, points):
    """Yield what the files do not hold."""
    yield "axes and origin are those of the model; OpenFAST has x downwind and z upward"
    if flex and floats:
        yield "the body is free, and this layout is of structures that are fixed; openfast.layout=keywords has others"
    if flex and points:
        yield f"no places but the interface; openfast.layout=keywords has nodes {', '.join(p.label for p in points)}"
    if not flex and floats:
        yield f"weight is along -z, of {GRAVITY:g} m/s^2"
    else:
        yield "weight is not in the file: gravity as an input of the reduction can be among openfast.loads"
