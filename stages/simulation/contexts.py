"""Context distributions: what varies between demonstrations, written as data.

A context omega (Sec. III) is everything that the agent does not control: viewpoint, colours, distractors, where the
goal lies and how the arm starts. A batch of `n` contexts is a dict of arrays with leading axis `n`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

Contexts = dict[str, np.ndarray]

FACTORS = ("azimuth", "colour", "distractors", "goal", "initial")


@dataclass(frozen=True)
class ContextDistribution:
    """Ranges that contexts are drawn from.

    Attributes:
        azimuth: Range of the camera's azimuth, degrees.
        elevation: Range of the camera's elevation, degrees (negative looks down).
        camera_distance: Range of the distance from the camera to the origin, metres.
        vary: Factors that are drawn; the others keep the task's canonical value.
    """

    azimuth: tuple[float, float] = (0.0, 360.0)
    elevation: tuple[float, float] = (-45.0, -45.0)
    camera_distance: tuple[float, float] = (4.0, 4.0)
    vary: frozenset[str] = frozenset(FACTORS)


DISTRIBUTIONS: dict[str, ContextDistribution] = {
    "paper": ContextDistribution(),
    "narrow": replace(ContextDistribution(), azimuth=(-40.0, 40.0)),
    "fixed": replace(ContextDistribution(), azimuth=(0.0, 0.0), vary=frozenset()),
}


def take(contexts: Contexts, index) -> Contexts:
    """Contexts at `index` (an integer list, slice or boolean mask), leading axis kept."""
    return {name: values[index] for name, values in contexts.items()}


def repeat(contexts: Contexts, n: int) -> Contexts:
    """One context (leading axis 1) repeated `n` times."""
    return {name: np.repeat(values, n, axis=0) for name, values in contexts.items()}


def draw_camera(rng: np.random.Generator, n: int, distribution: ContextDistribution) -> Contexts:
    """Draw `n` cameras: azimuth and elevation in degrees, distance in metres."""
    varies = "azimuth" in distribution.vary

    def draw(bounds: tuple[float, float]) -> np.ndarray:
        return rng.uniform(*bounds, n) if varies else np.full(n, 0.5 * (bounds[0] + bounds[1]))

    return {
        "azimuth": draw(distribution.azimuth),
        "elevation": draw(distribution.elevation),
        "camera_distance": draw(distribution.camera_distance),
    }


def draw_colours(rng: np.random.Generator, n: int, *far_from: np.ndarray, gap: float = 0.5) -> np.ndarray:
    """Draw `n` RGB colours at least `gap` (Euclidean, in [0, 1]^3) from each of `far_from`, arrays (3,) or (n, 3)."""
    colours = rng.uniform(0.0, 1.0, (n, 3))
    others = [np.broadcast_to(other, (n, 3)) for other in far_from]
    while True:
        near = np.zeros(n, bool)
        for other in others:
            near |= np.linalg.norm(colours - other, axis=1) < gap
        if not near.any():
            return colours
        colours[near] = rng.uniform(0.0, 1.0, (int(near.sum()), 3))


def camera_pose(contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
    """Position (n, 3) and quaternion (n, 4) of cameras that look at the origin, as MuJoCo's free camera does."""
    azimuth, elevation = np.radians(contexts["azimuth"]), np.radians(contexts["elevation"])
    forward = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=1
    )
    right = np.stack([np.sin(azimuth), -np.cos(azimuth), np.zeros_like(azimuth)], axis=1)
    up = np.cross(right, forward)
    position = -forward * contexts["camera_distance"][:, None]
    return position, _quaternion(np.stack([right, up, -forward], axis=2))


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    """Unit quaternions (n, 4), scalar first, of rotation matrices (n, 3, 3)."""
    from scipy.spatial.transform import Rotation

    xyzw = Rotation.from_matrix(rotation).as_quat()
    return xyzw[:, [3, 0, 1, 2]]
