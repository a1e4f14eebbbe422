"""Put results together to a machine, estimate its error, and write it as a result, or its responses."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace

import numpy as np

from ..analysis.frequency_response import above_rest, checked_frequencies
from ..assembly.coupling import Machine, laws_of_table, machine_of, warnings_of_table
from ..assembly.error import accuracy_of_machine, damping_of_errors, why_not_known
from ..assembly.parts import MeasuredPart, Part, measured_part, part_of, units_of
from ..body.node_shapes import NodeShape
from ..files.machine_basis import first_numbers, nodes_of_machine, write_basis_of_machine
from ..files.outputs import check_outputs, hdf5_kind
from ..files.response_file import (
    FOREIGN,
    Responses,
    check_response_name,
    kind_of_responses,
    lost_channels,
    write_responses,
)
from ..files.result_file import FORMAT, Result, read_result, write_result
from ..files.together import rescued
from ..model.damping import GivenDamping
from ..model.frames import NoFrame
from ..model.interfaces.nodes import InterfaceNode
from ..parallel import startup
from ..parallel.as_html import as_html
from ..parallel.failures import InputError, agreed
from ..parallel.progress import Progress
from ..readers.frf import read_frf
from ..readers.motions.table import head_of, read_columns
from ..reduction.result.accuracy import Accuracy
from ..reduction.result.record import MACHINE, Record, versions
from ..reduction.result.reduced_model import ReducedModel
from ..settings.machine_file import check_machine, read_machine
from .workflow import workflow


@dataclass(eq=False, kw_only=True)
class Assembly:
    """A machine: its model, and how it is known.

    Attributes
    ----------
    machine : Machine
        The bodies and the conditions between them.
    band : tuple of two floats or None
        Hz; by default that over which all bodies are known.
    reduced : ReducedModel or None
        Of the whole, in pseudo-modal coordinates; with `parameters` where bodies have some. Its record has the
        estimated accuracy, where that of every body is known. None with a measured body.
    accuracy : Accuracy or None
        The estimated error.
    budget : list of dict
        For each body its error, None where it is not known, what the machine makes of it, and with a tolerance the
        error it would need; 0 for a body that counts as exact.
    warnings : list of str
    nodes : list of NodeShape
        The interfaces in the coordinates of `reduced`.
    T : ndarray or None
        The coordinates of the bodies by those of the machine.
    parts, results : list
        The bodies as they are coupled, and the results that they were read from.
    """

    machine: Machine
    band: tuple[float, float] | None = None
    reduced: ReducedModel | None = None
    accuracy: Accuracy | None = None
    budget: list[dict] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    nodes: list[NodeShape] = field(default_factory=list)
    T: np.ndarray | None = field(default=None, repr=False)
    parts: list[Part] = field(default_factory=list, repr=False)
    results: list[Result] = field(default_factory=list, repr=False)

    @property
    def lines(self) -> np.ndarray:
        """The frequencies (F,) in Hz of the first measured body, in the band; not 0 Hz where a body moves freely."""
        lines = next(part.lines for part in self.machine.parts.values() if isinstance(part, MeasuredPart))
        return above_rest(_inside(lines, self.band), self.machine.response)[0]

    def frequency_response(self, frequencies=None) -> np.ndarray:
        """Return H(i omega) (F, r, p) at `frequencies` in Hz, by default at the lines of the first measured body.
        Raises InputError at poles, and outside of the lines of measured bodies."""
        frequencies = self.lines if frequencies is None else checked_frequencies(frequencies)
        if self.reduced is not None:
            return self.reduced.frequency_response(frequencies)
        try:
            return self.machine.response(2j * np.pi * frequencies)
        except np.linalg.LinAlgError as error:
            raise InputError("frequencies: one is a pole of a body, such as 0 Hz; leave it out") from error

    def responses(self, frequencies=None) -> Responses:
        """Return the same at `frequencies` with the names of inputs and outputs, as files of responses have it."""
        frequencies = self.lines if frequencies is None else checked_frequencies(frequencies)
        names = {"input_names": self.machine.inputs.own, "output_names": self.machine.outputs.own}
        return Responses(frequencies=frequencies, response=self.frequency_response(frequencies), **names,
                         record={"bodies": list(self.machine.parts), "versions": versions()})  # fmt: skip

    def save(self, path, *, basis: bool = True, comm=None) -> None:
        """Write a result file `path`, which commands read as that of a reduction; `basis`: with the shapes of the
        bodies. Collective. Raises InputError of a machine with a measured body."""
        if self.reduced is None:
            raise InputError("save: a machine with a measured body has no coordinates; write_responses writes its "
                             "responses()")  # fmt: skip
        comm = comm or startup.start_mpi()
        numbers = first_numbers(self.results, comm)

        def write(place):
            write_result(place, self.reduced, nodes=self.nodes, more=lambda file: basis and write_basis_of_machine(
                file, comm, self.results, self.parts, self.T, numbers))  # fmt: skip

        rescued(write, path, comm)

    @property
    def sentence(self) -> str:
        """What is known of the error, and what to do."""
        accuracy = self.accuracy
        if accuracy is None:
            return "the error of the machine is not estimated"
        size = f"about {accuracy.largest:.1e}" if np.isfinite(accuracy.largest) else "not known"
        asked = f" (tolerance {accuracy.tolerance:g})" if "needs" in self.budget[0] else ""
        again = f"; {accuracy.stopped}" if accuracy.stopped else ""
        return (f"{'' if accuracy.reached else 'NOT REACHED: '}largest error of the machine {size}{asked} over "
                f"{accuracy.band[0]:g} to {accuracy.band[1]:g} Hz, estimated from its bodies"
                f"{self.machine.exact}{again}")  # fmt: skip

    def __str__(self):
        size = "responses of measured bodies" if self.reduced is None else f"{self.reduced.size} coordinates"
        of = ", ".join(f"{row['body']} {'not known' if row['error'] is None else format(row['error'], '.1e')}"
                       for row in self.budget)  # fmt: skip
        return "\n".join([f"machine of {', '.join(self.machine.parts)}: {size}", self.sentence,
                          *([f"errors of the bodies: {of}"] * bool(of))])  # fmt: skip

    __repr__ = __str__

    def _repr_html_(self):
        """Return what is known of the error, and the errors of the bodies, for notebooks."""
        size = "responses of measured bodies" if self.reduced is None else f"{self.reduced.size} coordinates"
        rows = [{key: "not known" if value is None else value for key, value in row.items()} for row in self.budget]
        notes = [f"warning: {text}" for text in self.warnings]
        return as_html(self.sentence, {"machine of": ", ".join(self.machine.parts), "size": size}, rows, notes)


@workflow
def assemble(
    bodies, joints=(), masses=(), *, band=None, tolerance: float | None = None, inputs=None, outputs=None, comm=None,
    progress: Progress | None = None,
) -> Assembly:  # fmt: skip
    """Put reduced bodies together to a machine. Collective.

    Parameters
    ----------
    bodies : sequence of MachineBody
        Whose `result` is the name of a result file, or a Result.
    joints : sequence of RigidJoint or BushingJoint
    masses : sequence of PointMass
    band : (float, float), optional
        Hz, over which the error is estimated; by default that of the bodies.
    tolerance : float, optional
        Of the machine's responses, with which the estimate is compared.
    inputs, outputs : sequence of str, optional
        Of the machine, such as "spindle.tool:z", or "spindle.tool" for all directions; by default all of the bodies.

    Raises
    ------
    InputError
        For names and directions that bodies do not have, rigid loops that are overdetermined, tables that end inside
        of the band, and with a tolerance where the error of a body is not known.
    """
    check_machine(band, tolerance, inputs, outputs)
    bodies, joints, masses = list(bodies), list(joints), list(masses)
    results = [_read(body, comm) for body in bodies]
    with progress.stage("assemble"), agreed(comm):
        made = _assembled(bodies, results, joints, masses, band, tolerance, inputs, outputs) if comm.rank == 0 else None
    made = comm.bcast(made)
    parts = list(made.machine.parts.values())
    if made.reduced is None:
        return made
    numbers = first_numbers(results, comm)
    record = _record(results, parts, numbers, made, progress, comm)
    return replace(made, reduced=replace(made.reduced, record=record), warnings=list(record.warnings), parts=parts,
                   nodes=nodes_of_machine(results, parts, made.T, numbers), results=results)  # fmt: skip


def _read(body, comm):
    """Return the result of a body, or its measured responses. Collective."""
    if body.kind == "measured":
        with agreed(comm):
            return read_frf(body.result)
    return body.result if isinstance(body.result, Result) else read_result(body.result, comm)


def _assembled(bodies, results, joints, masses, band, tolerance, inputs, outputs) -> Assembly:
    """Return the machine, its model and what is known of its error."""
    # the bodies, and the band that all of them know
    parts = [(measured_part if body.kind == "measured" else part_of)(body, result)
             for body, result in zip(bodies, results, strict=True)]  # fmt: skip
    measured = [part for part in parts if isinstance(part, MeasuredPart)]
    band = _band(parts, band)
    if measured and not len(_inside(measured[0].lines, band)):
        raise InputError(f"band: body '{measured[0].name}' has no line in {band[0]:g} to {band[1]:g} Hz; it was "
                         f"measured from {measured[0].lines[0]:g} to {measured[0].lines[-1]:g} Hz")  # fmt: skip
    # laws of joints by their tables, which have to reach over the band
    tables, told = {}, []
    for k, joint in enumerate(joints):
        if getattr(joint, "table", None):
            if band is None:
                raise InputError(f"joint[{k}].table: needs a band, over which it has to reach; give `band`")
            header, start = head_of(joint.table)
            rows = read_columns(joint.table, start, len(header))
            key = f"joint[{k}]: table {joint.table}"
            tables[k] = laws_of_table(header, rows, joint, band, key)
            told += warnings_of_table(tables[k], key)
    machine = machine_of(parts, joints, masses, inputs, outputs, tables)
    machine.warnings.extend(told)
    # a measured body is known at its lines only, so the machine has responses and no matrices
    if measured:
        if tolerance is not None:
            raise InputError(f"tolerance: the error of the measured body '{measured[0].name}' is not known")
        told = above_rest(_inside(measured[0].lines, band), machine.response)[1]
        return Assembly(machine=machine, band=band, warnings=[*machine.warnings, (
            f"body '{measured[0].name}' is measured: the machine has responses at its lines, and no modes, no state "
            "space and no estimated error"
        ), *told])  # fmt: skip
    # the assembled model: rigid joints are taken out of its coordinates
    tau = _tau(parts, band)
    reduced, T = machine.model(tau)
    warnings = list(machine.warnings)
    known = [bool(units_of(result.reduced)) for result in results]
    if any(known) and not all(known):
        names = [f"body '{part.name}'" for part, units in zip(parts, known, strict=True) if not units]
        whose = "its model" if len(names) == 1 else "their models"
        warnings.append(f"{', '.join(names)}: the units of {whose} are not known, and are taken for SI; convert models "
                        "in other units with --units, such as mm,t,s")  # fmt: skip
    still = int((reduced.frequencies == 0).sum())
    if still:
        warnings.append(f"the machine has {still} rigid-body motions without force: it has no response at 0 Hz")
    # the error of the whole, by those of the bodies
    accuracy, budget = None, []
    why = why_not_known(machine, band) if band else "no body was reduced to a tolerance"
    if not why or tolerance is not None:
        accuracy, budget = accuracy_of_machine(machine, tau, band, tolerance)
        if not np.isfinite(accuracy.largest):
            warnings.append("the errors of the bodies are too large for an estimate at sharp resonances; "
                            "reduce them to a smaller tolerance")  # fmt: skip
        if machine.parameters:
            warnings.append("the error of the machine is estimated at the reference values of its parameters")
    else:
        warnings.append(f"the error of the machine is not estimated: {why}")
        budget = [{"body": part.name, "error": part.eps if part.exact or part.accuracy else None} for part in parts]
    return Assembly(machine=machine, band=band, reduced=reduced, accuracy=accuracy, budget=budget, warnings=warnings,
                    T=T)  # fmt: skip


def _band(parts, band):
    """Return the band, by default that over which all bodies are known, None where none is. Raises InputError."""
    known = {part.name: part.accuracy.band for part in parts if part.accuracy is not None}
    known |= {part.name: (part.lines[0], part.lines[-1]) for part in parts if isinstance(part, MeasuredPart)}
    if band is not None or not known:
        return band
    last, first = max(known, key=lambda name: known[name][0]), min(known, key=lambda name: known[name][1])
    if known[last][0] > known[first][1]:
        told = [f"'{name}' is known over {known[name][0]:g} to {known[name][1]:g} Hz" for name in (first, last)]
        raise InputError(f"band: body {' and body '.join(told)}; reduce or measure both over one band")
    return float(known[last][0]), float(known[first][1])


def _inside(lines, band):
    """Return the frequencies in a band, all without one."""
    return lines if band is None else lines[(lines >= band[0]) & (lines <= band[1])]


def _tau(parts, band) -> float:
    """Return the time (s) of the highest frequency that counts."""
    highest = band[1] if band else max(np.sqrt(np.abs(np.diag(part.model.K)).max()) for part in parts) / 2 / np.pi
    return 1 / (2 * np.pi * (highest or 1.0))


def _record(results, parts, numbers, made: Assembly, progress, comm) -> Record:
    reduced, warnings, accuracy = made.reduced, made.warnings, made.accuracy
    records = [result.reduced.record for result in results]
    nodes = tuple(
        InterfaceNode(f"{part.name}.{part.labels[shape.node]}", shape.node + number,
                      tuple((part.turn @ shape.position + part.shift).tolist()))
        for result, part, number in zip(results, parts, numbers, strict=True) for shape in result.nodes
    )  # fmt: skip
    # an error is that of a damping, which a record has as one loss factor
    if accuracy is not None and not np.isfinite(accuracy.largest):
        accuracy = None
    elif accuracy is not None and damping_of_errors(made.machine) is None:
        warnings = [*warnings, "the errors of the bodies were measured with different damping: that of the machine is "
                               "not stored"]  # fmt: skip
        accuracy = None
    unstable = reduced.unstable_poles()
    if len(unstable):
        warnings = [*warnings, f"the machine is unstable: {len(unstable)} poles in the right half-plane"]
    return Record.without_reduction(
        reduced, ranks=comm.size, model=f"{MACHINE}{', '.join(part.name for part in parts)}",
        size=sum(record.size if record else 0 for record in records),
        nonzeros=sum(record.nonzeros if record else 0 for record in records),
        rigid_body_modes=int((reduced.frequencies == 0).sum()), frame=NoFrame(), damping=GivenDamping(),
        orthonormality_defect=float(np.abs(np.diag(np.diag(reduced.M)) - reduced.M).max()),
        unstable_poles=tuple((root.real, root.imag) for root in unstable), warnings=tuple(warnings),
        timing=progress.timing(), interface_nodes=nodes, joints=made.machine.joints, accuracy=accuracy,
    )  # fmt: skip


@workflow
def assemble_file(path, *, overrides=(), comm=None, progress: Progress | None = None) -> dict:
    """Put results together as a file such as machine.toml says, and write the machine as a result. Collective.

    Parameters
    ----------
    path : str or PathLike
        The file of the machine.
    overrides : sequence of str
        "key.path=value", which replace keys of the file.

    Returns
    -------
    dict
        Plain numbers for a table or JSON: the file written, the size, the frequencies, the joints with the distances of
        their ends, the budget of the error, the verdict and warnings.

    Raises
    ------
    InputError
        For a file, a result or a table that does not fit.
    """
    with agreed(comm):
        job = read_machine(path, overrides)
    # files that are read and written are checked before anything is computed
    reads = [path, *(row.result for row in job.body), *(row.table for row in job.joint if hasattr(row, "table"))]
    measured = any(row.kind == "measured" for row in job.body)
    if measured:
        check_response_name(job.output)
    elif str(job.output).endswith((".csv", *FOREIGN)):
        raise InputError(f"output: found '{job.output}', expected a result such as machine.h5; `hpcred evaluate` of it "
                         "writes responses")  # fmt: skip
    check_outputs({job.output: kind_of_responses(job.output) if measured else hdf5_kind(FORMAT)}, comm, reads,
                  progress=progress)  # fmt: skip
    made = assemble(job.body, job.joint, job.mass, band=job.band, tolerance=job.tolerance, inputs=job.inputs,
                    outputs=job.outputs, comm=comm, progress=progress)  # fmt: skip
    accuracy = made.accuracy
    with progress.stage("write", job.output):
        # of measured bodies responses are written, else a result
        if made.reduced is None:
            responses = made.responses()
            rescued(lambda place: write_responses(place, responses, comm), job.output, comm)
            made.warnings.extend(lost_channels(job.output, responses))
            known = {"frequencies_hz": responses.frequencies.tolist()}
        else:
            made.save(job.output, basis=job.write_basis, comm=comm)
            known = {
                "size": made.reduced.size, "pseudo_frequencies_hz": made.reduced.frequencies.tolist(),
                "parameters": [asdict(row) for row in getattr(made.reduced, "parameters", ())],
                "error": None if accuracy is None or not np.isfinite(accuracy.largest) else accuracy.largest,
            }  # fmt: skip
    return {"output": job.output, **known, "inputs": list(made.machine.inputs.own),
            "outputs": list(made.machine.outputs.own), "joints": [row.row for row in made.machine.joints],
            "budget": made.budget, "sentence": made.sentence,
            "reached": accuracy is None or accuracy.reached, "warnings": made.warnings,
            "timing": asdict(progress.timing())}  # fmt: skip
