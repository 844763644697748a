"""Moves the camera of a Gymnasium environment with MuJoCo underneath around what it looks at."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import gymnasium
import numpy as np

FIXED, TRACKING = 2, 1  # MuJoCo's mjtCamera


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


class Viewed(gymnasium.Wrapper):
    """Shows an environment from another viewpoint."""

    def __init__(self, env: gymnasium.Env, viewpoint: Viewpoint | None = None):
        """Look from `viewpoint`; None: from where the environment's own camera is."""
        super().__init__(env)
        self._viewpoint = viewpoint
        self._own: dict[str, Any] | None = None

    @property
    def can_move(self) -> bool:
        """Whether the environment has a camera that can be moved."""
        return getattr(self.env.unwrapped, "mujoco_renderer", None) is not None

    def look_from(self, viewpoint: Viewpoint) -> None:
        """Change the viewpoint, from the next image on."""
        self._viewpoint = viewpoint
        if self._own is not None:
            self._move(viewpoint)

    def render(self) -> Any:
        if self._viewpoint is not None and self._own is None and self.can_move:
            self.env.render()  # Makes the viewer, which holds the camera.
            self._own = self._camera()
            self._move(self._viewpoint)
        return self.env.render()

    def _camera(self) -> dict[str, Any]:
        """Pose of the environment's own camera: azimuth, elevation, distance and what it looks at."""
        inner: Any = self.env.unwrapped
        renderer, model, data = inner.mujoco_renderer, inner.model, inner.data
        camera, index = renderer.viewer.cam, renderer.camera_id
        if index is None or index < 0:
            place = np.array(camera.lookat)
            return {"azimuth": camera.azimuth, "elevation": camera.elevation, "distance": camera.distance, "at": place}
        position, ahead = np.array(data.cam_xpos[index]), -np.array(data.cam_xmat[index]).reshape(3, 3)[:, 2]
        distance = max(float((np.array(model.stat.center) - position) @ ahead), 0.1 * float(model.stat.extent))
        model.vis.global_.fovy = model.cam_fovy[index]
        return {
            "azimuth": math.degrees(math.atan2(ahead[1], ahead[0])),
            "elevation": math.degrees(math.asin(np.clip(ahead[2], -1, 1))),
            "distance": distance,
            "at": position + distance * ahead,
        }

    def _move(self, viewpoint: Viewpoint) -> None:
        assert self._own is not None
        renderer: Any = self.env.unwrapped.mujoco_renderer  # type: ignore[attr-defined]
        camera = renderer.viewer.cam
        if camera.type == FIXED:
            renderer.camera_id = -1  # A free camera, whose pose is set here.
        elif camera.type == TRACKING:
            renderer.camera_id = None  # Keeps following its body.
        camera.azimuth = self._own["azimuth"] + viewpoint.azimuth
        camera.elevation = float(np.clip(self._own["elevation"] + viewpoint.elevation, -89, 89))
        camera.distance = self._own["distance"] * viewpoint.distance
        camera.lookat[:] = self._own["at"]
