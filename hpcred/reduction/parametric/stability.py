"""Warn of values of parameters at which a reduced model is unstable."""

from __future__ import annotations

from ...parallel.decisions import decided
from ...parallel.failures import InputError
from ..result.parameter_accuracy import in_words
from .training import corner_points

CORNERS = 32  # looked at, if there are not more


def warnings_of_stability(reduced, comm) -> tuple[str, ...]:
    """Return a sentence on the first value with poles in the right half-plane, of the reference, those at which the
    model was factored, and the corners of the ranges. Collective."""
    accuracy = reduced.record.accuracy
    visited = [point.values for point in accuracy.parameters.points] if accuracy is not None else []
    corners = [dict(zip(reduced.reference, point, strict=True)) for point in corner_points(reduced.parameters, CORNERS)]

    def first():
        for values in (reduced.reference, *visited, *corners):
            try:
                count = len(reduced.at(**values).unstable_poles())
            except InputError:  # no mass, which is refused where that value is asked for
                continue
            if count:
                return (
                    f"the reduced model is unstable at {in_words(values)}: {count} pole{'s' * (count > 1)} in the "
                    "right half-plane, so that motion grows in time; a Campbell diagram tells from where on",
                )
        return ()

    return decided(comm, first)
