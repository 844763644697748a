"""The paper's tasks, and contexts of them."""

from __future__ import annotations

import numpy as np
import pytest

from stages.config.stages import TASKS
from stages.simulation.registry import distribution, make_task


@pytest.fixture(scope="session", params=(*TASKS, "push-real", "ladle-almonds"))
def task(request):
    """Each of the paper's tasks and two of the household's; a module about some overrides this."""
    return make_task(request.param)


@pytest.fixture
def draw(task):
    """A function (distribution's name, n, seed, factors that vary) -> contexts."""
    return lambda name, n=1, seed=0, vary="": task.draw_contexts(
        np.random.default_rng(seed), n, distribution(name, vary)
    )
