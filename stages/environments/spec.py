"""Which Gymnasium environment a learner lives in: what an artifact records of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from artifacts import Artifact, ArtifactError
from stages.config.demonstrations import Crop
from stages.config.environments import refuse_unless_trusted
from stages.environments.timing import Timing
from stages.environments.viewpoints import Viewpoint


@dataclass(frozen=True)
class EnvironmentSpec:
    """A Gymnasium environment, and how its frames are taken.

    Attributes:
        name: Gymnasium ID, `MODULE:ID`, or `MODULE:ATTR`, a function that returns an environment.
        kwargs: Keyword arguments of the environment.
        seed: Seed of every `reset`: it selects the learner's context.
        control_steps: Steps per episode; an environment that ends earlier stands still in its last frame until then.
        frames: Number of frames T, spread evenly over the episode.
        size: Height and width of a frame, pixels.
        crop: Part of the rendered image that is reduced to `size`; None: all of it.
        viewpoint: Viewpoint relative to the environment's own camera; None: its own camera.
        success: `MODULE:ATTR`, a function (observation, info) of the last step that returns whether the episode
            succeeds; empty: what the environment itself reports.
    """

    name: str
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0
    control_steps: int = 0
    frames: int = 0
    size: tuple[int, int] = (48, 48)
    crop: Crop | None = None
    viewpoint: Viewpoint | None = None
    success: str = ""

    @property
    def timing(self) -> Timing:
        """Length of an episode, and its frames."""
        return Timing.spread(self.control_steps, self.frames)

    def described(self) -> dict[str, Any]:
        """JSON-ready values, as an artifact records them."""
        return {
            "name": self.name,
            "kwargs": dict(self.kwargs),
            "seed": self.seed,
            "control_steps": self.control_steps,
            "frames": self.frames,
            "size": list(self.size),
            "crop": None if self.crop is None else list(self.crop),
            "viewpoint": None if self.viewpoint is None else list(self.viewpoint),
            "success": self.success,
        }

    @classmethod
    def of(cls, artifact: Artifact) -> EnvironmentSpec | None:
        """The environment that an artifact records; None: it is of a simulated task, or has only an image.

        Raises:
            ArtifactError: The record contradicts itself.
            UsageError: The environment is code that may not be imported.
        """
        spec = cls.recorded(artifact)
        if spec is not None:
            refuse_unless_trusted(spec.name, spec.kwargs)
            if spec.success:
                refuse_unless_trusted(spec.success, {})
        return spec

    @classmethod
    def recorded(cls, artifact: Artifact) -> EnvironmentSpec | None:
        """The same, of which no code may be imported before the user permits it.

        Raises:
            ArtifactError: The record contradicts itself.
        """
        recorded = artifact.config.get("environment")
        if recorded is None:
            return None
        crop, viewpoint = recorded["crop"], recorded["viewpoint"]
        spec = cls(
            recorded["name"],
            recorded["kwargs"],
            recorded["seed"],
            recorded["control_steps"],
            recorded["frames"],
            (recorded["size"][0], recorded["size"][1]),
            None if crop is None else Crop(*crop),
            None if viewpoint is None else Viewpoint(*viewpoint),
            recorded["success"],
        )
        if spec.frames > spec.control_steps + 1:
            raise ArtifactError(
                f"{artifact.path}: its configuration has {spec.frames} frames in {spec.control_steps} steps: make it "
                "again"
            )
        return spec
