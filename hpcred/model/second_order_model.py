"""Hold the flexible body of a finite-element program: M, D, K, B and C, distributed by rows as PETSc objects."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import MISSING, dataclass, field, fields
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..fe.dofs import SCALAR, Dofs
from ..fe.materials import ElementProperties, Material
from ..linalg.csr import diagonal_of
from ..linalg.matrix_estimates import extreme_quotients, symmetry_defect
from ..parallel.as_html import as_html
from ..parallel.declared import declared, spelled_with
from ..parallel.failures import InputError, agreed, settle, watched
from ..parallel.petsc import MPI, PETSc
from . import construction
from .checked_arrays import check_finite
from .construction import Labels
from .digests import PARTS, digest_of
from .interfaces.motion import with_interfaces
from .interfaces.nodes import Interface, InterfaceNode
from .loads.base import Base, with_bases
from .loads.columns import with_loads
from .loads.kinds import AnyLoad, LoadColumn
from .operator import ADDED, KEY, ORDERS, Operator, Term
from .outputs.cuts import CutOutput
from .outputs.motions import MotionOutput
from .outputs.rates import Rates, check_names
from .outputs.stresses import StressOutput
from .outputs.targets import interface_targets, output_columns, unit_columns
from .petsc_matrices import decoupled
from .viscoelastic import Viscoelastic, with_viscoelastic

if TYPE_CHECKING:
    from typing import TypeAlias

    from matplotlib.figure import Figure
    from scipy.sparse import sparray, spmatrix
    from typing_extensions import Unpack

    from ..linalg.solvers.settings import Factoring

    Matrix: TypeAlias = spmatrix | sparray | np.ndarray
    Targets: TypeAlias = Iterable[int | str | Sequence[int | str]]  # dofs, names of interfaces, (node, direction)
    OutputTargets: TypeAlias = Iterable[int | str | Sequence[int | str] | MotionOutput | StressOutput | CutOutput]

SYMMETRIC_TO = 1e-10  # symmetry_defect above which a matrix counts as unsymmetric
DECLARED = 1e-12  # the same of a K that may be so: what is more is not round-off of a few sums
UNSYMMETRIC = {"circulatory": True}  # fields of a model whose K may be unsymmetric
SAY_SO = "of K that has circulatory forces say circulatory = true"


def declared_in(fields_of_model) -> dict[str, str]:
    """Return what the fields of a model, or the keys of its job, declare of its matrices, in words."""
    return {key: "yes: K and its terms may be unsymmetric" for key in UNSYMMETRIC if fields_of_model.get(key)}


def sizes_of_sets(sets: dict, comm) -> dict[str, int]:
    """Return the number of members of each set, by name in order, whose parts (k,) are on the ranks. Collective."""
    sizes = comm.allgather({name: len(numbers) for name, numbers in sets.items()})
    return {name: sum(of_rank.get(name, 0) for of_rank in sizes) for name in sorted(set().union(*sizes))}


@dataclass(frozen=True, eq=False, repr=False, init=False)
class SecondOrderModel:
    """A model M q'' + D q' + K q = B u, y = C q with n unknowns, p inputs and r outputs, distributed by rows.

    Parameters
    ----------
    M, D, K : SciPy sparse matrix, ndarray or PETSc.Mat, shape (n, n)
        Mass, damping (None, or left out as in `SecondOrderModel(M=M, K=K, B=B)`) and stiffness. Every rank passes the
        whole of a SciPy matrix; PETSc matrices keep their distribution.
    B : ndarray or SciPy sparse matrix, shape (n, p), optional
        Columns of the inputs; with PETSc matrices the rows of this rank. `with_inputs` makes them from dofs.
    C : ndarray or SciPy sparse matrix, shape (r, n), optional
        Rows of the outputs, by default B^T; with PETSc matrices the columns that belong to the rows of this rank.
    Cv, Ca : ndarray or SciPy sparse matrix, shape (r, n), optional
        Rows for velocities and accelerations, y = C q + Cv q' + Ca q''; beside them C is zero by default.
    dofs : Dofs, optional
        Node, direction and position of the rows, which frames, interfaces and exports need.
    input_names, output_names : sequence of str, optional
        By default "input 1", "output 1" and so on.
    name : str, default "model"
        Name in messages.
    comm : MPI.Comm, optional
        Ranks that share SciPy matrices; by default all.
    circulatory : bool, default False
        Whether K may be unsymmetric, as with damping that turns with a shaft, oil films or friction. Without it a
        reduction refuses such a K, since damaged files look like that too.

    Raises
    ------
    InputError
        For NaN, Inf, empty rows, a negative diagonal of M, rows of PETSc matrices with a diagonal entry only, or shapes
        that do not fit.

    Notes
    -----
    Collective. `from_scipy`, `from_petsc` and `from_csr` take more, such as elements, node sets and held dofs.

    A model does not change after it was made; with_inputs and similar methods return another model on the same
    matrices. Each model owns references to its PETSc objects: call close(), or use it in a `with` block, to free the
    memory at once. Both are collective.

    Attributes
    ----------
    M, D, K : PETSc.Mat, shape (n, n)
        AIJ matrices on one pattern; D may be None.
    B : PETSc.Mat or None, shape (n, p)
        Dense.
    Ct : PETSc.Mat or None, shape (n, r)
        C^T, dense; None if C = B^T.
    own_output_names : tuple of str
        Names of the columns of Ct.
    elements : dict of str to ndarray, shape (elements of this rank, nodes)
        Node numbers by kind of element, if known, for pictures.
    held : Dofs or None
        Dofs that the finite-element program holds at zero, and that have no row; a part on each rank.
    sets : dict of str to ndarray
        Node numbers by name of the set; a part on each rank.
    remarks : tuple of str
        Messages of the readers of the files.
    Gt : PETSc.Mat or None, shape (n, 6 k)
        G^T, sparse, with the motions G q of k interface nodes.
    interfaces : tuple of InterfaceNode
    loads : tuple of LoadColumn
        The inputs that are loads, with the sums of their forces and moments.
    converted_from : str
        The original units of a model that was converted to SI.
    rates : Rates
        How velocities, accelerations and mixed outputs follow from the columns of Ct.
    properties : ElementProperties or None
        Numbers, types and materials of the elements, if known, for stresses and loads.
    operator : Operator
        M, D, K, and terms that are added to K, the static stiffness, all on one pattern.
    viscoelastic : tuple of Term
        The added terms, which viscoelastic parts are: (g(s) - g(0)) K_v.
    """

    operator: Operator
    B: PETSc.Mat | None = None
    Ct: PETSc.Mat | None = None
    dofs: Dofs | None = None
    input_names: tuple[str, ...] = ()
    own_output_names: tuple[str, ...] = ()
    name: str = "model"
    elements: dict[str, np.ndarray] = field(default_factory=dict)
    held: Dofs | None = None
    sets: dict[str, np.ndarray] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    Gt: PETSc.Mat | None = None
    interfaces: tuple[InterfaceNode, ...] = ()
    loads: tuple[LoadColumn, ...] = ()
    converted_from: str = ""
    properties: ElementProperties | None = None
    rates: Rates = Rates()
    circulatory: bool = False

    def __init__(
        self,
        M: Matrix | PETSc.Mat,
        D: Matrix | PETSc.Mat | None = None,
        K: Matrix | PETSc.Mat | None = None,
        B: Matrix | None = None,
        C: Matrix | None = None,
        *,
        dofs: Dofs | None = None,
        input_names: Iterable[str] = (),
        output_names: Iterable[str] = (),
        name: str = "model",
        comm: MPI.Comm | None = None,
        Cv: Matrix | None = None,
        Ca: Matrix | None = None,
        circulatory: bool = False,
    ) -> None:
        if K is None or len({*np.shape(K)}) > 1:
            fault = "K is missing" if K is None else f"K: found an array {np.shape(K)}, expected a square matrix"
            raise InputError(f"SecondOrderModel: {fault}; the order is M, D, K, B, C, and without damping "
                             "SecondOrderModel(M=M, K=K, B=B)")  # fmt: skip
        rates = Cv is not None or Ca is not None
        made = construction.from_given(
            M, D, K, B, None if rates else C, comm, dofs=dofs, input_names=input_names,
            output_names=() if rates else output_names, name=name, circulatory=circulatory,
        )  # fmt: skip
        self._take({"operator": Operator.of(*(made.pop(key, None) for key in "MDK"))} | made)
        if rates:
            local = [construction.local_columns(self, key, rows, isinstance(K, PETSc.Mat))
                     for key, rows in (("C", C), ("Cv", Cv), ("Ca", Ca))]  # fmt: skip
            self._take_outputs(*local, output_names)

    @classmethod
    def assembled(cls, M, K, D=None, **known) -> SecondOrderModel:
        """Return a model that takes over the PETSc matrices M, K and D (or None) and further fields, `known` by name,
        which must fit each other. Collective."""
        return cls.of_operator(Operator.of(M, D, K), **known)

    @classmethod
    def of_operator(cls, operator: Operator, **known) -> SecondOrderModel:
        """Return a model that takes over an `operator`, the terms of A(s), and further fields, `known` by name, which
        must fit each other. Collective."""
        model = object.__new__(cls)
        model._take({"operator": operator, **known})
        return model

    def _take(self, values):
        """Set the fields. Collective."""
        if not isinstance(declared := values.get("circulatory") or False, (bool, np.bool_)):
            raise InputError(f"circulatory: found {declared!r}, expected True or False: whether K is unsymmetric")
        for attribute in fields(self):
            if attribute.default_factory is not MISSING:
                vars(self)[attribute.name] = attribute.default_factory()
        vars(self).update((key, value) for key, value in values.items() if value is not None)
        watched(self.comm)

    def _take_outputs(self, C, Cv, Ca, names):
        """Set the outputs from rows of this rank of C^T, Cv^T and Ca^T, each or None. Collective."""
        count = next(rows.shape[1] for rows in (C, Cv, Ca) if rows is not None)
        names = tuple(names) or tuple(f"output {k + 1}" for k in range(count))
        Ct, rates = construction.measured_columns(self.K, C, Cv, Ca, names, f"{self.name}: outputs")
        vars(self).update(Ct=Ct, rates=rates, own_output_names=names)

    def __enter__(self) -> SecondOrderModel:
        return self

    def __exit__(self, _, error, __):
        if error is not None:
            settle(self.comm, error)
        self.close()

    def close(self) -> None:
        """Free the PETSc objects. Collective."""
        own = vars(self).pop("operator", Operator({}))  # PETSc ends the process that uses a destroyed matrix
        for mat in (*own.matrices.values(), self.B, self.Ct, self.Gt):
            if mat is not None:
                mat.destroy()

    def __getattr__(self, name):
        if name == "operator":
            raise InputError(f"{vars(self).get('name')}: this model was closed, and has no matrices any more")
        raise AttributeError(f"a SecondOrderModel has no attribute '{name}'", name=name, obj=self)

    def __repr__(self):
        """Return one line. Not collective, since notebooks and debuggers call it on one rank."""
        size = f"{self.K.getSize()[0]} dofs" if "operator" in vars(self) else "closed"
        return (f"<SecondOrderModel {self.name}: {size}, {len(self.input_names)} inputs, {len(self.output_names)} "
                "outputs>")  # fmt: skip

    def _repr_html_(self):
        """Return a table for notebooks. Not collective."""
        facts: dict[str, object] = {"dofs": "closed"}
        if "operator" in vars(self):
            facts = {"dofs": self.K.getSize()[0], "damping matrix": "none" if self.D is None else "yes"}
        facts |= {
            "nodes": "none" if self.dofs is None else "with positions",
            "inputs": listed(self.input_names),
            "outputs": listed(self.output_names),
            "interfaces": listed([interface.name for interface in self.interfaces]),
        }
        return as_html(f"{self.name}: M q'' + D q' + K q = B u, y = C q", facts)

    def __str__(self):
        """Return three lines that describe the model. Collective."""
        matrices = ", ".join(sorted(self.operator.terms))
        nodes = "without nodes" if self.dofs is None else f"{self.node_count} nodes"
        return (
            f"{self.name}: {self.size} dofs, {nodes}, on {self.comm.size} rank(s)\n"
            f"  matrices {matrices} with {self.nonzeros} nonzeros, {'symmetric' if self.symmetric else 'unsymmetric'}\n"
            f"  inputs {listed(self.input_names)}; outputs {listed(self.output_names)}"
        )

    def shared(self) -> SecondOrderModel:
        """Return the same model with its own references, to be closed separately."""
        return self.with_fields()

    def with_fields(self, **changed) -> SecondOrderModel:
        """Return the model with `changed` fields, and its own references to the other PETSc objects. Collective."""
        kept = {key: copy(mat) for key in ("B", "Ct", "Gt")
                if key not in changed and (mat := getattr(self, key)) is not None}  # fmt: skip
        if "operator" not in changed:
            mats = {key: changed[key] if key in changed else copy(mat) for key, mat in self.operator.matrices.items()}
            kept["operator"] = self.operator.with_matrices(changed | mats)
        fresh = {key: value for key, value in changed.items() if key not in {*ORDERS, *self.operator.terms}}
        own = {attribute.name: getattr(self, attribute.name) for attribute in fields(self)}
        new = self.of_operator(**own | kept | fresh)
        # what is known of the parts that stay
        other_parts = {*changed, "labels" if "dofs" in changed else "", "interfaces" if "Gt" in changed else ""}
        other_parts |= {*ORDERS, ADDED} if "operator" in changed else set()
        other_parts |= {ADDED} if changed.keys() & self.added.terms.keys() else set()
        new._known.update({(what, key): value for (what, key), value in self._known.items()
                             if key not in other_parts and not key.startswith(KEY)})  # fmt: skip
        return new

    @cached_property
    def _known(self) -> dict[tuple[str, str], Any]:
        """What was computed of parts of the model, such as ("digest", "K")."""
        return {}

    def _once(self, what: str, key: str, compute):
        """Return what compute() finds of a part, computed once for all models that share it."""
        if (what, key) not in self._known:
            self._known[what, key] = compute()
        return self._known[what, key]

    @property
    def M(self) -> PETSc.Mat:
        return self.operator["M"]

    @property
    def K(self) -> PETSc.Mat:
        return self.operator["K"]

    @property
    def D(self) -> PETSc.Mat | None:
        return self.operator.get("D")

    @property
    def added(self) -> Operator:
        """The terms beside M, D and K."""
        return self.operator.added

    @property
    def viscoelastic(self) -> tuple[Term, ...]:
        return tuple(self.added)

    @cached_property
    def comm(self) -> MPI.Comm:
        return self.K.comm.tompi4py()

    @cached_property
    def size(self) -> int:
        return self.K.getSize()[0]

    @cached_property
    def local_rows(self) -> int:
        return self.K.getLocalSize()[0]

    @cached_property
    def first_row(self) -> int:
        return int(self.K.getOwnershipRange()[0])

    @cached_property
    def row_starts(self) -> np.ndarray:
        """The first row of each rank (ranks,)."""
        return np.array(self.K.getOwnershipRanges()[:-1], dtype=np.int64)

    @property
    def node_count(self) -> int:
        """Number of nodes with a position; a node with rows on two ranks counts twice. Collective."""
        return self.comm.allreduce(len(np.unique(self.dofs.node[self.dofs.direction != SCALAR])))

    @property
    def set_sizes(self) -> dict[str, int]:
        """Number of nodes of each node set, by name in order. Collective."""
        return sizes_of_sets(self.sets, self.comm)

    @property
    def matrices(self) -> dict:
        """M, K and, if it is not None, D, by name, and the matrices of added terms as Kv1, Kv2, ..."""
        return self.operator.matrices

    @property
    def nonzeros(self) -> int:
        """Stored entries of K, and of each of the other matrices. Collective."""
        return int(self.K.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"])

    @property
    def output_names(self) -> tuple[str, ...]:
        return self.own_output_names if self.has_own_outputs else self.input_names

    @property
    def has_own_outputs(self) -> bool:
        """Whether the outputs are others than the inputs, C = B^T."""
        return self.Ct is not None or bool(self.rates)

    @property
    def symmetry_defects(self) -> dict[str, float]:
        """Largest |a_ij - a_ji| of M, K and D, over the larger of both or 1e-3 (a_ii a_jj)^(1/2). Collective."""
        return {key: self._once("defect", key, partial(symmetry_defect, mat)) for key, mat in self.matrices.items()}

    def take_symmetry(self, key: str, defect: float) -> None:
        """Take over the symmetry `defect`, see symmetry_defects, of M, K or D (`key`)."""
        self._known["defect", key] = defect

    def is_symmetric(self, key: str) -> bool:
        """Test whether M, K or D (`key`) is symmetric, or not there. Collective."""
        return self.counts_as_symmetric(key, self.symmetry_defects.get(key, 0.0))

    def counts_as_symmetric(self, key: str, defect: float) -> bool:
        """Test whether a symmetry `defect` of M, K or D (`key`), or of a term of it, is round-off: less is, of K and of
        what damping makes of it, where K may be unsymmetric."""
        return defect <= (DECLARED if self.circulatory and key != "M" else SYMMETRIC_TO)

    def may_be_unsymmetric(self, key: str) -> bool:
        """Test whether an unsymmetric M, K or D (`key`) is no error."""
        return key == "D" or (key == "K" and self.circulatory)

    @property
    def declared(self) -> dict[str, str]:
        """What is declared of the matrices, in words, for reports."""
        return declared_in(vars(self))

    def extreme_quotients(self, key: str) -> tuple[float, float]:
        """Return the smallest and the largest x^T A x / x^T |D| x that is found for K or M (`key`). Collective."""
        return self._once("signs", key, lambda: extreme_quotients(self.matrices[key], self.is_symmetric(key)))

    def rows_alone_in(self, key: str) -> np.ndarray:
        """Return the rows of this rank (local, from 0) with nothing beside the diagonal in M, K or D (`key`); local."""
        def rows_alone():
            indptr, indices, values = self.matrices[key].getValuesCSR()
            return decoupled(indptr, indices, [values], self.first_row)

        return self._once("alone", key, rows_alone)

    @property
    def symmetric(self) -> bool:
        return all(map(self.is_symmetric, self.matrices))

    def digest_of(self, key: str) -> str | None:
        """Return a digest of the content of a matrix or field, `key` (see digests), or of node and direction of all
        rows ("labels").

        None if the model has no such part. The digest is the same on any number of ranks and in both builds of PETSc.
        Collective.
        """
        return self._once("digest", key, partial(digest_of, self, key))

    @property
    def digests(self) -> dict[str, str]:
        """What tells the model from others: digests of all that its numbers depend on, by name of the part. Collective.
        """
        digests = {key: self.digest_of(key) for key in PARTS}
        return {key: value for key, value in digests.items() if value is not None}

    @cached_property
    def mean_diagonal_of_k(self) -> float:
        return self._traces["K"] / self.size

    @cached_property
    def mean_eigenvalue(self) -> float:
        """trace(K) / trace(M) in (rad/s)^2: a scale for "zero" among the eigenvalues. Collective."""
        return self._traces["K"] / self._traces["M"] if self._traces["M"] else 0.0

    @cached_property
    def _traces(self):
        return {key: float(self.matrices[key].getDiagonal().sum().real) for key in "KM"}

    def with_interfaces(self, interfaces: Iterable[Interface]) -> SecondOrderModel:
        """Return the model with interface nodes. Collective.

        Parameters
        ----------
        interfaces : iterable of Interface
            Definitions of the interfaces.

        Returns
        -------
        SecondOrderModel
            A model without inputs gets all directions of all interfaces as inputs. Rigid interfaces change the
            matrices.

        Raises
        ------
        InputError
            For names and sets that do not exist, and sets that do not define the motion of the reference node.
        """
        marked = with_interfaces(self, interfaces)
        if self.B is not None and self.input_names != interface_targets(self.interfaces):
            return marked
        if not marked.interfaces:
            return marked.with_fields(B=None, input_names=())
        return marked.with_inputs([interface.name for interface in marked.interfaces])

    def with_inputs(self, targets: Targets) -> SecondOrderModel:
        """Return the model with unit loads at dofs as inputs. Collective.

        Parameters
        ----------
        targets : iterable of int, str or (int or str, str)
            Numbers of dofs, from 1; pairs of a node or the name of an interface and a direction, where "all" means
            every direction; or the name of an interface for all its directions.

        Raises
        ------
        InputError
            For nodes, directions and names that do not exist.

        Examples
        --------
        >>> loaded = model.with_inputs([(20, "z"), ("crank", "all")])
        """
        return self.with_input_columns(*unit_columns(self, "inputs", targets))

    def with_outputs(self, targets: OutputTargets) -> SecondOrderModel:
        """Return the model with displacements, velocities or accelerations, stresses or section forces as outputs.
        Collective.

        Parameters
        ----------
        targets : iterable of int, str, (int or str, str), MotionOutput, StressOutput or CutOutput
            As for with_inputs, for displacements; or velocities and accelerations; stresses at nodes; or the forces of
            a cut.

        Raises
        ------
        InputError
            For nodes, directions and names that do not exist.
        """
        columns, names = output_columns(self, targets)
        return self.with_output_columns(columns.pop("C"), names, **columns)

    def with_material(self, material: Material) -> SecondOrderModel:
        """Return the model with all its elements of one `material`, where the files did not tell it. The types of
        elements stay; without types they are plain elements with full integration. Collective."""
        declared("material", material, Material)
        if self.properties is None:
            return self.with_fields(properties=ElementProperties.of_one(self.comm, self.elements, material))
        return self.with_fields(properties=self.properties.with_material(material))

    def with_input_columns(self, local: ArrayLike | None, names: Iterable[str]) -> SecondOrderModel:
        """Return the model with another B. Collective.

        Parameters
        ----------
        local : array_like or None, shape (rows of this rank, p)
            The rows of B that belong to this rank; None on all ranks for a model without inputs.
        names : iterable of str
            Names of the p inputs.

        Raises
        ------
        InputError
            For NaN, Inf, and shapes and numbers of names that do not fit.
        """
        B, names = construction.columns_of(self.K, local, names, f"{self.name}: inputs")
        return self.with_fields(B=B, input_names=names, loads=(), rates=self.rates.of_inputs(self.input_names, names))

    def with_loads(self, loads: Iterable[AnyLoad] = (), given: dict[str, ArrayLike] | None = None) -> SecondOrderModel:
        """Return the model with loads as further inputs, after those that it has. Collective.

        Parameters
        ----------
        loads : iterable of loads such as Pressure, Gravity or Centrifugal, default ()
            Each is a column of B.
        given : dict of str to array_like, shape (rows of this rank,), optional
            Load vectors by name.

        Returns
        -------
        SecondOrderModel
            Its `loads` have the sums of the forces and moments. Forces on held dofs count in them, and in nothing else.

        Raises
        ------
        InputError
            For sets, faces and edges that do not exist, loads on nodes without dofs, loads that are zero, and names
            that occur twice.

        Examples
        --------
        >>> loaded = model.with_loads([hpcred.loads.Pressure(name="oil", on="BORE", value=2e6)])
        """
        return with_loads(self, loads, given)

    def with_bases(self, bases: Iterable[Base], factoring: Factoring | None = None) -> SecondOrderModel:
        """Return the model on bases that move: with their accelerations as further inputs, after those that it has.
        Collective.

        Parameters
        ----------
        bases : iterable of hpcred.loads.Base
            Nodes that move as a rigid body, or all that the finite-element program holds.
        factoring : Factoring, optional
            How K is factored, for the static deflection between a base and other supports.

        Returns
        -------
        SecondOrderModel
            Without rows of the bases, which are held. Displacements, velocities, accelerations and stresses are those
            relative to the motion of the base; each `absolute` place adds an output, "absolute acceleration 20:z".

        Raises
        ------
        InputError
            For a base without held nodes, places that do not exist or do not hold the body, names that occur twice, and
            a model without nodes or outputs.

        Notes
        -----
        The column of an input is -M R, with the displacements R of the body under a unit motion of the base: that of a
        rigid body where all that holds it moves. Damping acts on relative motion.

        Examples
        --------
        >>> shaken = model.with_bases([hpcred.loads.Base(directions=("z",), absolute=[(20, "z")])])
        """
        return with_bases(self, bases, factoring)

    def with_output_columns(
        self, local: ArrayLike | None, names: Iterable[str], *, Cv: ArrayLike | None = None,
        Ca: ArrayLike | None = None,
    ) -> SecondOrderModel:  # fmt: skip
        """Return the model with another C. Collective.

        Parameters
        ----------
        local : array_like or None, shape (rows of this rank, r)
            The rows of C^T that belong to this rank; None on all ranks for C = B^T, or beside Cv and Ca for zero.
        names : iterable of str
            Names of the r outputs.
        Cv, Ca : array_like, shape (rows of this rank, r), optional
            The rows of Cv^T and Ca^T: y = C q + Cv q' + Ca q''.

        Raises
        ------
        InputError
            For NaN, Inf, and shapes and numbers of names that do not fit.
        """
        if Cv is None and Ca is None:
            Ct, names = construction.columns_of(self.K, local, names, f"{self.name}: outputs")
            check_names(names, np.array([[True], [False], [False]]).repeat(len(names), axis=1), f"{self.name}: outputs")
            return self.with_fields(Ct=Ct, own_output_names=names, rates=Rates())
        names = tuple(names)
        Ct, rates = construction.measured_columns(self.K, local, Cv, Ca, names, f"{self.name}: outputs")
        return self.with_fields(Ct=Ct, own_output_names=names, rates=rates)

    def with_damping_matrix(self, D: PETSc.Mat | None) -> SecondOrderModel:
        """Return the model with another damping matrix D (n, n) on the pattern of K, which it takes over, or with none.
        Collective. Raises InputError for NaN and Inf."""
        if declared("D", D, PETSc.Mat | None) is not None:
            with agreed(self.comm):
                indptr, _, values = D.getValuesCSR()
                check_finite(indptr, {"D": values}, D.getOwnershipRange()[0], self.name, self.dofs)
        return self.with_fields(D=D)

    def with_viscoelastic(self, parts: Iterable[Viscoelastic]) -> SecondOrderModel:
        """Return the model with stiffness that depends on frequency, K(s) = K + sum g(s) K_v. Collective.

        Parameters
        ----------
        parts : iterable of Viscoelastic
            Matrices K_v with their laws g.

        Returns
        -------
        SecondOrderModel
            Its K is the static stiffness K + sum g(0) K_v.

        Raises
        ------
        InputError
            For matrices that do not fit, are not symmetric, or have negative eigenvalues.

        Examples
        --------
        >>> rubber = hpcred.laws.Maxwell(factors=[0.5, 0.8], times=[1e-2, 1e-4], constant=1.0)
        >>> damped = model.with_viscoelastic([hpcred.Viscoelastic(Kv, rubber)])
        """
        return with_viscoelastic(self, parts)

    def as_dual(self) -> SecondOrderModel:
        """Return the model of the transposed transfer function of the measured columns: D^T for D, K^T for K, and C^T
        for B. Collective."""
        changed = {
            "B": None if self.Ct is None else copy(self.Ct), "Ct": None, "loads": (), "rates": Rates(),
            "input_names": () if self.rates else self.output_names,
        }  # fmt: skip
        for key in ("D", "K"):
            if not self.is_symmetric(key):
                changed[key] = getattr(self, key).transpose(PETSc.Mat())
        return self.with_fields(**changed)

    def in_coordinates(self, operator, T, dofs) -> SecondOrderModel:
        """Return the model in coordinates p with q = T p, from the `operator` T^T A T and labels `dofs` of the rows.

        It takes the matrices over. Collective.
        """
        B, Ct, Gt = (None if mat is None else T.transposeMatMult(mat) for mat in (self.B, self.Ct, self.Gt))
        return self.with_rows(operator, B=B, Ct=Ct, dofs=dofs, Gt=Gt, interfaces=self.interfaces)

    def with_rows(self, operator, **rows) -> SecondOrderModel:
        """Return the model with other rows: their `operator` and their fields, `rows`. Names and outputs stay, and what
        is known of the symmetry, which T^T A T has where A has it, whatever its round-off."""
        moved = self.of_operator(
            operator, **rows, input_names=self.input_names, own_output_names=self.own_output_names, name=self.name,
            rates=self.rates, circulatory=self.circulatory,
        )  # fmt: skip
        for key, defect in self.symmetry_defects.items():
            moved.take_symmetry(key, defect)
        return moved

    def frequency_response(self, frequencies: ArrayLike, *, frame=None, damping=None, **more) -> np.ndarray:
        """Return H(i omega) (F, r, p) at `frequencies` in Hz, as hpcred.frequency_response with `frame`, `damping` and
        `more` of its keywords. Collective."""
        import hpcred  # the public functions, which stand above

        return hpcred.frequency_response(self, frequencies, frame, damping, **more)

    def plot_modes(self, count: int = 6, *, frame=None, factoring=None) -> Figure | None:
        """Draw the `count` lowest elastic modes of a model with nodes, as hpcred.workflows.plot_modes with `frame` and
        `factoring`; None on all ranks but the first. Collective."""
        import hpcred  # the public functions, which stand above

        return hpcred.workflows.plot_modes(self, count, frame=frame, factoring=factoring)

    @classmethod
    @spelled_with(Labels)
    def from_csr(
        cls,
        comm: MPI.Comm,
        size: int,
        indptr: np.ndarray,
        indices: np.ndarray,
        values: dict[str, np.ndarray],
        inputs: ArrayLike | None = None,
        outputs: ArrayLike | None = None,
        *,
        held: Dofs | None = None,
        **labels: Unpack[Labels],
    ) -> SecondOrderModel:
        """Make a model from CSR rows, of which each rank passes its own. Collective.

        Parameters
        ----------
        comm : MPI.Comm
        size : int
            The number n of rows on all ranks.
        indptr : ndarray of int, shape (rows + 1,)
            Starts of the rows of this rank in `indices`.
        indices : ndarray of int, shape (nonzeros,)
            Global columns from 0, sorted in each row.
        values : dict of str to ndarray, shape (nonzeros,)
            Entries of "K", "M" and optionally "D" on this pattern.
        inputs, outputs : array_like, shape (rows, p) and (rows, r), optional
            Rows of B and of C^T; without `outputs` C = B^T.
        held : Dofs, optional
            Dofs that are held at zero and have no row.
        **labels
            dofs, input_names, output_names, name, elements, sets, remarks, converted_from, properties and circulatory,
            as the attributes of the model.

        Raises
        ------
        InputError
            For NaN, Inf, a negative diagonal of M, empty rows, repeated columns or labels, or shapes that do not fit.
        """
        return cls.assembled(
            **construction.from_csr(comm, size, indptr, indices, values, inputs, outputs, held=held, **labels)
        )

    @classmethod
    @spelled_with(Labels)
    def from_scipy(
        cls,
        K: Matrix,
        M: Matrix,
        D: Matrix | None = None,
        comm: MPI.Comm = MPI.COMM_WORLD,
        *,
        inputs: ArrayLike | Matrix | None = None,
        outputs: ArrayLike | Matrix | None = None,
        held: Dofs | None = None,
        **labels: Unpack[Labels],
    ) -> SecondOrderModel:
        """Make a model from SciPy sparse or NumPy matrices that every rank holds, for small models. Collective.

        Parameters
        ----------
        K, M : sparse matrix or ndarray, shape (n, n)
            Stiffness and mass.
        D : sparse matrix or ndarray, shape (n, n), optional
            Damping.
        comm : MPI.Comm, default all ranks
        inputs, outputs : array_like or sparse matrix, shape (n, p) and (n, r), optional
            B and C^T; without `outputs` C = B^T.
        held, **labels
            As for from_csr, but with `dofs` of all rows.

        Raises
        ------
        InputError
            As from_csr.
        """
        return cls.assembled(**construction.from_arrays(K, M, D, comm, inputs, outputs, held=held, **labels))

    @classmethod
    @spelled_with(Labels)
    def from_petsc(
        cls,
        K: PETSc.Mat,
        M: PETSc.Mat,
        D: PETSc.Mat | None = None,
        nodes: ArrayLike | None = None,
        *,
        numbers: ArrayLike | None = None,
        held: ArrayLike | None = None,
        inputs: ArrayLike | None = None,
        outputs: ArrayLike | None = None,
        **labels: Unpack[Labels],
    ) -> SecondOrderModel:
        """Make a model from assembled PETSc matrices, such as those of finite-element libraries. Collective.

        Parameters
        ----------
        K, M : PETSc.Mat, shape (n, n)
            Stiffness and mass, with one layout of rows and columns. The model keeps references: they may be destroyed,
            but must not be changed.
        D : PETSc.Mat, shape (n, n), optional
            Damping.
        nodes : array_like, shape (nodes of this rank, 3), optional
            Positions in m, in the order of the rows, in place of `dofs` where each node has the same number of rows in
            x, y, z (rx, ry, rz).
        numbers : array_like of int, shape (nodes of this rank,), optional
            Numbers of the nodes; by default from 1 over all ranks.
        held : array_like of int, optional
            Global numbers, from 0, of rows with boundary conditions, named by any rank; the model is made without them.
            [] for none.
        inputs, outputs, **labels
            As for from_csr; inputs and outputs of the rows that are not held, `dofs` of all.

        Raises
        ------
        InputError
            As from_csr, for imaginary parts, and without `held` for rows that have a diagonal entry only, as libraries
            leave rows with boundary conditions.

        Notes
        -----
        Matrices are copied only if their nonzero patterns differ, if rows are held, or from storage types other than
        AIJ.
        """
        return cls.assembled(**construction.from_petsc(K, M, D, nodes, numbers, held, inputs, outputs, **labels))


def require_model(model) -> None:
    """Raise InputError unless this is a SecondOrderModel that is not closed."""
    declared("model", model, SecondOrderModel)
    model.K  # noqa: B018  (refused here)


def massless(model) -> int:
    """Return the number of dofs without mass on the diagonal of M. Collective."""
    return model.comm.allreduce(int((diagonal_of(model.M) == 0).sum()))


def require_inputs(model):
    """Raise InputError for a model without inputs."""
    if model.B is None or not model.input_names:
        raise InputError(f"{model.name} has no inputs; name them by `inputs` (in Python: with_inputs of the model), as "
                         "dof numbers or [node, direction]")  # fmt: skip


def listed(names, most=4) -> str:
    """Return names in a line, or the first few of many."""
    shown = ", ".join(names[:most]) + (f", ... ({len(names)})" if len(names) > most else "")
    return shown or "none"
