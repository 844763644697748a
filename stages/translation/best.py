"""The best weights of a training run: with few videos, held-out errors rise again long before the last step."""

from __future__ import annotations

import copy
import math
from typing import Any

from torch import Tensor, nn

from stages.runtime.trees import from_tree, to_tree


class BestWeights:
    """A copy of a model's weights at the evaluation with the lowest error so far.

    Attributes:
        error: That error; infinite before the first evaluation.
        step: The step of that evaluation.
    """

    def __init__(self) -> None:
        self.error, self.step = math.inf, 0
        self._weights: dict[str, Tensor] | None = None

    def see(self, step: int, error: float, model: nn.Module) -> None:
        """Copy the weights of a model if its error is the lowest so far."""
        if error < self.error:
            self.error, self.step = error, step
            self._weights = {name: value.detach().clone() for name, value in model.state_dict().items()}

    def load(self, model: nn.Module) -> None:
        """Load the best weights into a model; without an evaluation, the model stays as it is."""
        if self._weights is not None:
            model.load_state_dict(self._weights)

    def state(self) -> dict[str, Any]:
        """The state as a tree of arrays and numbers; empty before the first evaluation."""
        if self._weights is None:
            return {}
        return {"error": self.error, "step": self.step, "weights": to_tree(self._weights)}

    def restore(self, state: dict[str, Any], model: nn.Module) -> None:
        """Restore a state of a model of the same architecture.

        Raises:
            KeyError, RuntimeError, TypeError, ValueError: It is no such state.
        """
        if not state:
            return
        copy.deepcopy(model).load_state_dict(from_tree(state["weights"]))  # Raises an error if they do not fit.
        self.error, self.step = float(state["error"]), int(state["step"])
        device = next(model.parameters()).device
        self._weights = {name: value.to(device) for name, value in from_tree(state["weights"]).items()}
