"""Meta-World's tasks for `ifo`: `--env meta_world:make --env-kwargs task=reach-v3`, and their scripted experts.

Meta-World 3.1 pins an older MuJoCo. Beside a newer one, install it with `pip install --no-deps metaworld`; `make` then
adapts the weld constraints of its mocap body, of which newer MuJoCo stores one number more.
"""

import gymnasium
import mujoco
import numpy as np
from metaworld.env_dict import ALL_V3_ENVIRONMENTS
from metaworld.policies import ENV_POLICY_MAP
from metaworld.sawyer_xyz_env import SawyerMocapBase

WELD = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 5.0)  # relative pose, and the scale of its torque
CAMERA = "corner2"


def _reset_welds(env: SawyerMocapBase) -> None:
    for index, kind in enumerate(env.model.eq_type):
        if kind == mujoco.mjtEq.mjEQ_WELD:
            env.model.eq_data[index, : len(WELD)] = WELD


class Observed(gymnasium.Wrapper):
    """Object and goal positions that follow from the seed of `reset`, and numbers instead of flags in `info`."""

    def reset(self, *, seed=None, options=None):
        if seed is not None:
            self.env.unwrapped.seed(seed)
        return self.env.reset(seed=seed, options=options)


def make(task: str, render_mode: str = "rgb_array", camera_name: str = CAMERA, **kwargs) -> gymnasium.Env:
    """Make a task of Meta-World, such as `reach-v3`, whose goal is observed."""
    SawyerMocapBase.reset_mocap_welds = _reset_welds
    env = ALL_V3_ENVIRONMENTS[task](render_mode=render_mode, camera_name=camera_name, **kwargs)
    env._freeze_rand_vec, env._set_task_called, env._partially_observable = False, True, False
    env.seeded_rand_vec = True
    del env.sawyer_observation_space  # It was cached with bounds of zero for the goal.
    env.observation_space = env.sawyer_observation_space
    return Observed(env)


class _Expert:
    """The scripted expert of a task."""

    task = ""

    def __init__(self) -> None:
        self._policy = ENV_POLICY_MAP[self.task]()

    def get_action(self, observation: np.ndarray) -> np.ndarray:
        return np.clip(self._policy.get_action(observation), -1, 1)


def __getattr__(name: str) -> type[_Expert]:
    """The expert of each task under its name with underscores: `meta_world:reach_v3`."""
    task = name.replace("_", "-")
    if task not in ENV_POLICY_MAP:
        raise AttributeError(name)
    return type(name, (_Expert,), {"task": task})
