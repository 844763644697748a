"""Gymnasium registration: importing this module, or `ifo.envs`, registers `ifo/Reach-v0`, `ifo/PushReal-v0` etc.

`ifo/Task-v0` creates any other task by its `task_name`, for example `dm:reacher-easy`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium

from stages.config.stages import HOUSEHOLD, TASKS

if TYPE_CHECKING:
    from stages.simulation.gym_env import SuiteEnv

IDS = {f"ifo/{name.title().replace('-', '')}-v0": {"task_name": name} for name in (*TASKS, *HOUSEHOLD)}
IDS |= {"ifo/Task-v0": {}}


def make(
    task_name: str,
    contexts: Any = "paper",
    observe: str = "learner",
    pixels: bool = False,
    render_mode: str | None = None,
    render_size: tuple[int, int] = (240, 240),
) -> SuiteEnv:
    """Create a Gymnasium environment of the task.

    Args:
        task_name: The task's name.
        contexts, observe, pixels: As in `stages.simulation.suite.load`.
        render_mode: `rgb_array`, `depth_array` or None.
        render_size: Height and width of the images that `render` returns, pixels.

    Raises:
        PlatformError: Rendering is requested and no OpenGL backend works.
        UsageError: The task, distribution or observer is unknown.
    """
    from stages.simulation.gl import choose_backend

    choose_backend(required=pixels or render_mode is not None)
    from stages.simulation import suite
    from stages.simulation.gym_env import SuiteEnv

    return SuiteEnv(suite.load(task_name, contexts, observe=observe, pixels=pixels), render_mode, render_size)


def register() -> None:
    """Register the ids; ids that are already registered are left unchanged."""
    for name, kwargs in IDS.items():
        if name not in gymnasium.registry:
            gymnasium.register(id=name, entry_point=f"{__name__}:make", kwargs=kwargs)


register()
