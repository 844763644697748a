"""Building blocks of tasks: tables, arms, objects and walls, functions that draw contexts, and fields of the model.

`tests/examples/glide.py` is a complete task made of these.
"""

from __future__ import annotations

from stages.simulation.gl import choose_backend

choose_backend(required=False)  # The imports below load mujoco, which reads MUJOCO_GL at that moment.

from stages.simulation.contexts import (  # noqa: E402
    camera_pose,
    draw_camera,
    draw_colours,
    draw_distractors,
    draw_table_and_arm,
)
from stages.simulation.tasks.fields import ModelFields  # noqa: E402
from stages.simulation.tasks.scene import (  # noqa: E402
    ARM,
    NOTHING,
    OBJECT,
    WALL,
    Arm,
    add_distractors,
    add_goal,
    add_object,
    add_rim,
    add_table,
    add_wall,
    make_scene,
)

__all__ = [
    "ARM",
    "NOTHING",
    "OBJECT",
    "WALL",
    "Arm",
    "ModelFields",
    "add_distractors",
    "add_goal",
    "add_object",
    "add_rim",
    "add_table",
    "add_wall",
    "camera_pose",
    "draw_camera",
    "draw_colours",
    "draw_distractors",
    "draw_table_and_arm",
    "make_scene",
]
