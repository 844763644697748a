"""Small searches to test."""

import dataclasses

import numpy as np

from stages.config.stages import LearnerConfig
from stages.environments.simulated import SimulatedEnvironment
from stages.rewards.state import GoalReward
from stages.simulation.contexts import DISTRIBUTIONS, repeat
from stages.simulation.tasks.reach import Reach

CONFIG = LearnerConfig(learner="gps", episodes=10, kl=1.0, log_std=0.0)
SMALL = dataclasses.replace(CONFIG, episodes=5, iterations=4, checkpoint_every=2)


def context_of(task):
    return task.draw_contexts(np.random.default_rng(3), 1, DISTRIBUTIONS["paper"])


def environment(config=CONFIG, task=None, reward=None):
    task = task or Reach()
    context = context_of(task)
    reward = reward or GoalReward(task, context)
    return SimulatedEnvironment(task, config.episodes, 0, lambda rng, n: repeat(context, n), reward, nthread=1)
