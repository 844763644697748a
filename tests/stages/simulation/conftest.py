"""A task, and contexts of it."""

from __future__ import annotations

import numpy as np
import pytest

from stages.simulation.tasks import distribution, make_task


@pytest.fixture(scope="session", params=["reach"])
def task(request):
    return make_task(request.param)


@pytest.fixture
def draw(task):
    """A function (distribution's name, n, seed) -> contexts."""
    return lambda name, n=1, seed=0: task.draw_contexts(np.random.default_rng(seed), n, distribution(name))
