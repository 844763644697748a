"""The tasks as dm_control environments, in the style of dm_control's suite.

from ifo import suite

env = suite.load("reach", contexts="paper", seed=0)
time_step = env.reset()
frame = suite.frame(env.physics, env.task.task)
"""

from __future__ import annotations

from stages.simulation.gl import choose_backend

choose_backend(required=False)  # The import below loads mujoco, which reads MUJOCO_GL at that moment.

from stages.simulation.suite import Environment, Physics, SuiteTask, frame, load  # noqa: E402

__all__ = ["Environment", "Physics", "SuiteTask", "frame", "load"]
