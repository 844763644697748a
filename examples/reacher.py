"""A scripted demonstrator of Gymnasium's Reacher-v5, for `ifo collect-demos env:Reacher-v5 --demonstrator`."""

import numpy as np

LENGTHS = 0.1, 0.11  # of the two links, meters
STIFFNESS, DAMPING = 0.3, 0.07  # torque per radian, and per radian per second


def reach(observation: np.ndarray) -> np.ndarray:
    """Torques (2,) of a damped spring from the joint angles to those that bring the fingertip to the target.

    Two poses reach each target. The demonstrator always takes the one whose elbow turns left: a translator cannot know
    which of two ways a video would have taken in another context, and shows a mean of both.

    Args:
        observation: Observation (10,) of Reacher-v5: cosines and sines of both angles, the target's position, the
            angular velocities, and the vector from the target to the fingertip.
    """
    angles = np.arctan2(observation[2:4], observation[:2])
    target, velocity = observation[4:6], observation[6:8]
    upper, lower = LENGTHS
    cosine = (target @ target - upper**2 - lower**2) / (2 * upper * lower)
    elbow = np.arccos(np.clip(cosine, -1, 1))
    inner = np.arctan2(lower * np.sin(elbow), upper + lower * np.cos(elbow))
    shoulder = np.arctan2(target[1], target[0]) - inner
    turn = np.array([(shoulder - angles[0] + np.pi) % (2 * np.pi) - np.pi, elbow - angles[1]])
    return np.clip(STIFFNESS * turn - DAMPING * velocity, -1, 1)


def reached(observation: np.ndarray, info: dict) -> bool:
    """Whether the fingertip is within 2 cm of the target, for `--success reacher:reached`."""
    return bool(np.linalg.norm(observation[8:10]) < 0.02)
