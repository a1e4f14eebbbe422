"""What the components of one reduction share: one factor at a time."""

import hpcred as package
from hpcred import Buckens, Rayleigh


def test_one_factor_at_a_time(comm):
    """A mixture of real and complex points frees the factor of the one before the other is made."""
    from hpcred.model.frames import apply_frame
    from hpcred.parallel.progress import Progress
    from hpcred.reduction.run.run import Run

    with package.linkage(comm) as model:
        framed = apply_frame(model, Buckens(), Rayleigh(2.0, 1e-5))
        context = Run(framed, Progress(comm, show=False), 1e-12)
        solver = context.solvers.factored(-1e4, "a point")
        assert solver.factored is not None
        other = context.solvers.complex()
        other.factor(-1e4, 100j)
        assert solver.factored is None and other.factored is not None
        assert context.solvers.factored(-1e4, "a point") is solver and other.factored is None
        context.close()


def test_the_square_of_a_frequency_has_one_key_whatever_the_sign_of_its_zero():
    """s^2 of s = i omega has +0 or -0 beside it, as it is computed; the store knows one point."""
    from hpcred.model.frames import apply_frame
    from hpcred.parallel.progress import Progress
    from hpcred.reduction.components.krylov import ComplexPencilSequence
    from hpcred.reduction.run.run import Run

    with package.solid((2, 2, 2)) as model:
        framed = apply_frame(model, None, None)
        run = Run(framed, Progress(model.comm, show=False), 1e-12)
        keys = []
        for square in (complex(-1e4, 0.0), complex(-1e4, -0.0), complex(-1e4, 1.0)):
            sequence = ComplexPencilSequence(run, square, "a point")
            keys.append(str(sequence._key))
        run.close()
    assert keys[0] == keys[1] != keys[2]
