"""Make the superelement that other programs take of a reduced model in interface coordinates."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from ..body.body import require_no_laws
from ..model.interfaces.motion import rigid_rows
from ..model.interfaces.nodes import InterfaceNode
from ..parallel.failures import InputError
from ..reduction.result.reduced_model import ReducedModel, require_finite

SYMMETRIC_ELEMENT = 1e-8  # relative to the largest entry
FREE = 1e-3  # of the first elastic frequency, below which those of rigid-body motions count as zero without a record
LARGEST_NODE = 99_999_999  # of the eight columns that Nastran has for it


@dataclass(frozen=True)
class Superelement:
    """K, M (m, m) and D, None without viscous damping, exactly symmetric; `loss_factor` eta of structural damping.

    The first rows are x, y, z, rx, ry, rz of each node of `interfaces`, the others modal coordinates. `remarks`: what
    no format of superelements holds. `loads` (m, l): the columns of B, by `load_names`, that are no direction of an
    interface node. `is_free`: whether K resists none of the six rigid-body motions, as the reduction found (see
    model.support).
    """

    K: np.ndarray
    M: np.ndarray
    D: np.ndarray | None
    loss_factor: float
    interfaces: tuple[InterfaceNode, ...]
    remarks: tuple[str, ...]
    loads: np.ndarray
    load_names: tuple[str, ...] = ()
    is_free: bool = False

    @property
    def size(self) -> int:
        return len(self.K)

    @property
    def modal_count(self) -> int:
        """The number of modal coordinates."""
        return self.size - 6 * len(self.interfaces)

    @property
    def centre(self) -> np.ndarray:
        """The mean position (3,) of the interface nodes, where modal coordinates may be drawn."""
        return np.mean([node.position for node in self.interfaces], axis=0)

    def labels(self, directions: int) -> np.ndarray:
        """Node and direction, from 1, of each row (m, 2).

        Modal coordinates are directions 1 to `directions` of further nodes, numbered from the largest one on.
        """
        nodes = [node.node for node in self.interfaces]
        first, k = max(nodes) + 1, np.arange(self.modal_count)
        if first + self.modal_count > LARGEST_NODE:
            raise InputError(f"interface: found the node number {max(nodes)}, expected at most 8 digits with the modal "
                             "coordinates behind it; give node = .. in [[interface]], and reduce again")  # fmt: skip
        own = np.stack([np.repeat(nodes, 6), np.tile(np.arange(1, 7), len(nodes))], axis=1)
        return np.concatenate([own, np.stack([first + k // directions, 1 + k % directions], axis=1)])

    def remark_on_modal_points(self, points) -> list[str]:
        """The remark on the numbers of points that carry modal coordinates."""
        text = "modal coordinates: points {} to {}; the model that takes the file may not use these numbers for others"
        return [text.format(points[0], points[-1])] if len(points) else []


def check_mass(element: Superelement):
    """Refuse an M that is not positive definite, for programs that divide by it."""
    if np.linalg.eigvalsh(element.M)[0] <= 0:
        raise InputError("found a matrix M that is not positive definite, expected a mass for every coordinate")


def fitted(value: float, width: int, letter: str) -> str:
    """A number in at most `width` characters, with as many digits as fit beside the shortest exponent."""
    for digits in range(min(width - 4, 16), 0, -1):
        mantissa, exponent = f"{value:.{digits}e}".split("e")
        text = f"{mantissa}{letter}{int(exponent)}"
        if len(text) <= width:
            return text
    raise ValueError(f"{value} has no room in {width} columns")


def superelement(reduced: ReducedModel) -> Superelement:
    """The superelement of a reduced model. Raises InputError for other coordinates and for unsymmetric matrices."""
    if not reduced.interfaces:
        raise InputError(
            'found pseudo-modal coordinates, expected those of interface nodes; write coordinates = "interface" and '
            "a table [[interface]] for each bearing into the job, and reduce again"
        )
    require_no_laws(reduced, "a superelement")
    require_finite(reduced)
    # the K of a free body with one interface and no modes is round-off: below 1 rad/s nothing is asked of it
    floors = {"K": np.abs(reduced.M).max(), "M": 0.0, "D": 0.0}
    K, M, D = (_symmetric(key, getattr(reduced, key), floor) for key, floor in floors.items())
    lost = _other(reduced, reduced.B)
    return Superelement(
        K, M, D if D.any() else None, float(reduced.loss_factor), reduced.interfaces, tuple(_lost(reduced)),
        reduced.B[:, lost], tuple(np.array(reduced.input_names)[lost].tolist()),
        _is_free(reduced, K, M),
    )  # fmt: skip


def _is_free(reduced, K, M) -> bool:
    """Test whether the reduction left six rigid-body motions free. Of a model that has no record, by their Rayleigh
    quotients beside the first elastic one: K of a single node has nothing to compare with, and stays as it is."""
    if reduced.record is not None:
        return reduced.rigid_size == 6
    if len(K) == 6 or np.linalg.eigvalsh(M)[0] <= 0:
        return False
    moved, centre = 6 * len(reduced.interfaces), reduced.interfaces[0].position
    places = np.repeat([np.subtract(node.position, centre) for node in reduced.interfaces], 6, axis=0)
    R = rigid_rows(np.tile(np.arange(6), len(reduced.interfaces)), places)
    rigid = eigh(R.T @ K[:moved, :moved] @ R, R.T @ M[:moved, :moved] @ R, eigvals_only=True)
    return bool(np.abs(rigid).max() < FREE**2 * eigh(K, M, eigvals_only=True)[6])


def _symmetric(key, matrix, floor):
    if np.abs(matrix - matrix.T).max() > max(SYMMETRIC_ELEMENT * np.abs(matrix).max(), floor):
        raise InputError(
            f"found a matrix {key} that is not symmetric, expected a symmetric one; no superelement holds gyroscopic "
            "terms, or forces that turn with a shaft: reduce without them, or take the arrays by format 'npz'"
        )
    return (matrix + matrix.T) / 2


def _other(reduced, columns) -> np.ndarray:
    """Test which columns (m, p), of inputs or outputs, are no direction of an interface node."""
    place = np.abs(columns[: 6 * len(reduced.interfaces)]).argmax(axis=0)
    return np.abs(columns - np.eye(len(columns))[:, place]).max(axis=0, initial=0.0) > SYMMETRIC_ELEMENT


def _lost(reduced):
    """Remarks on inputs and outputs that are no direction of an interface node."""
    inputs, outputs = _other(reduced, reduced.B), _other(reduced, reduced.C.T) | ~reduced.displaces
    for kind, names, other in (("inputs", reduced.input_names, inputs), ("outputs", reduced.output_names, outputs)):
        lost = np.array(names)[other]
        if len(lost):
            yield f"{kind} that are no direction of an interface node are left out: {', '.join(lost)}"
