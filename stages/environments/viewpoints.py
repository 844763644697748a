"""Moves the camera of a Gymnasium environment with MuJoCo underneath around what it looks at."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import gymnasium
import numpy as np

FIXED, TRACKING = 2, 1  # MuJoCo's mjtCamera
REFERENCE = 0  # seed of the state in which the environment's own camera is found


class Viewpoint(NamedTuple):
    """A viewpoint relative to the environment's own camera.

    Attributes:
        azimuth: Rotation around the vertical axis, degrees.
        elevation: Change of the elevation, degrees; negative: from higher up.
        distance: Factor of the distance from what the camera looks at.
    """

    azimuth: float = 0.0
    elevation: float = 0.0
    distance: float = 1.0


class Pose(NamedTuple):
    """Pose of a free camera: angles in degrees, distance and the point that it looks at in meters."""

    at: np.ndarray
    distance: float
    azimuth: float
    elevation: float

    def seen_from(self, viewpoint: Viewpoint) -> Pose:
        """The pose of a viewpoint relative to this one."""
        return Pose(
            self.at,
            self.distance * viewpoint.distance,
            self.azimuth + viewpoint.azimuth,
            float(np.clip(self.elevation + viewpoint.elevation, -89, 89)),
        )


class Viewed(gymnasium.Wrapper):
    """Shows an environment from another viewpoint. MuJoCo may be underneath in Gymnasium's way or in dm_control's."""

    def __init__(self, env: gymnasium.Env, viewpoint: Viewpoint | None = None, size: tuple[int, int] | None = None):
        """Look from `viewpoint`.

        Args:
            env: The environment.
            viewpoint: The viewpoint; None: that of the environment's own camera.
            size: Height and width of the images of environments of dm_control, pixels; None: the environment's own.
        """
        super().__init__(env)
        self._viewpoint, self._size = viewpoint, size
        self._own: Pose | None = None

    @property
    def can_move(self) -> bool:
        """Whether the environment has a camera that can be moved."""
        return hasattr(self.env.unwrapped, "mujoco_renderer") or physics_of(self.env) is not None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        if self._viewpoint is not None and self._own is None and hasattr(self.env.unwrapped, "mujoco_renderer"):
            # Where Gymnasium's own camera looks depends on the state in which it is first used.
            self.env.reset(seed=REFERENCE)
            self._find_own_camera()
        return self.env.reset(seed=seed, options=options)

    def look_from(self, viewpoint: Viewpoint) -> None:
        """Change the viewpoint, from the next image on."""
        self._viewpoint = viewpoint
        if self._own is not None and physics_of(self.env) is None:
            self._move_viewer(self._own.seen_from(viewpoint))

    def render(self) -> Any:
        physics = physics_of(self.env)
        if physics is not None and (self._viewpoint is not None or self._size is not None):
            return self._render_physics(physics)
        return self.env.render()

    def _find_own_camera(self) -> None:
        self.env.render()  # Makes the viewer, which holds the camera.
        renderer: Any = self.env.unwrapped.mujoco_renderer  # type: ignore[attr-defined]
        camera, index = renderer.viewer.cam, renderer.camera_id
        if index is None or index < 0:
            self._own = Pose(np.array(camera.lookat), camera.distance, camera.azimuth, camera.elevation)
        else:
            self._own = _as_free_camera(renderer.model, renderer.data, index)
        self._move_viewer(self._own.seen_from(self._viewpoint or Viewpoint()))

    def _move_viewer(self, pose: Pose) -> None:
        renderer: Any = self.env.unwrapped.mujoco_renderer  # type: ignore[attr-defined]
        camera = renderer.viewer.cam
        if camera.type == FIXED:
            renderer.camera_id = -1  # A free camera, whose pose is set here.
        elif camera.type == TRACKING:
            renderer.camera_id = None  # Keeps following its body.
        camera.azimuth, camera.elevation, camera.distance = pose.azimuth, pose.elevation, pose.distance
        camera.lookat[:] = pose.at

    def _render_physics(self, physics: Any) -> np.ndarray:
        from dm_control.mujoco.engine import MovableCamera

        make_plain(physics.model)  # Composer compiles another model for every episode.
        given: dict[str, Any] = getattr(self.env.unwrapped, "render_kwargs", {})
        height, width = self._size or (given.get("height", 240), given.get("width", 320))
        camera = MovableCamera(physics, height, width)
        index = given.get("camera_id", -1)
        if isinstance(index, str):
            index = physics.model.name2id(index, "camera")
        own = _as_free_camera(physics.model, physics.data, index) if index >= 0 else Pose(*camera.get_pose())
        pose = own.seen_from(self._viewpoint or Viewpoint())
        camera.set_pose(pose.at, pose.distance, pose.azimuth, pose.elevation)
        return camera.render().copy()


def physics_of(env: gymnasium.Env) -> Any:
    """The physics of an environment of dm_control (through Shimmy); None: it has none."""
    physics = getattr(getattr(env.unwrapped, "_env", None), "physics", None)
    return physics if hasattr(physics, "render") else None


def make_plain(model: Any) -> None:
    """Render a model without multisampling, shadows and reflections; only before its first image."""
    model.vis.quality.offsamples = 0
    model.vis.quality.shadowsize = 0
    model.mat_reflectance[:] = 0


def _as_free_camera(model: Any, data: Any, index: int) -> Pose:
    """The pose of a free camera that sees what a camera of the model sees; also takes over its field of view."""
    position, ahead = np.array(data.cam_xpos[index]), -np.array(data.cam_xmat[index]).reshape(3, 3)[:, 2]
    distance = max(float((np.array(model.stat.center) - position) @ ahead), 0.1 * float(model.stat.extent))
    model.vis.global_.fovy = model.cam_fovy[index]
    azimuth, elevation = math.atan2(ahead[1], ahead[0]), math.asin(float(np.clip(ahead[2], -1, 1)))
    return Pose(position + distance * ahead, distance, math.degrees(azimuth), math.degrees(elevation))
