"""Write a ReducedModel as an FMU (FMI 2.0, model exchange and co-simulation): the body in its frame, which is at rest.

Its inputs are forces, its outputs those of the model, and the rates of displacements and stresses. The equations are
in C in fmi2/body.c, the numbers in a header beside it; the compiler of this machine makes the binary. Both are in
sources/ too.
"""

from __future__ import annotations

import os
import platform
import re
import shlex
import shutil
import struct
import subprocess
import uuid
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from ..body.body import check_viscous, instability, maker
from ..fe.dofs import DIRECTIONS, QUANTITIES, SCALAR, named_quantity, target_of
from ..files.outputs import ZIP
from ..files.temporary import folder_of_all
from ..model.outputs.cuts import cut_output_of
from ..model.parameters.definitions import Parameter
from ..model.parameters.expressions import in_c
from ..parallel.failures import ComputationError, InputError
from ..parallel.messages import printable
from ..parallel.petsc import MPI
from ..reduction.parametric.reduced import ParametricReducedModel
from ..reduction.result.massless import static_coordinates, with_mass
from ..reduction.result.maxwell_states import with_maxwell_states
from ..reduction.result.parameter_accuracy import in_words
from ..reduction.result.reduced_model import ReducedModel, require_finite
from .base import Writer
from .state_space import state_space

SOURCES = Path(__file__).with_name("fmi2")  # body.c, and the headers of the FMI standard
DESCRIPTION, LARGEST_XML = "modelDescription.xml", 2**26  # bytes that are read
LONGEST = 63  # letters of an identifier that every compiler of C tells apart
SYSTEMS = {"Linux": ("linux", ".so"), "Darwin": ("darwin", ".dylib")}
FLAGS = ("-std=c99", "-O3", "-fPIC", "-shared", "-fvisibility=hidden")
UNITS = {  # exponents of kg, m, s and rad
    "N": (1, 1, -2, 0), "N.m": (1, 2, -2, 0), "J": (1, 2, -2, 0), "W": (1, 2, -3, 0), "m": (0, 1, 0, 0),
    "m/s": (0, 1, -1, 0), "Pa": (1, -1, -2, 0), "Pa/s": (1, -1, -3, 0), "N/s": (1, 1, -3, 0), "N.m/s": (1, 2, -3, 0),
    "rad": (0, 0, 0, 1), "rad/s": (0, 0, -1, 1), "m/s2": (0, 1, -2, 0), "rad/s2": (0, 0, -2, 1),
}  # fmt: skip
# what an input, an output and its rates are called, and their units
TRANSLATION = (("force", "N"), ("displacement", "m"), ("velocity", "m/s"), ("acceleration", "m/s2"))
ROTATION = (("moment", "N.m"), ("rotation", "rad"), ("angular_velocity", "rad/s"), ("angular_acceleration", "rad/s2"))
LOAD = (("load", None), ("work", "J"), ("power", "W"))
STRESS = ((None, None), ("stress", "Pa"), ("stress_rate", "Pa/s"))
SECTION = {"f": ((None, None), ("section_force", "N"), ("section_force_rate", "N/s")),
           "m": ((None, None), ("section_moment", "N.m"), ("section_moment_rate", "N.m/s"))}  # fmt: skip
UNKNOWN = (("input", None), ("output", None), ("output_rate", None))
COMPONENTS = ("xx", "yy", "zz", "xy", "yz", "zx")  # of stresses, in their order


