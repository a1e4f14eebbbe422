"""model.h5: a SecondOrderModel as real CSR rows in HDF5, readable in slices by any number of ranks.

matrices/indptr (n + 1), matrices/indices (nonzeros): one sorted pattern for all matrices, columns from 0
matrices/K, M and, where there is one, D (nonzeros)
matrices/Kv1, Kv2, ... (nonzeros), of added terms; viscoelastic: JSON, their names and laws; K is static then
inputs/B (p, n), inputs/names; outputs/C (r, n), outputs/names where C differs from B^T, and then Cv, Ca (r, n) where
    velocities and accelerations are measured, and direct (r, p), what outputs have of the inputs themselves
loads/name, kind, remark, spins, area (l) in m^2, sums (l, 4, 3): of the inputs that are loads, as of
    model.loads.LoadColumn; the sums are force, moment, and the parts of both on held dofs
dofs/node (n), dofs/direction (n), dofs/position (n, 3) in m, where the nodes are known; directions are 0 to 5 for x, y,
z, rx, ry, rz, 6 for a scalar dof, 7 to 12 for directions 1 to 6 of a displacement system of the node's own
elements/<kind> (elements, nodes): node numbers, where known, for pictures; kinds of model.elements
element_properties/<kind> (elements, 3), where known: number of the element, place of its type in element_types, and of
its material in materials, -1 for none; element_program: whose element types these are; materials: JSON, as Material
held/node, direction, position: as dofs/, of the dofs without row, held at zero by the program that wrote the matrices
sets/<name>: node numbers; signs in the name that HDF5 does not take are written as in web addresses (%2F)
remarks: sentences of the readers of the files
All in SI; the attribute converted_from, where there is one, names the units that the numbers came in; circulatory: 1
where K may be unsymmetric.
"""

from copy import copy
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote, unquote

import numpy as np
from pydantic import ValidationError

from ..fe.dofs import Dofs, dofs_per_node
from ..fe.materials import ElementProperties, Material
from ..model.laws.registry import NamedLaw, laws_of
from ..model.loads.kinds import LoadColumn
from ..model.operator import ADDED, KEY, Operator, Term
from ..model.second_order_model import SecondOrderModel, require_model
from ..parallel.declared import adapter_of
from ..parallel.failures import InputError, agreed
from ..parallel.petsc import MPI, PETSc
from ..parallel.shares import row_range
from .checked import Array, damaged
from .hdf5 import ALSO, reading, texts, writing

FORMAT, VERSION = "hpcred-model", 1
MATERIALS = tuple[Material, ...]
LAWS = tuple[NamedLaw, ...]
SUMS = ("force", "moment", "held_force", "held_moment")
NODES = {
    "dofs/node": Array("integer", ("n",)), "dofs/direction": Array("integer", ("n",)),
    "dofs/position": Array("real", ("n", 3)), "held/node": Array("integer", ("h",)),
    "held/direction": Array("integer", ("h",)), "held/position": Array("real", ("h", 3)),
    "element_properties/*": Array("integer", ("?", 3)), "element_types": Array("text", ("t",)),
    "element_program": Array("text", ()), "materials": Array("text", ()),
    "elements/*": Array("integer", ("?", "?")), "sets/*": Array("integer", ("?",)),
}  # fmt: skip
SCHEMA = NODES | {
    "matrices/indptr": Array("integer", ("n+1",), needed=True),
    "matrices/indices": Array("integer", ("z",), needed=True),
    "matrices/K": Array("real", ("z",), needed=True), "matrices/M": Array("real", ("z",), needed=True),
    "matrices/D": Array("real", ("z",)), "matrices/*": Array("real", ("z",)), ADDED: Array("text", ()),
    "inputs/B": Array("real", ("p", "n")), "inputs/names": Array("text", ("p",)),
    "loads/name": Array("text", ("l",)), "loads/kind": Array("text", ("l",)),
    "loads/remark": Array("text", ("l",)), "loads/area": Array("real", ("l",)),
    "loads/spins": Array("flag", ("l",)),
    "loads/sums": Array("real", ("l", 4, 3)),
    "outputs/C": Array("real", ("r", "n")), "outputs/Cv": Array("real", ("r", "n")),
    "outputs/Ca": Array("real", ("r", "n")), "outputs/direct": Array("real", ("r", "p")),
    "outputs/names": Array("text", ("r",)), "remarks": Array("text", ("?",)),
}  # fmt: skip


