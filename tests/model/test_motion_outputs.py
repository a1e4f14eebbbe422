"""Places of outputs that are motions: a node with its direction, or a dof, and nothing else."""

from itertools import product

import numpy as np
import pytest

from hpcred import InputError
from hpcred.model.outputs.motions import MotionOutput, motion_output_of
from hpcred.model.outputs.rates import Rates

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


def test_directions_and_numbers():
    """All directions of a node, those of a name, and what no node and no dof is."""
    assert MotionOutput(node=20, direction="all").target == (20, "all")
    assert MotionOutput(node="tip", direction="rz", quantity="acceleration").name == "acceleration tip:rz"
    for keys, says in (({"node": 20, "direction": "w"}, "outputs.direction: found the direction 'w'"),
                       ({"node": 0, "direction": "x"}, "outputs.node: found 0"),
                       ({"dof": 0}, "outputs.dof: found 0")):  # fmt: skip
        with pytest.raises(InputError, match=says):
            MotionOutput(**keys)
    assert motion_output_of("20:z") is None and motion_output_of("velocity of light") is None
    assert motion_output_of("velocity dof 7") == MotionOutput(dof=7, quantity="velocity")


def test_outputs_are_counted_and_not_columns():
    """Two outputs of five columns, or the columns themselves."""
    assert (Rates(np.ones((3, 2, 5))).count(5), Rates().count(5)) == (2, 5)