def write_fmu(path, reduced: ReducedModel, name: str | None = None, parametric=None) -> list[str]:
    """Write an FMU; call it on one rank.

    Parameters
    ----------
    path : str or PathLike
    reduced : ReducedModel
    name : str, optional
        Of the body, in any letters; by default that of the model which was reduced.
    parametric : ParametricReducedModel, optional
        Whose parameters the FMU has, and of which `reduced` is the model at the reference values, perhaps with further
        outputs.

    Returns
    -------
    list of str
        Remarks on what is not in the file.

    Raises
    ------
    InputError
        For structural damping, fractional laws, a model without inputs or outputs, or a machine without C compiler.
    ComputationError
        When the compiler fails.
    """
    require_finite(reduced)
    check_viscous(reduced, "an FMU")
    if not reduced.input_names or not reduced.output_names:
        raise InputError("an FMU needs inputs and outputs; reduce with `inputs` in the job, or convert with --inputs")
    remarks = instability(reduced)
    if reduced.added:
        reduced, count = with_maxwell_states(reduced, "an FMU", from_rest=True)
        remarks.append(f"the last {count} coordinates are the dashpots of Maxwell elements; the body has to start at "
                       "rest")  # fmt: skip
        if parametric is not None:
            parametric = with_maxwell_states(parametric, "an FMU", from_rest=True)[0]
    reduced, feedthrough, integrals = with_mass(reduced, "an FMU")
    if not reduced.size:
        raise InputError("an FMU needs states, and all coordinates of the model follow the forces at once; take the "
                         "matrix D of its state space")  # fmt: skip
    if integrals:
        remarks.append(f"the last {integrals} coordinates are integrals of the displacements of dampers without mass; "
                       "the body has to start at rest")  # fmt: skip
    compiler, (folder, suffix) = _compiler(), _platform()
    family = replace(Family.of(parametric, reduced), feedthrough=feedthrough)
    data = _data(reduced, family)
    if name is None:
        name = Path(reduced.record.model).stem if reduced.record is not None else "body"
    name = printable(name).strip() or "body"  # XML has no control characters
    # of name and numbers, so that the same result gives the same file, and two bodies are told apart
    guid = f"{{{uuid.uuid5(uuid.NAMESPACE_OID, name + data)}}}"
    data = f'#define GUID "{guid}"\n{data}'
    identifier = _identifier(name)
    with folder_of_all(MPI.COMM_SELF) as build:
        binary = build / f"{identifier}{suffix}"
        (build / "body_data.h").write_text(data)
        _compile(compiler, build, binary)
        contents = {
            DESCRIPTION: _description(reduced, family, name, identifier, guid),
            f"binaries/{folder}/{binary.name}": binary.read_bytes(),
            "sources/body.c": (SOURCES / "body.c").read_bytes(),
            "sources/body_data.h": data.encode(),
        }
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for key, content in contents.items():
            item = zipfile.ZipInfo(key)  # with a time that is always the same
            item.compress_type = zipfile.ZIP_DEFLATED
            item.external_attr = 0o755 << 16 if key.startswith("binaries") else 0o644 << 16
            archive.writestr(item, content)
    return [f"the binary is for {folder}; other platforms compile sources/body.c", *family.remarks,
            *remarks]  # fmt: skip


def _compiler() -> list[str]:
    """The command of the C compiler: that of the environment variable CC, or cc."""
    command = shlex.split(os.environ.get("CC", "")) or ["cc"]
    if shutil.which(command[0]) is None:
        raise InputError(
            f"an FMU needs a C compiler, and there is no '{command[0]}' on this machine; install one (Debian: apt "
            "install gcc libc6-dev) or name it by the environment variable CC"
        )
    return command


def _platform() -> tuple[str, str]:
    """The folder of the binary and its suffix, as FMI 2.0 names them."""
    system = platform.system()
    if system not in SYSTEMS:
        raise InputError(f"an FMU can be compiled on {' or '.join(SYSTEMS)}, found {system}; export it there")
    prefix, suffix = SYSTEMS[system]
    return f"{prefix}{8 * struct.calcsize('P')}", suffix


def _compile(compiler, build, binary):
    command = [*compiler, *FLAGS, f"-I{build}", f"-I{SOURCES}", "-o", str(binary), str(SOURCES / "body.c"), "-lm"]
    run = subprocess.run(command, capture_output=True, text=True)
    if run.returncode:
        said = (run.stderr.strip() or "nothing said").splitlines()
        told = next((line for line in said if "error" in line), said[-1])
        raise ComputationError(f"the FMU was not compiled by {compiler[0]} (exit status {run.returncode}): {told}")


def _identifier(name) -> str:
    """The name of the body as an identifier in C."""
    word = re.sub(r"\W", "_", name, flags=re.ASCII)[:LONGEST]
    return word if re.match(r"[A-Za-z]", word) else f"body_{word}"