def write_model(path, model: SecondOrderModel) -> None:
    """Write a model. Collective.

    Parameters
    ----------
    path : str or PathLike
    model : SecondOrderModel

    Raises
    ------
    InputError
        If the folder cannot be written.
    """
    require_model(model)
    # all matrices have the pattern of K
    indptr, indices, values = model.K.getValuesCSR()
    arrays = {"K": values.real}
    for key, mat in model.matrices.items():
        arrays.setdefault(key, mat.getValuesCSR()[2].real)
    dense = {"inputs": (model.B, model.input_names), "outputs": (model.Ct, model.output_names)}
    direct = model.rates.direct
    version = ALSO[FORMAT] if model.added or direct is not None else VERSION
    with writing(path, model.comm, FORMAT, version) as file:
        file.attribute("size", model.size)
        file.attribute("rows_per_block", _block(model))
        if model.converted_from:
            file.attribute("converted_from", model.converted_from)
        write_csr(file, model.comm, indptr, indices, arrays)
        if model.circulatory:
            file.attribute("circulatory", 1)
        if model.added:
            file.small(ADDED, adapter_of(LAWS).dump_json(laws_of(model.added)).decode())
        # columns of inputs, rows of outputs
        for group, (mat, names) in dense.items():
            if mat is not None:
                rows = np.ascontiguousarray(mat.getDenseArray().real.T)
                arrays = {"B": rows} if group == "inputs" else model.rates.of(rows)
                for key, array in arrays.items():
                    file.rows(f"{group}/{key}", np.ascontiguousarray(array), axis=1)
                file.small(f"{group}/names", list(names))
        file.several({"outputs/direct": direct})
        if model.loads:
            for key in ("name", "kind", "remark", "area", "spins"):
                file.small(f"loads/{key}", [getattr(entry, key) for entry in model.loads])
            file.small("loads/sums", np.array([[getattr(entry, key) for key in SUMS] for entry in model.loads]))
        write_nodes(file, model)
        if model.remarks:
            file.small("remarks", list(model.remarks))


def write_csr(file, comm, indptr, indices, values):
    """The rows of this rank; all matrices on one pattern. Collective."""
    offset = comm.exscan(int(indptr[-1])) or 0
    starts = np.asarray(indptr[:-1], dtype=np.int64) + offset
    if comm.rank == comm.size - 1:
        starts = np.append(starts, offset + indptr[-1])
    file.rows("matrices/indptr", starts)
    file.rows("matrices/indices", np.asarray(indices))
    for key, data in values.items():
        file.rows(f"matrices/{key}", data)


def write_nodes(file, model):
    """Labels of the rows and of the held dofs, the elements, their properties and the node sets, of all ranks.
    Collective."""
    for group, dofs in (("dofs", model.dofs), ("held", model.held)):
        if dofs is not None:
            for key in ("node", "direction", "position"):
                file.rows(f"{group}/{key}", getattr(dofs, key))
    for kind, nodes in model.elements.items():
        file.rows(f"elements/{kind}", nodes)
    if (properties := model.properties) is not None:
        file.several({"element_program": properties.program, "element_types": list(properties.types),
                      "materials": adapter_of(MATERIALS).dump_json(properties.materials).decode()})  # fmt: skip
        for kind, table in properties.table.items():
            file.rows(f"element_properties/{kind}", table)
    for name in sorted(set().union(*model.comm.allgather(set(model.sets)))):
        file.rows(place_of_set(name), model.sets.get(name, np.zeros(0, np.int64)))


def read_properties(file, comm) -> ElementProperties | None:
    """The properties of the elements of this rank from an open file, or None where it has none."""
    if "element_types" not in file:
        return None
    tables = file.get("element_properties", {}).items()
    table = {kind: rows[slice(*row_range(comm, len(rows)))] for kind, rows in tables}
    try:
        materials = adapter_of(MATERIALS).validate_json(file["materials"][()])
    except ValidationError as error:
        raise damaged(file.path, f"/materials: {error.errors()[0]['msg']}") from error
    program = file["element_program"][()].decode()
    return ElementProperties(program, tuple(texts(file["element_types"])), materials, table)


def place_of_set(name: str) -> str:
    """Where the numbers of a node set are in a file. Raises InputError for an empty name."""
    if not name:
        raise InputError("sets: found a node set without a name, expected one with letters")
    # a name of a dot is that of the group itself in HDF5
    return f"sets/{quote(name, safe=' ', errors='surrogateescape') if name != '.' else '%2E'}"


