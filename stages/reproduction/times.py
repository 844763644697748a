"""Estimates of how long jobs take, from benchmarks and runs on one core with AVX2."""

from __future__ import annotations

from typing import Any

from stages.config.presets import defaults
from stages.reproduction.plan import Job

EXPERT_SAMPLES = 11_000  # per second: physics, policy and TRPO's updates
DEMO_FRAMES = 3_000  # per second, by benchmarks/collect_demos.py
PAIRS = {"compact": 240.0, "paper": 27.0, "real": 95.0}  # pairs of frames per second, by benchmarks/translator_step.py
TRANSLATE = 25.0  # seconds, including the quality of the reward
LEARNER_SAMPLES = 3_300  # per second, frames rendered and encoded (benchmarks/learn_cost.py)
ORACLE_SAMPLES = 7_000
DISCRIMINATOR_STEPS = {"gail": 14.0, "tpil": 6.0}  # per second
PRETRAINED_FRAMES = 450.0  # per second, 64x64 pixels, up to the last layer
EVALUATE = 15.0  # seconds
START = 4.0  # seconds that a command spends on imports
SAMPLES_AN_EPISODE, FRAMES_AN_EPISODE = 50, 24
MEMORY = {"collect-demos": 4_500, "train-translator": 4_500}  # MB
LEAST_MEMORY = 1_500  # MB, of the other stages


def minutes(job: Job, preset: str) -> float:
    """Minutes that a job takes on one core."""
    return (START + _seconds(job, defaults(preset, job.stage, job.task))) / 60


def memory(job: Job) -> int:
    """Megabytes that a job takes."""
    return MEMORY.get(job.stage, LEAST_MEMORY)


def _seconds(job: Job, config: Any) -> float:
    if job.stage == "train-expert":
        return config.iterations * config.episodes * SAMPLES_AN_EPISODE / EXPERT_SAMPLES
    if job.stage == "collect-demos":
        own = int(job.words[job.words.index("-n") + 1]) if "-n" in job.words else config.n
        return own * (FRAMES_AN_EPISODE + 1) / DEMO_FRAMES
    if job.stage == "train-translator":
        steps = 0 if "--steps" in job.words else config.steps  # jobs only ever say --steps 0
        return steps * config.videos * config.frames / PAIRS[config.arch]
    if job.stage == "translate":
        return TRANSLATE
    if job.stage == "evaluate":
        return EVALUATE
    episodes = config.iterations * config.episodes
    reward = job.words[job.words.index("--reward") + 1] if "--reward" in job.words else "translation"
    if reward in ("oracle", "joints"):
        return episodes * SAMPLES_AN_EPISODE / ORACLE_SAMPLES
    seconds = episodes * SAMPLES_AN_EPISODE / LEARNER_SAMPLES
    if reward in DISCRIMINATOR_STEPS:
        seconds += config.iterations * config.discriminator_steps / DISCRIMINATOR_STEPS[reward]
    if reward == "pretrained":
        seconds += episodes * FRAMES_AN_EPISODE / PRETRAINED_FRAMES
    return seconds


def longest_chain(jobs: list[Job], preset: str) -> float:
    """Minutes of the longest chain of jobs that depend on each other: a lower bound for any number of cores."""
    until: dict[str, float] = {}
    for job in jobs:
        until[job.output] = minutes(job, preset) + max((until.get(name, 0.0) for name in job.inputs), default=0.0)
    return max(until.values(), default=0.0)