def _nominal(reduced) -> tuple[float, float]:
    """Sizes of q and q': those of unit forces at rest, and swinging with the lowest elastic pseudo-frequency.

    Solvers of model exchange multiply their relative tolerance by them; with 1 they would see nothing of a stiff body.
    """
    q = np.abs(np.linalg.pinv(reduced.K, rcond=1e-9) @ reduced.B).max()
    elastic = reduced.frequencies[reduced.frequencies > 1e-6 * reduced.frequencies.max()]
    return (q, q * 2 * np.pi * elastic.min()) if q > 0 and len(elastic) else (1.0, 1.0)


def _data(reduced, family) -> str:
    """The header with the numbers, without the GUID."""
    displacement, velocity = _nominal(reduced)
    outputs = _outputs(reduced, family)
    parts = [_matrices(reduced, family, part) for part in (family.constant, *family.terms)]
    numbers = {
        "COORDINATES": reduced.size, "INPUTS": len(reduced.input_names), "OUTPUTS": len(outputs),
        "NOMINAL_Q": f"{displacement:.17g}", "NOMINAL_V": f"{velocity:.17g}", "PARAMETERS": len(family.parameters),
        "PARTS": len(parts), "ENTRIES": len(parts[0]),
    }  # fmt: skip
    lines = [f"#define {key} {value}" for key, value in numbers.items()]
    rows = ",\n".join(f"{{\n{_listed(part)}\n}}" for part in parts)
    lines.append(f"static const double parts[PARTS][ENTRIES] = {{\n{rows}\n}};")
    return "\n".join([*lines, *family.in_c()]) + "\n"


def _matrices(reduced, family, part) -> np.ndarray:
    """The entries of stiffness_matrix, damping_matrix, input_matrix, output_matrix and feed_through of a part, in which
    the mass of `reduced` is divided out."""
    outputs = _outputs(reduced, family, part)
    arrays = [*(np.linalg.solve(reduced.M, getattr(part, key)) for key in "KDB"),
              *(np.array([getattr(item, key) for item in outputs]) for key in ("states", "inputs"))]  # fmt: skip
    return np.concatenate([array.ravel() for array in arrays])


def _listed(values) -> str:
    lines = [values[k : k + 8] for k in range(0, len(values), 8)]
    return ",\n".join(", ".join(f"{value:.17g}" for value in line) for line in lines)


def _description(reduced, family, name, identifier, guid) -> bytes:
    """modelDescription.xml."""
    root = ElementTree.Element("fmiModelDescription", {
        "fmiVersion": "2.0", "modelName": name, "guid": guid, "generationTool": maker(reduced),
        "description": f"Reduced flexible body with {reduced.size} coordinates in its frame, at rest at the start",
        "variableNamingConvention": "flat", "numberOfEventIndicators": "0",
    })  # fmt: skip
    able = dict.fromkeys(("canGetAndSetFMUstate", "canSerializeFMUstate", "providesDirectionalDerivative"), "true")
    able |= {"modelIdentifier": identifier, "canNotUseMemoryManagementFunctions": "true"}
    exchange = ElementTree.SubElement(root, "ModelExchange", {**able, "completedIntegratorStepNotNeeded": "true"})
    together = ElementTree.SubElement(root, "CoSimulation", {
        **able, "canHandleVariableCommunicationStepSize": "true", "canInterpolateInputs": "true"
    })  # fmt: skip
    for kind in (exchange, together):
        ElementTree.SubElement(ElementTree.SubElement(kind, "SourceFiles"), "File", name="body.c")
    units = ElementTree.SubElement(root, "UnitDefinitions")
    for unit, powers in UNITS.items():
        exponents = {base: str(power) for base, power in zip(("kg", "m", "s", "rad"), powers, strict=True) if power}
        ElementTree.SubElement(ElementTree.SubElement(units, "Unit", name=unit), "BaseUnit", exponents)
    _add_variables(root, reduced, family)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)


