"""A scripted demonstrator of Gymnasium's Reacher-v5, for `ifo collect-demos env:Reacher-v5 --demonstrator`."""

import numpy as np

LENGTHS = 0.1, 0.11  # of the two links, meters
STIFFNESS, DAMPING = 0.7, 0.12  # torque per radian, and per radian per second
SINGULAR = 1e-3  # added to the squared Jacobian: bounds the step of a stretched arm, square meters


def reach(observation: np.ndarray) -> np.ndarray:
    """Torques (2,) of a damped spring from the joint angles to those that bring the fingertip nearer to the target.

    Args:
        observation: Observation (10,) of Reacher-v5: cosines and sines of both angles, the target's position, the
            angular velocities, and the vector from the target to the fingertip.
    """
    cosines, sines, velocity, offset = observation[:2], observation[2:4], observation[6:8], observation[8:10]
    first, second = np.arctan2(sines, cosines)
    total = first + second
    upper, lower = LENGTHS
    jacobian = np.array(
        [
            [-upper * np.sin(first) - lower * np.sin(total), -lower * np.sin(total)],
            [upper * np.cos(first) + lower * np.cos(total), lower * np.cos(total)],
        ]
    )
    turn = -jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + SINGULAR * np.eye(2), offset)
    return np.clip(STIFFNESS * turn - DAMPING * velocity, -1, 1)


def reached(observation: np.ndarray, info: dict) -> bool:
    """Whether the fingertip is within 2 cm of the target, for `--success reacher:reached`."""
    return bool(np.linalg.norm(observation[8:10]) < 0.02)
