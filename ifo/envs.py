"""The tasks as Gymnasium environments. Importing this module registers `ifo/Reach-v0`, `ifo/Push-v0` and so on.

    import gymnasium
    import ifo.envs

    gymnasium.register_envs(ifo.envs)
    env = gymnasium.make("ifo/Reach-v0", contexts="narrow", pixels=True)

or in one line: `gymnasium.make("ifo.envs:ifo/Reach-v0")`. `ifo/Task-v0` makes the task that `task_name` names.
"""

from __future__ import annotations

from stages.simulation.gym_registration import IDS, make

__all__ = ["IDS", "make"]