def _add_variables(root, reduced, family):
    """The variables, whose value references count from 0 and indices from 1, and what depends on what."""
    size, inputs, outputs = reduced.size, len(reduced.input_names), _outputs(reduced, family)
    at_q = inputs + len(outputs)
    at_v, at_rates = at_q + size, at_q + 2 * size
    nominals = [f"{value:.6g}" for value in _nominal(reduced)]
    variables, taken = ElementTree.SubElement(root, "ModelVariables"), set()

    def add(word, causality, description, variability="continuous", **real):
        while word in taken:  # names that differ in signs only
            word += "_"
        taken.add(word)
        count = len(variables)
        initial = {} if causality == "input" else {"initial": "exact" if "start" in real else "calculated"}
        variable = ElementTree.SubElement(variables, "ScalarVariable", {
            "name": word, "valueReference": str(count), "description": description, "causality": causality,
            "variability": variability, **initial,
        })  # fmt: skip
        ElementTree.SubElement(variable, "Real", {key: value for key, value in real.items() if value is not None})

    # inputs, outputs, states, their rates, parameters: in this order they are counted in C
    for name in reduced.input_names:
        word, unit = _kind(name, reduced)[0]
        add(_variable(word, name), "input", f"{word} {name}", unit=unit, start="0")
    for item in outputs:
        add(_variable(item.word, item.place), "output", f"{item.word.replace('_', ' ')} {item.place}", unit=item.unit)
    for i in range(size):
        add(f"q[{i + 1}]", "local", "reduced coordinate", start="0", nominal=nominals[0])
    for i in range(size):
        add(f"v[{i + 1}]", "local", "its rate", start="0", nominal=nominals[1])
    for letter, first in (("q", at_q), ("v", at_v)):
        for i in range(size):
            add(f"der({letter}[{i + 1}])", "local", "rate of a state", derivative=str(first + i + 1))
    for item in family.parameters:
        low, high, start = (f"{value:.17g}" for value in (*item.range, item.reference))
        unit = item.unit if item.unit in UNITS else None
        add(item.name, "parameter", f"parameter in {item.unit}" if item.unit else "parameter", variability="fixed",
            unit=unit, min=low, max=high, start=start)  # fmt: skip

    # what each output and rate depends on
    structure = ElementTree.SubElement(root, "ModelStructure")
    unknown = {"Outputs": [], "Derivatives": []}
    for i, item in enumerate(_patterns(reduced, family)):
        known = np.concatenate([np.flatnonzero(item.inputs), at_q + np.flatnonzero(item.states)])
        unknown["Outputs"].append((inputs + i, known))
    unknown["Derivatives"] += [(at_rates + i, [at_v + i]) for i in range(size)]
    unknown["Derivatives"] += [(at_rates + size + i, None) for i in range(size)]  # on everything
    found = unknown["Outputs"] + unknown["Derivatives"]
    unknown["InitialUnknowns"] = [(at, None) for at, _ in found] if family.parameters else found
    for key, entries in unknown.items():
        group = ElementTree.SubElement(structure, key)
        for index, known in entries:
            depends = {} if known is None else {"dependencies": " ".join(str(at + 1) for at in known)}
            ElementTree.SubElement(group, "Unknown", {"index": str(index + 1), **depends})


class _Output(NamedTuple):
    """A variable that is calculated: what it is called, its place and unit, and its rows of the states (2m,) and of
    the inputs (p,)."""

    word: str
    place: str
    unit: str | None
    states: np.ndarray
    inputs: np.ndarray


def _patterns(reduced, family) -> list[_Output]:
    """Return the outputs with rows that are not zero where those of any part are not."""
    parts = [_outputs(reduced, family, part) for part in (family.constant, *family.terms)]
    return [item._replace(states=sum(abs(part[i].states) for part in parts),
                          inputs=sum(abs(part[i].inputs) for part in parts))
            for i, item in enumerate(parts[0])]  # fmt: skip


def _outputs(reduced, family, part=None) -> list[_Output]:
    """Return the outputs of the model, then the rates of those that are no velocities or accelerations, and do not
    follow the inputs at once; with the rows of another `part` of its matrices."""
    constant = part is None or part is family.constant
    direct = family.feedthrough if constant else np.zeros_like(family.feedthrough)
    matrices, still, rates = state_space(part or reduced), np.zeros(reduced.B.shape[1]), []
    outputs = []
    rated = reduced.displaces & ~family.feedthrough.any(axis=1)
    for name, row, through, displaces in zip(
        reduced.output_names, matrices["C"], matrices["D"] + direct, rated, strict=True
    ):
        quantity, place = named_quantity(name)
        words = _kind(place, reduced)[1:]
        order = QUANTITIES.index(quantity)
        if order >= len(words):  # there is no word for it
            order, place = 0, name
        outputs.append(_Output(words[order][0], place, words[order][1], row, through))
        if displaces:
            rates.append(_Output(words[1][0], place, words[1][1], np.roll(row, reduced.size), still))
    return [*outputs, *rates]


