"""Write a Superelement as a .mat file for the block "Reduced Order Flexible Solid" of Simscape Multibody.

K, M, D (m, m) in the order of the block: Tx Ty Tz Rx Ry Rz of each interface frame, then modal coordinates; `origins`
(k, 3) of the frames in m, `orientations` (k, 4) their quaternions, which do not turn, and `frames` their names; `loads`
(m, l) and `load_names` of the inputs that are no direction of a frame, which the block does not know.
"""

import io

import numpy as np
from scipy.io import savemat

from ..body.body import check_viscous
from ..files.outputs import MATLAB
from ..parallel.failures import InputError
from .base import SuperelementWriter
from .superelement import check_mass


class FlexibleSolid(SuperelementWriter):
    """Solids of Simscape Multibody."""

    suffix, kind, si = "_simscape.mat", MATLAB, True

    def make(self, element, stem):
        check_viscous(element, "a solid of Simscape")
        check_mass(element)
        if not element.is_free:
            raise InputError(
                "found a body that is held (K resists rigid-body motions), expected a free one with six zero "
                "eigenvalues, which Simscape moves by itself; reduce the model without supports and hold the frames "
                "by joints there"
            )
        count = len(element.interfaces)
        content = io.BytesIO()
        savemat(content, {
            "K": element.K,
            "M": element.M,
            "D": np.zeros_like(element.K) if element.D is None else element.D,
            "origins": np.array([node.position for node in element.interfaces], dtype=float),
            "orientations": np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
            "frames": np.array([node.name for node in element.interfaces], dtype=object),
            "loads": element.loads,
            "load_names": np.array(element.load_names, dtype=object),
        }, oned_as="column")  # fmt: skip
        loads = ", ".join(element.load_names)
        instead = [f"`loads` in the file has the forces of {loads} on frames and modal coordinates"] if loads else []
        return content.getvalue(), {}, [*element.remarks, *instead]
