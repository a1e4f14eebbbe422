"""What the ingredients of one reduction share: one factor at a time."""

import hpcred as package
from hpcred import Buckens, Rayleigh


def test_one_factor_at_a_time(comm):
    """A mixture of real and complex points frees the factor of the one before the other is made."""
    from hpcred.model.frames import apply_frame
    from hpcred.parallel.progress import Progress
    from hpcred.reduction.run import Run

    with package.linkage(comm) as model:
        framed = apply_frame(model, Buckens(), Rayleigh(2.0, 1e-5))
        context = Run(framed, Progress(comm, show=False), 1e-12)
        solver = context.factored(-1e4, "a point")
        assert solver.factored is not None
        other = context.complex_solver
        other.factor(100j)
        assert solver.factored is None and other.factored is not None
        assert context.factored(-1e4, "a point") is solver and other.factored is None
        context.close()
        framed.close()
