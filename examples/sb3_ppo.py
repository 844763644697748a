"""Stable-Baselines3's PPO learns from a translation into a Gymnasium environment.

    python examples/sb3_ppo.py runs/reacher.translation.h5 --steps 200000

Prints the success rate, if the environment reports success, and the mean return of the environment's own reward, which
PPO never sees.
"""

import argparse

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

import ifo

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("translation")
parser.add_argument("--steps", type=int, default=200_000)
parser.add_argument("--envs", type=int, default=4)
parser.add_argument("--rollout", type=int, default=512, help="steps per environment and iteration")
parser.add_argument("--episodes", type=int, default=10, help="episodes of the evaluation")
arguments = parser.parse_args()


def tracked():
    return ifo.TranslationReward(ifo.make_environment(arguments.translation), arguments.translation)


learned = make_vec_env(tracked, arguments.envs, seed=0)
batch = max(arguments.rollout * arguments.envs // 16, 2)
model = PPO("MlpPolicy", learned, n_steps=arguments.rollout, batch_size=batch, gamma=0.98, device="cpu", verbose=1)
model.learn(total_timesteps=arguments.steps)

env = ifo.make_environment(arguments.translation)
outcomes = []
for _ in range(arguments.episodes):
    observation, info = env.reset()
    while "outcome" not in info:
        action, _ = model.predict(observation, deterministic=True)
        observation, _, _, _, info = env.step(action)
    outcomes.append(info["outcome"])
for name in outcomes[0]:
    print(f"{name}: {np.mean([outcome[name] for outcome in outcomes]):.3f}")
