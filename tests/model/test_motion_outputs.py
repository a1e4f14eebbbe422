"""Places of outputs that are motions: a node with its direction, or a dof, and nothing else."""

from itertools import product

import pytest

from hpcred import InputError
from hpcred.model.motion_outputs import MotionOutput, motion_output_of

GIVEN = {"node": 20, "direction": "z", "dof": 7}


@pytest.mark.parametrize("chosen", list(product((False, True), repeat=3)))
def test_every_choice_of_keys(chosen):
    keys = {key: value for (key, value), there in zip(GIVEN.items(), chosen, strict=True) if there}
    if set(keys) in ({"node", "direction"}, {"dof"}):
        output = MotionOutput(**keys, quantity="velocity")
        assert output.target == (7 if "dof" in keys else (20, "z")) and motion_output_of(output.name) == output
        return
    with pytest.raises(InputError, match=f"^outputs: found {', '.join(keys) or 'no place'}, expected a node and its"):
        MotionOutput(**keys)
