"""Hold the flexible body of a finite-element program: M, D, K, B and C, distributed by rows as PETSc objects."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import MISSING, dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..linalg.blocks import dense_matrix
from ..linalg.csr import compress
from ..linalg.definiteness import extreme_quotients
from ..parallel.declared import declared, spelled
from ..parallel.failures import InputError, Owned, agreed, settle, watched
from ..parallel.petsc import MPI, PETSc, free_dropped
from ..parallel.shares import row_range
from .checked_arrays import (
    check_columns,
    check_finite,
    check_rows,
    coordinates,
    named_columns,
    real_columns,
    real_values,
    row_name,
)
from .digests import digest_of
from .dofs import SCALAR, Dofs, check_labels, dofs_per_node, row_of, target_name
from .elements import check_elements
from .interface_motion import with_interfaces
from .interfaces import Interface, InterfaceNode, interface_column, interface_targets, single_targets
from .petsc_matrices import decoupled, labels, taken

if TYPE_CHECKING:
    from typing import TypeAlias

    from matplotlib.figure import Figure
    from scipy.sparse import sparray, spmatrix

    Matrix: TypeAlias = spmatrix | sparray | np.ndarray
    Targets: TypeAlias = Iterable[int | str | Sequence[int | str]]  # dofs, names of interfaces, (node, direction)

SYMMETRIC_TO = 1e-10  # ||A - A^T|| / ||A|| above which a matrix counts as unsymmetric


def sizes_of_sets(sets: dict, comm) -> dict[str, int]:
    """Return the number of members of each set, by name in order, whose parts (k,) are on the ranks. Collective."""
    parts = comm.allgather({name: len(part) for name, part in sets.items()})
    return {name: sum(part.get(name, 0) for part in parts) for name in sorted(set().union(*parts))}


@dataclass(frozen=True, eq=False, repr=False, init=False)
class SecondOrderModel:
    """A model M q'' + D q' + K q = B u, y = C q with n unknowns, p inputs and r outputs, distributed by rows.

    Parameters
    ----------
    M, D, K : SciPy sparse matrix, ndarray or PETSc.Mat, shape (n, n)
        Mass, damping (or None) and stiffness. Every rank passes the whole of a SciPy matrix; PETSc matrices keep their
        distribution.
    B : ndarray or SciPy sparse matrix, shape (n, p), optional
        Columns of the inputs; with PETSc matrices the rows of this rank. `with_inputs` makes them from dofs.
    C : ndarray or SciPy sparse matrix, shape (r, n), optional
        Rows of the outputs, by default B^T; with PETSc matrices the columns that belong to the rows of this rank.
    dofs : Dofs, optional
        Node, direction and position of the rows, which frames, interfaces and exports need.
    input_names, output_names : sequence of str, optional
        By default "input 1", "output 1" and so on.
    name : str, default "model"
        Name in messages.
    comm : MPI.Comm, optional
        Ranks that share SciPy matrices; by default all.

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
    M, K : PETSc.Mat, shape (n, n)
        AIJ matrices on one pattern.
    D : PETSc.Mat or None, shape (n, n)
        Damping matrix, on the same pattern.
    B : PETSc.Mat or None, shape (n, p)
        Dense.
    Ct : PETSc.Mat or None, shape (n, r)
        C^T, dense; None if C = B^T.
    dofs : Dofs or None
        Labels of the rows of this rank.
    input_names, own_output_names : tuple of str
        Names of the columns of B and of Ct.
    name : str
        Name in messages.
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
        The interface nodes.
    converted_from : str
        The original units of a model that was converted to SI.
    """

    M: PETSc.Mat
    K: PETSc.Mat
    D: PETSc.Mat | None = None
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
    converted_from: str = ""

    def __init__(
        self,
        M: Matrix | PETSc.Mat,
        D: Matrix | PETSc.Mat | None,
        K: Matrix | PETSc.Mat,
        B: Matrix | None = None,
        C: Matrix | None = None,
        *,
        dofs: Dofs | None = None,
        input_names: Iterable[str] = (),
        output_names: Iterable[str] = (),
        name: str = "model",
        comm: MPI.Comm | None = None,
    ) -> None:
        made = _from_petsc if isinstance(K, PETSc.Mat) else _from_arrays
        labels = {"dofs": dofs, "input_names": input_names, "output_names": output_names, "name": name}
        vars(self).update(vars(made(M, D, K, B, C, comm, **labels)))

    @classmethod
    def assembled(cls, M, K, D=None, **known) -> SecondOrderModel:
        """Return a model that takes over these fields, which must fit each other. Collective."""
        model = object.__new__(cls)
        for item in fields(cls):
            if item.default_factory is not MISSING:
                vars(model)[item.name] = item.default_factory()
        vars(model).update(M=M, K=K, D=D, **known)
        watched(model.comm)
        return model

    def __enter__(self) -> SecondOrderModel:
        return self

    def __exit__(self, _, error, __):
        if error is not None:
            settle(self.comm, error)
        self.close()

    def close(self) -> None:
        """Free the PETSc objects. Collective."""
        for key in ("M", "D", "K", "B", "Ct", "Gt"):
            if (mat := vars(self).get(key)) is not None:
                mat.destroy()
        for key in ("M", "K"):  # PETSc ends the process that uses a destroyed matrix
            vars(self).pop(key, None)

    def __getattr__(self, name):
        if name in ("M", "K"):
            raise InputError(f"{vars(self).get('name')}: this model was closed, and has no matrices any more")
        raise AttributeError(f"a SecondOrderModel has no attribute '{name}'")

    def __repr__(self):
        """Return one line. Not collective, since notebooks and debuggers call it on one rank."""
        size = f"{self.K.getSize()[0]} dofs" if "K" in vars(self) else "closed"
        return (f"<SecondOrderModel {self.name}: {size}, {len(self.input_names)} inputs, {len(self.output_names)} "
                "outputs>")  # fmt: skip

    def __str__(self):
        """Return three lines that describe the model. Collective."""
        matrices = ", ".join(sorted(self.matrices))
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
        """Return the model with other fields, and its own references to the other PETSc objects. Collective."""
        kept = {key: copy(mat) for key in ("M", "K", "D", "B", "Ct", "Gt")
                if key not in changed and (mat := getattr(self, key)) is not None}  # fmt: skip
        other = self.assembled(**{item.name: getattr(self, item.name) for item in fields(self)} | kept | changed)
        for name in ("_digests", "_defects", "_signs"):
            known, shared = getattr(self, name), getattr(other, name)
            shared.update({key: value for key, value in known.items() if key not in changed})
        return other

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
        """M, K and, if it is not None, D, by name."""
        return {key: mat for key, mat in (("M", self.M), ("K", self.K), ("D", self.D)) if mat is not None}

    @property
    def nonzeros(self) -> int:
        """Stored entries of K, and of each of the other matrices. Collective."""
        return int(self.K.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"])

    @property
    def output_names(self) -> tuple[str, ...]:
        return self.input_names if self.Ct is None else self.own_output_names

    @property
    def symmetry_defects(self) -> dict[str, float]:
        """Estimated ||A - A^T||_F / ||A||_F of M, K and D, from two random vectors. Collective."""
        for key, mat in self.matrices.items():
            if key not in self._defects:
                self._defects[key] = symmetry_defect(mat)
        return {key: self._defects[key] for key in self.matrices}

    def extreme_quotients(self, key: str) -> tuple[float, float]:
        """Return the smallest and the largest x^T A x / x^T |D| x that is found for K or M. Collective."""
        if key not in self._signs:
            self._signs[key] = extreme_quotients(self.matrices[key])
        return self._signs[key]

    @property
    def symmetric(self) -> bool:
        return all(defect <= SYMMETRIC_TO for defect in self.symmetry_defects.values())

    @cached_property
    def _digests(self):
        return {}

    @cached_property
    def _defects(self):
        return {}

    @cached_property
    def _signs(self):
        return {}

    def digest_of(self, key: str) -> str | None:
        """Return a digest of the content of M, K, D, B, Ct or dofs, or of node and direction of all rows ("labels").

        None if the model has no such part. The digest is the same on any number of ranks and in both builds of PETSc.
        Collective.
        """
        if key not in self._digests:
            there = getattr(self, "dofs" if key == "labels" else key) is not None
            self._digests[key] = digest_of(self, key) if there else None
        return self._digests[key]

    @cached_property
    def mean_diagonal_of_k(self) -> float:
        return self._trace(self.K) / self.size

    @cached_property
    def mean_eigenvalue(self) -> float:
        """trace(K) / trace(M) in (rad/s)^2: a scale for "zero" among the eigenvalues. Collective."""
        mass = self._trace(self.M)
        return self._trace(self.K) / mass if mass else 0.0

    @staticmethod
    def _trace(mat):
        diagonal = mat.getDiagonal()
        value = float(diagonal.sum().real)
        diagonal.destroy()
        return value

    def with_interfaces(self, interfaces: Iterable[Interface]) -> SecondOrderModel:
        """Return the model with interface nodes.

        Collective.

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
        with marked:
            if not marked.interfaces:
                return marked.with_fields(B=None, input_names=())
            return marked.with_inputs([item.name for item in marked.interfaces])

    def with_inputs(self, targets: Targets) -> SecondOrderModel:
        """Return the model with unit loads at dofs as inputs.

        Collective.

        Parameters
        ----------
        targets : iterable of int, str or (int or str, str)
            Numbers of dofs, from 1; pairs of a node or the name of an interface and a direction, where "all" means
            every direction; or the name of an interface for all its directions.

        Returns
        -------
        SecondOrderModel

        Raises
        ------
        InputError
            For nodes, directions and names that do not exist.

        Examples
        --------
        >>> loaded = model.with_inputs([(20, "z"), ("crank", "all")])
        """
        return self.with_input_columns(*self._unit_columns("inputs", targets))

    def with_outputs(self, targets: Targets) -> SecondOrderModel:
        """Return the model with displacements at dofs as outputs.

        Collective.

        Parameters
        ----------
        targets : iterable of int, str or (int or str, str)
            As for with_inputs.

        Returns
        -------
        SecondOrderModel

        Raises
        ------
        InputError
            For nodes, directions and names that do not exist.
        """
        return self.with_output_columns(*self._unit_columns("outputs", targets))

    def with_input_columns(self, local: ArrayLike | None, names: Iterable[str]) -> SecondOrderModel:
        """Return the model with another B.

        Collective.

        Parameters
        ----------
        local : array_like or None, shape (rows of this rank, p)
            The rows of B that belong to this rank; None on all ranks for a model without inputs.
        names : iterable of str
            Names of the p inputs.

        Returns
        -------
        SecondOrderModel

        Raises
        ------
        InputError
            For NaN, Inf, and shapes and numbers of names that do not fit.
        """
        local, names = named_columns(self.comm, self.local_rows, local, names, f"{self.name}: inputs")
        return self.with_fields(B=None if local is None else dense_matrix(self.K, local), input_names=names)

    def with_output_columns(self, local: ArrayLike | None, names: Iterable[str]) -> SecondOrderModel:
        """Return the model with another C.

        Collective.

        Parameters
        ----------
        local : array_like or None, shape (rows of this rank, r)
            The rows of C^T that belong to this rank; None on all ranks for C = B^T.
        names : iterable of str
            Names of the r outputs.

        Returns
        -------
        SecondOrderModel

        Raises
        ------
        InputError
            For NaN, Inf, and shapes and numbers of names that do not fit.
        """
        local, names = named_columns(self.comm, self.local_rows, local, names, f"{self.name}: outputs")
        return self.with_fields(Ct=None if local is None else dense_matrix(self.K, local), own_output_names=names)

    def with_damping_matrix(self, D: PETSc.Mat | None) -> SecondOrderModel:
        """Return the model with another damping matrix.

        Collective.

        Parameters
        ----------
        D : PETSc.Mat or None, shape (n, n)
            On the pattern of K. The model takes it over.

        Returns
        -------
        SecondOrderModel

        Raises
        ------
        InputError
            For NaN and Inf.
        """
        if declared("D", D, PETSc.Mat | None) is not None:
            with agreed(self.comm):
                indptr, _, values = D.getValuesCSR()
                check_finite(indptr, {"D": values}, D.getOwnershipRange()[0], self.name, self.dofs)
        return self.with_fields(D=D)

    def as_dual(self) -> SecondOrderModel:
        """Return the model of the transposed transfer function: D^T for D, C^T for B. Collective."""
        changed = {"B": None if self.Ct is None else copy(self.Ct), "Ct": None, "input_names": self.output_names}
        if self.D is not None and not self.symmetric:
            changed["D"] = PETSc.Mat()
            self.D.transpose(changed["D"])
        return self.with_fields(**changed)

    def in_coordinates(self, matrices, T, dofs) -> SecondOrderModel:
        """Return the model in coordinates p with q = T p, from the `matrices` T^T A T by name and labels of the rows.

        It takes the matrices over. Collective.
        """
        B, Ct, Gt = (None if mat is None else T.transposeMatMult(mat) for mat in (self.B, self.Ct, self.Gt))
        return self.assembled(
            matrices["M"], matrices["K"], matrices.get("D"), B=B, Ct=Ct, dofs=dofs, input_names=self.input_names,
            own_output_names=self.own_output_names, name=self.name, Gt=Gt, interfaces=self.interfaces,
        )  # fmt: skip

    def frequency_response(self, frequencies: ArrayLike, *, frame=None, damping=None, **more) -> np.ndarray:
        """Return the frequency response H(i omega) = C A(i omega)^-1 B, as hpcred.frequency_response.

        Collective.

        Parameters
        ----------
        frequencies : array_like, shape (F,)
            Hz.
        frame : Frame, optional
            Reference frame of a free body; by default none.
        damping : Damping, optional
            By default the damping matrix of the model, if it has one.
        **more
            Further keywords of hpcred.frequency_response.

        Returns
        -------
        ndarray, complex, shape (F, r, p)
            The same on all ranks.
        """
        import hpcred  # the public functions, which stand above

        return hpcred.frequency_response(self, frequencies, frame, damping, **more)

    def plot_modes(self, count: int = 6, *, frame=None, factoring=None) -> Figure | None:
        """Draw the lowest elastic modes of a model with nodes, as hpcred.plot_modes.

        Collective.

        Parameters
        ----------
        count : int, default 6
            Number of elastic modes.
        frame : Frame, optional
            Reference frame of a free body; by default none.
        factoring : Factoring, optional
            Solver options.

        Returns
        -------
        matplotlib.figure.Figure or None
            On rank 0; None on the others.
        """
        import hpcred  # the public functions, which stand above

        return hpcred.plot_modes(self, count, frame=frame, factoring=factoring)

    def _unit_columns(self, key, targets):
        """Return the rows of this rank of unit columns, or of columns of G^T, and their names."""
        targets = declared(key, targets, tuple[int | str | tuple[int | str, str], ...])
        if not targets:
            raise InputError(f"{key}: found an empty list, expected dof numbers, (node, direction) or interfaces")
        targets = [single for target in targets for single in single_targets(self, target)]
        local = np.zeros((self.local_rows, len(targets)))
        for j, target in enumerate(targets):
            column = interface_column(self, target)
            if column is not None:
                vector = self.Gt.getColumnVector(column)
                local[:, j] = vector.getArray(readonly=True).real
                vector.destroy()
            elif 0 <= (row := row_of(self, target) - self.first_row) < self.local_rows:
                local[row, j] = 1.0
        return local, [target_name(target) for target in targets]

    @classmethod
    @spelled
    def from_csr(
        cls,
        comm: MPI.Comm,
        size: int,
        indptr: np.ndarray,
        indices: np.ndarray,
        values: dict[str, np.ndarray],
        inputs: ArrayLike | None = None,
        outputs: ArrayLike | None = None,
        dofs: Dofs | None = None,
        input_names: Iterable[str] = (),
        output_names: Iterable[str] = (),
        name: str = "model",
        elements: dict[str, np.ndarray] | None = None,
        held: Dofs | None = None,
        sets: dict[str, np.ndarray] | None = None,
        remarks: Iterable[str] = (),
        converted_from: str = "",
    ) -> SecondOrderModel:
        """Make a model from CSR rows, of which each rank passes its own.

        Collective.

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
        dofs : Dofs, optional
            Labels of the rows of this rank.
        input_names, output_names : iterable of str, optional
            By default "input 1", "output 1" and so on.
        name : str, default "model"
            Name in messages.
        elements : dict of str to ndarray, shape (elements of this rank, nodes), optional
            Node numbers by kind of element, for pictures.
        held : Dofs, optional
            Dofs that are held at zero and have no row.
        sets : dict of str to ndarray, optional
            Node numbers by name of the set.
        remarks : iterable of str, optional
            Messages that the model keeps.
        converted_from : str, optional
            The original units of a model that was converted to SI.

        Returns
        -------
        SecondOrderModel

        Raises
        ------
        InputError
            For NaN, Inf, a negative diagonal of M, empty rows, repeated columns or labels, or shapes that do not fit.
        """
        free_dropped(comm)
        rows = len(indptr) - 1
        first = comm.exscan(rows) or 0
        with agreed(comm):
            for key in ("K", "M"):
                if key not in values:
                    raise InputError(f"{name}: no matrix {key}; a model needs K and M")
            check_labels(dofs, rows, name)
            check_elements(elements, name)
            check_columns(indptr, indices, size, first, name, dofs)
            check_rows(indptr, indices, values, first, name, dofs)
        if comm.size > size:
            raise InputError(
                f"{name}: {size} rows cannot be distributed over {comm.size} ranks; start at most {size} ranks"
            )
        inputs, input_names = named_columns(comm, rows, inputs, input_names, f"{name}: inputs")
        outputs, output_names = named_columns(comm, rows, outputs, output_names, f"{name}: outputs")
        mats = {}
        indptr = np.asarray(indptr, dtype=PETSc.IntType)
        indices = np.asarray(indices, dtype=PETSc.IntType)
        for key, data in values.items():
            mats[key] = PETSc.Mat().createAIJ(((rows, size), (rows, size)), csr=(indptr, indices, data), comm=comm)
        B, Ct = (None if local is None else dense_matrix(mats["K"], local) for local in (inputs, outputs))
        return cls.assembled(
            mats["M"], mats["K"], mats.get("D"), B=B, Ct=Ct, dofs=dofs, input_names=input_names,
            own_output_names=output_names, name=name, elements=elements or {}, held=held, sets=sets or {},
            remarks=tuple(remarks), converted_from=converted_from,
        )  # fmt: skip

    @classmethod
    @spelled
    def from_scipy(
        cls,
        K: Matrix,
        M: Matrix,
        D: Matrix | None = None,
        comm: MPI.Comm = MPI.COMM_WORLD,
        *,
        inputs: ArrayLike | Matrix | None = None,
        outputs: ArrayLike | Matrix | None = None,
        dofs: Dofs | None = None,
        input_names: Iterable[str] = (),
        output_names: Iterable[str] = (),
        name: str = "model",
        elements: dict[str, np.ndarray] | None = None,
        held: Dofs | None = None,
        sets: dict[str, np.ndarray] | None = None,
        remarks: Iterable[str] = (),
        converted_from: str = "",
    ) -> SecondOrderModel:
        """Make a model from SciPy sparse or NumPy matrices that every rank holds, for small models.

        Collective.

        Parameters
        ----------
        K, M : sparse matrix or ndarray, shape (n, n)
            Stiffness and mass.
        D : sparse matrix or ndarray, shape (n, n), optional
            Damping.
        comm : MPI.Comm, default all ranks
        inputs, outputs : array_like or sparse matrix, shape (n, p) and (n, r), optional
            B and C^T; without `outputs` C = B^T.
        dofs : Dofs, optional
            Labels of all rows.
        input_names, output_names, name, elements, held, sets, remarks, converted_from
            As for from_csr.

        Returns
        -------
        SecondOrderModel

        Raises
        ------
        InputError
            As from_csr.
        """
        given = {key: coordinates(key, mat) for key, mat in (("K", K), ("M", M), ("D", D)) if mat is not None}
        sizes = {key: item[3] for key, item in given.items()}
        size = max(sizes.values(), default=0)
        if len(set(sizes.values())) > 1:
            found = ", ".join(f"{n} rows of {key}" for key, n in sizes.items())
            raise InputError(f"from_scipy: found {found}, expected the same number")
        check_labels(dofs, size, "from_scipy")
        per_node = dofs_per_node(dofs) if dofs is not None else 1
        first, last = row_range(comm, size, per_node)
        inputs, outputs = (
            None if columns is None else real_columns(columns, size, f"from_scipy: {key}")[first:last]
            for key, columns in (("inputs", inputs), ("outputs", outputs))
        )
        mine = {}
        for key, (i, j, v, _) in given.items():
            # a structurally symmetric pattern, also for an unsymmetric D
            i, j, v = np.concatenate([i, j]), np.concatenate([j, i]), np.concatenate([v, np.zeros(len(v))])
            local = (i >= first) & (i < last)
            mine[key] = i[local], j[local], v[local]
        indptr, indices, values = compress(mine, first, last, size)
        return cls.from_csr(
            comm, size, indptr, indices, values, inputs, outputs, dofs and dofs.take(slice(first, last)), input_names,
            output_names, name, elements, held, sets, remarks, converted_from,
        )  # fmt: skip

    @classmethod
    @spelled
    def from_petsc(
        cls,
        K: PETSc.Mat,
        M: PETSc.Mat,
        D: PETSc.Mat | None = None,
        nodes: ArrayLike | None = None,
        *,
        numbers: ArrayLike | None = None,
        dofs: Dofs | None = None,
        held: ArrayLike | None = None,
        name: str = "model",
        elements: dict[str, np.ndarray] | None = None,
        sets: dict[str, np.ndarray] | None = None,
    ) -> SecondOrderModel:
        """Make a model from assembled PETSc matrices, such as those of finite-element libraries.

        Collective.

        Parameters
        ----------
        K, M : PETSc.Mat, shape (n, n)
            Stiffness and mass, with one layout of rows and columns. The model keeps references: they may be destroyed,
            but must not be changed.
        D : PETSc.Mat, shape (n, n), optional
            Damping.
        nodes : array_like, shape (nodes of this rank, 3), optional
            Positions in m, in the order of the rows; each node has the same number of rows in x, y, z (rx, ry, rz).
        numbers : array_like of int, shape (nodes of this rank,), optional
            Numbers of the nodes; by default from 1 over all ranks.
        dofs : Dofs, optional
            Labels of the rows of this rank in place of `nodes`, if nodes have different rows.
        held : array_like of int, optional
            Global numbers, from 0, of rows with boundary conditions, named by any rank; the model is made without them.
            [] for none.
        name : str, default "model"
            Name in messages.
        elements, sets : dict of str to ndarray, optional
            As for from_csr.

        Returns
        -------
        SecondOrderModel

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
        given = {key: mat for key, mat in (("K", K), ("M", M), ("D", D)) if mat is not None}
        mats, free = taken(given, held, name)
        comm = mats["K"].comm.tompi4py()
        with Owned(comm) as owned:
            for mat in mats.values():
                owned.owns(mat)
            dofs = labels(K, nodes, numbers, dofs, name)
            away = None
            if dofs is not None:
                away = dofs.take(np.setdiff1d(np.arange(len(dofs.node)), free))
                away, dofs = away if comm.allreduce(len(away.node)) else None, dofs.take(free)
            choice_made = any(comm.allgather(held is not None))
            first = mats["K"].getOwnershipRange()[0]
            with agreed(comm):
                check_elements(elements, name)
                indptr, indices, _ = mats["K"].getValuesCSR()
                values = {key: real_values(mat.getValuesCSR()[2], f"{name}: {key}") for key, mat in mats.items()}
                check_rows(indptr, indices, values, first, name, dofs)
                alone = [] if choice_made else decoupled(indptr, indices, values.values(), first)
                if len(alone):
                    raise InputError(
                        f"{name}: found {len(alone)} rows with nothing beside the diagonal, the first is "
                        f"{row_name(alone[0], first, dofs)}, as boundary conditions leave them; name such rows by "
                        "`held`, or give held=[] to keep them"
                    )
            return cls.assembled(
                copy(mats["M"]), copy(mats["K"]), copy(mats["D"]) if "D" in mats else None, dofs=dofs, name=name,
                elements=elements or {}, held=away, sets=sets or {},
            )  # fmt: skip


def _from_arrays(M, D, K, B, C, comm, **labels):
    """Return the model of matrices that every rank holds."""
    B, Ct = _columns(B, C, np.shape(K)[0] if np.ndim(K) else 0)
    outputs = None if _same(B, Ct) else Ct
    return SecondOrderModel.from_scipy(K, M, D, comm or MPI.COMM_WORLD, inputs=B, outputs=outputs, **labels)


def _from_petsc(M, D, K, B, C, comm, input_names, output_names, **labels):
    """Return the model of PETSc matrices, with the rows of B and the columns of C that belong to this rank."""
    if comm is not None:
        raise InputError("comm: found it beside PETSc matrices, which have one; leave it out")
    with SecondOrderModel.from_petsc(K, M, D, **labels) as bare:
        with agreed(bare.comm):
            B, Ct = _columns(B, C, bare.local_rows)
        outputs = None if all(bare.comm.allgather(_same(B, Ct))) else Ct
        with bare.with_input_columns(B, input_names) as loaded:
            return loaded.with_output_columns(outputs, output_names)


def _columns(B, C, rows):
    """Return B and C^T with so many rows, as arrays or SciPy matrices, or None. Raises InputError for other shapes."""
    B, C = (item if item is None or hasattr(item, "tocsr") else np.asarray(item) for item in (B, C))
    for key, item, axis, expected in (("B", B, 0, f"({rows}, inputs)"), ("C", C, 1, f"(outputs, {rows})")):
        if item is not None and (item.ndim != 2 or item.shape[axis] != rows):
            turned = f"; give {key}.T" if item.ndim == 2 and item.shape[1 - axis] == rows else ""
            raise InputError(f"SecondOrderModel: {key}: found an array {item.shape}, expected {expected}{turned}")
    return B, None if C is None else C.T


def _same(B, Ct):
    """Test whether the outputs are the inputs, C = B^T, also without C."""
    return Ct is None or (B is not None and B.shape == Ct.shape and not (Ct != B).sum())


def require_model(model):
    """Raise InputError unless this is a SecondOrderModel that is not closed."""
    declared("model", model, SecondOrderModel)
    model.K  # noqa: B018  (refused here)


def massless(model) -> int:
    """Return the number of dofs without mass on the diagonal of M. Collective."""
    diagonal = model.M.getDiagonal()
    count = int((diagonal.getArray(readonly=True).real == 0).sum())
    diagonal.destroy()
    return model.comm.allreduce(count)


def require_inputs(model):
    """Raise InputError for a model without inputs."""
    if model.B is None or not model.input_names:
        raise InputError(f"{model.name} has no inputs; name them by `inputs` (in Python: with_inputs of the model), as "
                         "dof numbers or [node, direction]")  # fmt: skip


def symmetry_defect(mat: PETSc.Mat) -> float:
    """Estimate ||A - A^T||_F / ||A||_F: for random x with unit variance, E ||(A - A^T) x||^2 is the square."""
    random = PETSc.Random().create(mat.comm)
    random.setFromOptions()
    random.setInterval((-(3**0.5), 3**0.5))
    x, y = mat.createVecs()
    z = y.duplicate()
    defect = 0.0
    for _ in range(2):
        x.setRandom(random)
        mat.mult(x, y)
        mat.multTranspose(x, z)
        y.axpy(-1.0, z)
        defect = max(defect, y.norm())
    for item in (x, y, z, random):
        item.destroy()
    norm = mat.norm(PETSc.NormType.FROBENIUS)
    return float(defect / norm) if norm else 0.0


def listed(names, most=4) -> str:
    """Return names in a line, or the first few of many."""
    shown = ", ".join(names[:most]) + (f", ... ({len(names)})" if len(names) > most else "")
    return shown or "none"
