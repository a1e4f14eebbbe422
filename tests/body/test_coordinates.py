"""Reduced coordinates over time: instants of a part of it."""

import numpy as np
import pytest

from hpcred import InputError
from hpcred.body.coordinates import Coordinates


@pytest.mark.parametrize("scale", [1.0, 1e-4])
def test_instants_from_one_to_another(scale):
    """With those at the ends, which somebody typed with fewer digits, and no others."""
    t = np.linspace(0.0, 1.0, 2001)
    whole = Coordinates(t=t * scale, q=np.outer(t, [1.0, 2.0]), velocity=np.ones((2001, 2)))
    part = whole.thinned("m.csv", (0.25 + 1e-10) * scale, (0.5 - 1e-10) * scale, 100)
    assert part.t == pytest.approx(np.array([0.25, 0.3, 0.35, 0.4, 0.45, 0.5]) * scale, rel=1e-9)
    assert np.allclose(part.q[:, 1] * scale, 2 * part.t)
    assert len(whole.thinned("m.csv", (0.25 + 1e-8) * scale, 0.5 * scale, 1).t) == 500
    whole = Coordinates(t=t, q=whole.q)
    assert part.velocity.shape == (6, 2) and part.acceleration is None
    assert len(whole.thinned("m.csv", None, 0.0004, 1).t) == 1 and len(whole.thinned("m.csv", 0.9996, None, 1).t) == 1
    with pytest.raises(InputError, match=r"m.csv: no instant from 9.9999e-05 to .* s, found 0 to 1 s"):
        whole.thinned("m.csv", 0.0001, 0.0004, 1)
