"""MjModel fields that render contexts: cameras, colors and positions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stages.simulation.contexts import Contexts, camera_pose

if TYPE_CHECKING:
    import mujoco


class ModelFields:
    """Builder of one model's fields for n contexts, name -> (n, *shape of the field). The cameras are set first."""

    def __init__(self, model: mujoco.MjModel, contexts: Contexts, camera: str = "context"):
        self._model = model
        position, quaternion = camera_pose(contexts)
        n = len(position)
        self._rgba = np.repeat(model.geom_rgba[None], n, axis=0)
        self._position = np.repeat(model.geom_pos[None], n, axis=0)
        cameras = np.repeat(model.cam_pos[None], n, axis=0), np.repeat(model.cam_quat[None], n, axis=0)
        index = model.camera(camera).id
        cameras[0][:, index], cameras[1][:, index] = position, quaternion
        self._cameras = cameras

    def colour(self, rgb: np.ndarray, *geoms: str) -> ModelFields:
        """Set the colors (n, 3) of geoms."""
        for name in geoms:
            self._rgba[:, self._model.geom(name).id, :3] = rgb
        return self

    def place(self, geom: str, xy: np.ndarray) -> ModelFields:
        """Set the position (n, 2) of a geom in its parent's plane, meters."""
        self._position[:, self._model.geom(geom).id, :2] = xy
        return self

    def distractors(self, contexts: Contexts) -> ModelFields:
        """Set position, color and visibility of the discs that `draw_distractors` drew."""
        for k in range(contexts["distractor_visible"].shape[1]):
            name = f"distractor_{k}"
            self.place(name, contexts["distractor_position"][:, k]).colour(contexts["distractor_rgb"][:, k], name)
            self._rgba[:, self._model.geom(name).id, 3] = contexts["distractor_visible"][:, k]
        return self

    def done(self) -> dict[str, np.ndarray]:
        """Return the fields."""
        return {
            "cam_pos": self._cameras[0],
            "cam_quat": self._cameras[1],
            "geom_pos": self._position,
            "geom_rgba": self._rgba,
        }
