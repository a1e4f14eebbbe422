"""Define the base class of all methods of reduction."""

from abc import ABC, abstractmethod

from ..model.second_order_model import SecondOrderModel
from .result.reduced_model import ReducedModel


class Reductor(ABC):
    """A way to reduce a model, with its settings; derive from it to add another (see IRKA).

    `hpcred.reduce` itself projects onto the span of components or reduces to a tolerance.
    """

    @abstractmethod
    def reduce(self, model: SecondOrderModel) -> ReducedModel:
        """Reduce a `model` with its inputs. Collective. Raises InputError or ComputationError, the same on all ranks.
        """