def _kind(name, reduced):
    """What a name such as 20:z or bearing:rx is a direction of; a load is none."""
    loads = {} if reduced.record is None else {item.name: item for item in reduced.record.loads if item.kind != "given"}
    if name in loads:
        words = ROTATION if name.rpartition(":")[2].startswith("r") else TRANSLATION
        return (words[3 - loads[name].integrated], *LOAD[1:]) if loads[name].is_motion else LOAD
    if cut := cut_output_of(name):
        return SECTION[cut.component[0]]
    target = target_of(name)
    if target is None and name.rpartition(":")[2] in COMPONENTS:
        return STRESS
    index = DIRECTIONS.index(target[1]) if isinstance(target, tuple) else SCALAR
    return TRANSLATION if index < 3 else ROTATION if index < SCALAR else UNKNOWN


def output_rows(reduced) -> dict:
    """Return the rows (m,) of C by the names of the outputs, but for names that are changed since two are alike."""
    words = [_variable(_kind(name, reduced)[1][0], name) for name in reduced.output_names]
    rows = zip(words, reduced.C, reduced.displaces, strict=True)
    return {word: row for word, row, displaces in rows if displaces and words.count(word) == 1}


def _variable(word, name) -> str:
    """force_20_z of "force" and "20:z", stress_20_xx of "stress" and "stress 20:xx": names that every program takes."""
    return re.sub(r"\W", "_", f"{word}_{name.removeprefix('stress ')}", flags=re.ASCII)


def with_stresses(reduced: ReducedModel, result, wanted) -> ReducedModel:
    """Return the model with stresses of a Result as further outputs, see FmuOptions. Raises InputError where the result
    has no such stress."""
    places = []
    for text in wanted.split(",") if isinstance(wanted, str) else np.atleast_1d(wanted).tolist():
        node, colon, component = str(text).strip().partition(":")
        if not (node.isascii() and node.isdecimal()) or (colon and component not in COMPONENTS):
            raise InputError(
                f"--set: fmu.stress: found '{text}', expected a node, such as 20, or one of its components, such as "
                f"20:xx ({', '.join(COMPONENTS)})"
            )
        places += [(int(node), item) for item in ((component,) if colon else COMPONENTS)]
    places = list(dict.fromkeys(places))
    modes = result.stress_modes([node for node, _ in places])
    rows = [modes.stress[:, np.searchsorted(modes.node, node), COMPONENTS.index(item)] for node, item in places]
    names = tuple(f"{node}:{item}" for node, item in places)
    still = np.zeros((len(rows), reduced.size))
    rates = {key: np.vstack([part, still]) for key in ("Cv", "Ca") if (part := getattr(reduced, key)) is not None}
    if reduced.feedthrough is not None:
        rates["feedthrough"] = np.vstack([reduced.feedthrough, np.zeros((len(rows), reduced.B.shape[1]))])
    return replace(reduced, C=np.vstack([reduced.C, *rows]), **rates, output_names=(*reduced.output_names, *names))


@dataclass(frozen=True, kw_only=True)
class FmuOptions:
    """`name`: of the model and of its binary, by default that of the result. `stress`: outputs of stresses, such as
    "20:xx,20:yy", or "20" for all six components, at nodes with stress modes.
    """

    name: str | None = None
    stress: tuple[int | str, ...] | int | str = ()


