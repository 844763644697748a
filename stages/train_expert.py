"""train-expert: learn the task from its hand-written reward, in random contexts, observing the state and the goal."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from artifacts import default_path
from stages.config.presets import defaults
from stages.config.stages import ExpertConfig
from stages.runtime.checkpoints import Checkpoints
from stages.runtime.devices import pick_workers
from stages.runtime.outputs import Output, name_tags
from stages.runtime.run import RunOptions, StageResult, check, environment, full_config
from stages.runtime.seeding import generator
from stages.simulation.contexts import Contexts, repeat, take
from stages.simulation.task import State, Task

if TYPE_CHECKING:
    from stages.learners.policy import Policy

CONSISTENT_SPREAD = 0.15  # radians


def train_expert(task_name: str, config: ExpertConfig, run: RunOptions) -> StageResult:
    """Train an expert, test it, and write the `expert` artifact.

    The test draws fresh contexts and measures the normalized final distance and the consistency of the expert: the
    standard deviation of its final joint angles over episodes in one context with different initial noise.
    """
    from stages.environments.simulated import SimulatedEnvironment
    from stages.learners.loop import curve_arrays, learn
    from stages.learners.policy import Policy, policy_weights
    from stages.rewards.state import ExpertReward
    from stages.runtime.devices import use_threads
    from stages.simulation.gl import choose_backend
    from stages.simulation.registry import code_digest, distribution, file_name, make_task

    check("train-expert", config, run)
    choose_backend(required=False)  # Renders nothing, but mujoco fixes its backend on import.
    task = make_task(task_name, typed=True)
    task.varied(distribution(config.contexts, config.vary))
    if task.demonstrator:
        run.progress.say(f"{task_name} has a scripted demonstrator: ifo collect-demos needs no expert for it")
    workers = use_threads(pick_workers(run.workers))
    usual = defaults(run.preset, "train-expert", task_name, own=task.defaults)
    tags = name_tags(config, usual, run, 0, run.preset)
    out = run.out or default_path(Path("runs"), f"{file_name(task_name)}-{run.preset}{tags}", "expert")
    output = Output.of(out, "expert", "train-expert", config, run, extra={"task": task_name, **code_digest(task)})
    if kept := output.kept():
        return kept
    contexts = distribution(config.contexts, config.vary)
    env = SimulatedEnvironment(
        task,
        config.episodes,
        run.seed,
        lambda rng, n: task.draw_contexts(rng, n, contexts),
        ExpertReward(task),
        expert=True,
        nthread=workers,
    )
    described = full_config("train-expert", config, run, task=task_name)
    described |= {"observation_size": env.observation_size, "action_size": task.action_size}
    checkpoints = Checkpoints(run, out, "train-expert", described, [])
    model, curve = learn(env, config, run, out, "train-expert", checkpoints)
    report = _test(task, Policy.of(model), config, run, workers)
    distances, spread = report["test/normalised_distance"], report["test/spread"]
    success = float((distances < task.expert_threshold).mean())
    consistent = float((spread.max(axis=1) < CONSISTENT_SPREAD).mean())
    run.progress.say(
        f"expert: {100 * success:.1f}% of {len(distances)} contexts end below {task.expert_threshold} of the initial "
        f"distance (mean {distances.mean():.3f}); final joint angles vary by {np.median(spread.max(axis=1)):.3f} rad "
        f"(median over contexts of the standard deviation, largest joint), below {CONSISTENT_SPREAD} rad in "
        f"{100 * consistent:.1f}%"
    )
    arrays = policy_weights(model) | curve_arrays(curve) | report
    summary = {
        "success": success,
        "normalised_distance": float(distances.mean()),
        "consistent": consistent,
        "spread_rad": float(np.median(spread.max(axis=1))),
    }
    result = output.write(arrays, config=described, summary=summary, environment=environment())
    checkpoints.remove()
    return result


def _test(task: Task, policy: Policy, config: ExpertConfig, run: RunOptions, workers: int) -> dict[str, np.ndarray]:
    """Normalized final distances (C,) in fresh contexts, and spread of final joint angles (C, nq) over episodes."""
    from stages.simulation.batch import rollout
    from stages.simulation.registry import distribution

    rng = generator(run.seed, "expert-test")
    contexts = task.draw_contexts(rng, config.test_contexts, distribution(config.contexts, config.vary))

    def act(state: State, where: Contexts) -> np.ndarray:
        return policy.act(task.observe_expert(state, where))

    distances = rollout(task, contexts, *task.draw_states(rng, contexts), act=act, nthread=workers).normalised_distance
    spread = []
    for k in range(config.test_contexts):
        same = repeat(take(contexts, slice(k, k + 1)), config.test_episodes)
        episodes = rollout(task, same, *task.draw_states(rng, same), act=act, nthread=workers)
        spread.append(episodes.qpos[:, -1, task.posture].std(axis=0))
    return {"test/normalised_distance": distances, "test/spread": np.stack(spread)}
