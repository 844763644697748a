"""Context distributions: the variation between demonstrations, defined as data.

A context omega (Sec. III) is everything that the agent does not control: viewpoint, colors, distractors, the position
of the goal and the initial pose of the arm. A batch of `n` contexts is a dict of arrays with leading axis `n`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stages.config.names import FACTORS as FACTORS

Contexts = dict[str, np.ndarray]

RED = np.array([1.0, 0.0, 0.0])  # color of the goal
N_DISTRACTORS = 5
DISTRACTOR_RADIUS = 0.11  # meters
DISTRACTOR_PROBABILITY = 0.5  # probability that a distractor is present
DISTRACTOR_REACH = 1.1  # meters from the arm's base, the radius of its workspace


@dataclass(frozen=True)
class ContextDistribution:
    """Ranges from which contexts are drawn.

    Attributes:
        azimuth: Range of the camera's azimuth, degrees.
        elevation: Range of the camera's elevation if it varies, degrees (negative looks down).
        distance: Range of the camera's distance to the origin if it varies, as a multiple of the task's distance.
        vary: Factors to draw; the others keep the task's canonical value. None for the task's default factors.
    """

    azimuth: tuple[float, float] = (0.0, 360.0)
    elevation: tuple[float, float] = (-60.0, -35.0)
    distance: tuple[float, float] = (0.9, 1.2)
    vary: frozenset[str] | None = None


DISTRIBUTIONS: dict[str, ContextDistribution] = {
    "paper": ContextDistribution(),
    "narrow": replace(ContextDistribution(), azimuth=(-40.0, 40.0)),
    "fixed": replace(ContextDistribution(), azimuth=(0.0, 0.0), vary=frozenset()),
}


def take(contexts: Contexts, index) -> Contexts:
    """Select contexts by `index` (an integer list, slice or boolean mask), keeping the leading axis."""
    return {name: values[index] for name, values in contexts.items()}


def repeat(contexts: Contexts, n: int) -> Contexts:
    """Repeat one context (leading axis 1) `n` times."""
    return {name: np.repeat(values, n, axis=0) for name, values in contexts.items()}


def draw_camera(
    rng: np.random.Generator,
    n: int,
    distribution: ContextDistribution,
    vary: frozenset[str],
    elevation: float = -45.0,
    distance: float = 4.0,
) -> Contexts:
    """Draw `n` cameras: azimuth and elevation in degrees, distance in meters.

    Args:
        vary: Factors to draw.
        elevation: Elevation if it does not vary, degrees.
        distance: The task's camera distance, meters.
    """

    # Draw all three whether they vary or not, so that one value does not depend on whether another varies.
    azimuth = rng.uniform(*distribution.azimuth, n)
    elevations = rng.uniform(*distribution.elevation, n)
    distances = distance * rng.uniform(*distribution.distance, n)
    return {
        "azimuth": azimuth if "azimuth" in vary else np.zeros(n),
        "elevation": elevations if "elevation" in vary else np.full(n, elevation),
        "camera_distance": distances if "distance" in vary else np.full(n, distance),
    }


def draw_colours(rng: np.random.Generator, n: int, *far_from: np.ndarray, gap: float = 0.5) -> np.ndarray:
    """Draw `n` RGB colors at least `gap` (Euclidean, in [0, 1]^3) away from each of `far_from`, (3,) or (n, 3)."""
    colours = rng.uniform(0.0, 1.0, (n, 3))
    others = [np.broadcast_to(other, (n, 3)) for other in far_from]
    while True:
        near = np.zeros(n, bool)
        for other in others:
            near |= np.linalg.norm(colours - other, axis=1) < gap
        if not near.any():
            return colours
        colours[near] = rng.uniform(0.0, 1.0, (int(near.sum()), 3))


def draw_table_and_arm(
    rng: np.random.Generator,
    n: int,
    canonical: tuple[np.ndarray, np.ndarray],
    *others: np.ndarray,
    varies: bool,
    gap: float = 0.4,
) -> Contexts:
    """Draw colors of table and arm: `table_rgb` and `arm_rgb`, (n, 3).

    Args:
        canonical: Both colors (3,) if they do not vary.
        others: Colors (3,) in the scene that both must differ from.
        varies: Whether the colors vary.
        gap: Minimum distance of the arm's color from `others` and from the table's color.
    """
    if not varies:
        return {"table_rgb": np.tile(canonical[0], (n, 1)), "arm_rgb": np.tile(canonical[1], (n, 1))}
    table = draw_colours(rng, n, *others)
    return {"table_rgb": table, "arm_rgb": draw_colours(rng, n, *others, table, gap=gap)}


def draw_distractors(
    rng: np.random.Generator,
    clear_of: np.ndarray,
    clearance: float,
    table_rgb: np.ndarray,
    *others: np.ndarray,
    visible: bool,
) -> Contexts:
    """Draw distractor discs inside the workspace of an arm with its base at the origin.

    Args:
        clear_of: Points (n, m, 2) from which a disc's center stays `clearance` meters away.
        clearance: Minimum distance from these points, meters.
        table_rgb: Colors (n, 3) of the tables, from which the discs' colors differ.
        others: Further colors (3,) from which the discs' colors differ.
        visible: Whether distractors may be visible.

    Returns:
        `distractor_position` (n, 5, 2) in meters, `distractor_rgb` (n, 5, 3) and `distractor_visible` (n, 5).
    """
    n = len(clear_of)
    centres = np.repeat(clear_of, N_DISTRACTORS, axis=0)

    def draw(m: int) -> np.ndarray:
        radius = DISTRACTOR_REACH * np.sqrt(rng.uniform(0.04, 1.0, m))
        angle = rng.uniform(0, 2 * np.pi, m)
        return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)

    positions = draw(n * N_DISTRACTORS)
    while (near := (np.linalg.norm(positions[:, None] - centres, axis=2) < clearance).any(axis=1)).any():
        positions[near] = draw(int(near.sum()))
    table = np.repeat(np.broadcast_to(table_rgb, (n, 3)), N_DISTRACTORS, axis=0)
    colours = draw_colours(rng, n * N_DISTRACTORS, *others, table, gap=0.4)
    there = rng.random((n, N_DISTRACTORS)) < DISTRACTOR_PROBABILITY
    return {
        "distractor_position": positions.reshape(n, N_DISTRACTORS, 2),
        "distractor_rgb": colours.reshape(n, N_DISTRACTORS, 3),
        "distractor_visible": there & visible,
    }


def camera_pose(contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
    """Position (n, 3) and quaternion (n, 4) of cameras that look at the origin, like MuJoCo's free camera."""
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