class Fmu(Writer):
    """FMUs, which have the name of the result unless they are named."""

    suffix, needs, kind, options, keeps_parameters = ".fmu", "reduced", ZIP, FmuOptions, True

    def write(self, target, source):
        reduced, wanted = source.result.reduced, source.options.stress
        if wanted not in ("", ()):
            reduced = with_stresses(reduced, source.result, wanted)
        reduced = source.driven(reduced)
        return write_fmu(target, reduced, source.options.name or source.name, source.parametric)

    def describe(self, path):
        if not zipfile.is_zipfile(path):
            return {}
        with zipfile.ZipFile(path) as archive:
            if DESCRIPTION not in archive.namelist():
                return {}
            about = archive.getinfo(DESCRIPTION)
            if about.file_size > LARGEST_XML:
                raise ValueError(f"{about.filename} unpacks to {about.file_size / 1e6:.0f} MB")
            root = ElementTree.fromstring(archive.read(about))
            platforms = sorted({name.split("/")[1] for name in archive.namelist() if name.startswith("binaries/")})
        variables = list(root.iter("ScalarVariable"))
        by = {key: [item.get("name") for item in variables if item.get("causality") == key]
              for key in ("input", "output")}  # fmt: skip
        return {
            "format": f"FMU, FMI {root.get('fmiVersion')}",
            "model": root.get("modelName"),
            "made_by": root.get("generationTool") or "not known",
            "inputs": by["input"],
            "outputs": by["output"],
            "states": sum(real.get("derivative") is not None for real in root.iter("Real")),
            "platforms": platforms,
        }


# Split a reduced model into the parts that an FMU adds up by its parameters, and write their factors in C.


@dataclass(frozen=True)
class Family:
    """`constant` and `terms`: models with K, D, B and C of the parts, and M of the reduced model; `factors` of the
    terms; `feedthrough` (r, p): of inputs to outputs that no state has part in."""

    constant: ReducedModel
    parameters: tuple[Parameter, ...] = ()
    terms: tuple[ReducedModel, ...] = ()
    factors: tuple = ()
    remarks: tuple[str, ...] = ()
    feedthrough: np.ndarray | None = None

    @classmethod
    def of(cls, parametric: ParametricReducedModel | None, reduced: ReducedModel) -> Family:
        """Return the parts of a model that is `reduced` at the reference values, perhaps with further outputs, whose
        rows do not depend on parameters; `reduced` alone for None, and where its mass does, its damping is no sum of
        terms, or coordinates without mass were eliminated."""
        if parametric is None:
            return cls(reduced)
        what = "mass" if any(item.of == "M" for item in parametric.terms) else "damping"
        without = bool(static_coordinates(parametric))
        if without:
            what, how = "motion of coordinates without mass", "follows forces by the stiffness at each value"
        elif what == "mass" or parametric.damping_follows:
            how = "depends on parameters" if what == "mass" else "follows the eigenfrequencies at each value"
        if without or what == "mass" or parametric.damping_follows:
            remark = f"the {what} {how}: at {in_words(parametric.reference)}; --at takes others"
            return cls(reduced, remarks=(remark,))
        known = {key: parametric.constant[key] for key in "KDB"}
        outputs = np.vstack([parametric.constant["C"], reduced.C[len(parametric.C) :]])
        terms = []
        for item in parametric.terms:
            part = {key: np.zeros_like(array) for key, array in (known | {"C": outputs}).items()}
            part[item.of][: len(item.matrix)] = item.matrix
            terms.append(replace(reduced, **part, Cv=None if reduced.Cv is None else np.zeros_like(reduced.Cv)))
        factors = tuple(item.expression for item in parametric.terms)
        return cls(replace(reduced, **known, C=outputs), parametric.parameters, tuple(terms), factors)

    def in_c(self) -> list[str]:
        """Return the limits of the parameters, and the function `factors`."""
        if not self.parameters:
            return []
        limits = {
            "reference_values": [item.reference for item in self.parameters],
            "lowest_values": [item.range[0] for item in self.parameters],
            "highest_values": [item.range[1] for item in self.parameters],
        }  # fmt: skip
        lines = [f"static const double {key}[PARAMETERS] = {{{', '.join(f'{value:.17g}' for value in values)}}};"
                 for key, values in limits.items()]  # fmt: skip
        places = {item.name: f"p[{k}]" for k, item in enumerate(self.parameters)}
        return [
            *lines, "", "static void factors(const double *p, double *theta)", "{",
            *(f"    theta[{k}] = {in_c(item, places)};" for k, item in enumerate(self.factors, 1)), "}",
        ]  # fmt: skip