def read_model(path, comm=MPI.COMM_WORLD) -> SecondOrderModel:
    """Read a model; each rank reads its rows only. Collective.

    Parameters
    ----------
    path : str or PathLike
    comm : MPI communicator
        By default all ranks.

    Raises
    ------
    InputError
        For a file that is no model, or damaged.
    """
    with agreed(comm), reading(path, FORMAT, VERSION, SCHEMA) as file:
        size = file.attribute("size")
        block = file.attribute("rows_per_block", default=1)
        if block < 1 or size < 1 or size % block:
            raise damaged(path, f"found {size} rows in blocks of {block} (rows_per_block), which do not fit")
        # the rows of this rank, of which the pointers of the rows say where their entries are
        first, last = row_range(comm, size, block)
        matrices = file["matrices"]
        indptr = matrices["indptr"][first : last + 1].astype(np.int64)
        span = slice(int(indptr[0]), int(indptr[-1]))
        if span.start < 0 or (np.diff(indptr) < 0).any() or span.stop > len(matrices["indices"]):
            raise damaged(path, "/matrices/indptr does not ascend from 0 to the number of entries")
        indices = matrices["indices"][span]
        if indices.size and not 0 <= indices.min() <= indices.max() < size:
            raise damaged(path, f"/matrices/indices has columns outside of 0 to {size - 1}")
        values = {key: matrices[key][span] for key in ("K", "M", "D") if key in matrices}
        # terms with a law of their own share the pattern of K
        laws = read_laws(file[ADDED]) if ADDED in file else ()
        added = {f"{KEY}{number}": matrices[f"{KEY}{number}"][span] for number in range(1, 1 + len(laws))}
        dense, names = {}, {}
        for group, key in (("inputs", "B"), ("outputs", "C")):
            dense[group] = file[f"{group}/{key}"][:, first:last].T if group in file else None
            names[group] = texts(file[f"{group}/names"]) if f"{group}/names" in file else []
        rates = {key: file[f"outputs/{key}"][:, first:last].T for key in ("Cv", "Ca") if f"outputs/{key}" in file}
        # the mesh, a share of each table on each rank
        dofs = _dofs(file["dofs"], first, last) if "dofs" in file else None
        held = _dofs(file["held"], *row_range(comm, len(file["held/node"]))) if "held" in file else None
        elements = {kind: rows[slice(*row_range(comm, len(rows)))] for kind, rows in file.get("elements", {}).items()}
        sets = {name: nodes[slice(*row_range(comm, len(nodes)))] for name, nodes in sets_of(file).items()}
        direct = file["outputs/direct"][...] if "outputs/direct" in file else None
        remarks = texts(file["remarks"]) if "remarks" in file else ()
        converted_from = file.attribute("converted_from", str, "")
        circulatory = bool(file.attribute("circulatory", default=0))
        properties = read_properties(file, comm)
        loads = _loads(file["loads"]) if "loads" in file else ()
    model = SecondOrderModel.from_csr(
        comm, size, indptr - indptr[0], indices, values, dense["inputs"], None if rates else dense["outputs"],
        dofs=dofs, input_names=names["inputs"], output_names=() if rates else names["outputs"], name=Path(path).name,
        elements=elements, held=held,
        sets=sets, remarks=remarks, converted_from=converted_from, properties=properties, circulatory=circulatory,
    )  # fmt: skip
    # outputs of velocities and accelerations, loads and laws are added to the model of M, D, K
    if rates:
        with model:
            model = model.with_output_columns(dense["outputs"], names["outputs"], **rates)
            if direct is not None:
                model = model.with_fields(rates=replace(model.rates, direct=direct))
    if not loads and not laws:
        return model
    with model:
        pattern = (indptr - indptr[0]).astype(PETSc.IntType), indices.astype(PETSc.IntType)
        mats = {key: PETSc.Mat().createAIJ(model.K.getSizes(), csr=(*pattern, values), comm=model.K.comm)
                for key, values in added.items()}  # fmt: skip
        whole = Operator.of(added=[Term(None, row.law, row.name) for row in laws])
        own = {key: copy(mat) for key, mat in model.matrices.items()}
        return model.with_fields(loads=loads, operator=whole.with_matrices(own | mats))


def read_laws(dataset) -> tuple[NamedLaw, ...]:
    """Return the names and laws of added terms. Raises InputError."""
    try:
        return adapter_of(LAWS).validate_json(dataset[()])
    except ValidationError as error:
        raise damaged(dataset.path, f"{dataset.name}: {error.errors()[0]['msg']}") from error


def sets_of(file) -> dict:
    """The datasets of the node sets of an open file, by the names of the sets."""
    return {unquote(name, errors="surrogateescape"): nodes for name, nodes in file.get("sets", {}).items()}


def _loads(group) -> tuple[LoadColumn, ...]:
    words = [texts(group[key]) for key in ("name", "kind", "remark")]
    spins = group["spins"][...].astype(bool).tolist() if "spins" in group else [False] * len(words[0])
    rows = zip(*words, spins, group["area"][...].tolist(), group["sums"][...].tolist(), strict=True)
    return tuple(
        LoadColumn(name=name, kind=kind, remark=remark, spins=turns, area=area,
                   **dict(zip(SUMS, map(tuple, sums), strict=True)))
        for name, kind, remark, turns, area, sums in rows
    )  # fmt: skip


def _dofs(group, first, last):
    return Dofs(*(group[key][first:last] for key in ("node", "direction", "position")))


def _block(model):
    """Dofs a node if it is the same for all nodes, so that a rank gets whole nodes; else 1. Collective."""
    if model.dofs is None:
        return 1
    sizes = set(model.comm.allgather(dofs_per_node(model.dofs) if len(model.dofs.node) else None)) - {None}
    return sizes.pop() if len(sizes) == 1 else 1
