"""Context distributions: what varies between demonstrations, written as data.

A context omega (Sec. III) is everything that the agent does not control: viewpoint, colours, distractors, where the
goal lies and how the arm starts. A batch of `n` contexts is a dict of arrays with leading axis `n`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stages.config.names import FACTORS as FACTORS

Contexts = dict[str, np.ndarray]

RED = np.array([1.0, 0.0, 0.0])  # the goal's colour
N_DISTRACTORS = 5
DISTRACTOR_RADIUS = 0.11  # metres
DISTRACTOR_PROBABILITY = 0.5  # of each being there
DISTRACTOR_REACH = 1.1  # metres from the arm's base: the arm's workspace


@dataclass(frozen=True)
class ContextDistribution:
    """Ranges that contexts are drawn from.

    Attributes:
        azimuth: Range of the camera's azimuth, degrees.
        elevation: Range of the camera's elevation where it varies, degrees (negative looks down).
        distance: Range of the camera's distance to the origin where it varies, as a multiple of the task's own.
        vary: Factors that are drawn, the others keep the task's canonical value; None: what the task varies by default.
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
    """Contexts at `index` (an integer list, slice or boolean mask), leading axis kept."""
    return {name: values[index] for name, values in contexts.items()}


def repeat(contexts: Contexts, n: int) -> Contexts:
    """One context (leading axis 1) repeated `n` times."""
    return {name: np.repeat(values, n, axis=0) for name, values in contexts.items()}


def draw_camera(
    rng: np.random.Generator,
    n: int,
    distribution: ContextDistribution,
    vary: frozenset[str],
    elevation: float = -45.0,
    distance: float = 4.0,
) -> Contexts:
    """Draw `n` cameras: azimuth and elevation in degrees, distance in metres.

    Args:
        vary: Factors that are drawn.
        elevation: Elevation where it does not vary, degrees.
        distance: The task's own distance, metres.
    """

    # All three are drawn, whether they vary or not: what one shows does not hang on whether another varies.
    azimuth = rng.uniform(*distribution.azimuth, n)
    elevations = rng.uniform(*distribution.elevation, n)
    distances = distance * rng.uniform(*distribution.distance, n)
    return {
        "azimuth": azimuth if "azimuth" in vary else np.zeros(n),
        "elevation": elevations if "elevation" in vary else np.full(n, elevation),
        "camera_distance": distances if "distance" in vary else np.full(n, distance),
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


def draw_table_and_arm(
    rng: np.random.Generator,
    n: int,
    canonical: tuple[np.ndarray, np.ndarray],
    *others: np.ndarray,
    varies: bool,
    gap: float = 0.4,
) -> Contexts:
    """Colours of table and arm: `table_rgb` and `arm_rgb`, (n, 3).

    Args:
        canonical: Both colours (3,) where they do not vary.
        others: Colours (3,) of the scene that both keep away from; the arm, by `gap`, from the table, too.
        varies: Whether they are drawn.
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
    """Draw discs inside the workspace of an arm that stands at the origin.

    Args:
        clear_of: Points (n, m, 2) that a disc's centre keeps `clearance` metres from.
        table_rgb: Colours (n, 3) of the tables, that the discs' own differ from.
        others: Further colours (3,) that they differ from.
        visible: Whether there are any.

    Returns:
        `distractor_position` (n, 5, 2) in metres, `distractor_rgb` (n, 5, 3) and `distractor_visible` (n, 5).
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
