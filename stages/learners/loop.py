"""The learning loop that experts and imitating policies share: iterate, log, checkpoint, resume."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm

from artifacts import (
    Interrupted,
    UsageError,
    checkpoint_path,
    read_checkpoint,
    sibling,
    write_checkpoint,
)
from stages.configs import LearnerConfig
from stages.learners.algorithms import learner_state, make_learner, restore_learner
from stages.learners.environment import EpisodeEnv
from stages.run import RunOptions
from stages.seeding import integer

Curve = dict[str, list[float]]


def learn(
    env: EpisodeEnv,
    config: LearnerConfig,
    run: RunOptions,
    out: Path,
    stage: str,
    full_config: dict[str, Any],
    parents: list[Path],
    device: str = "cpu",
) -> tuple[BaseAlgorithm, Curve]:
    """Run all iterations, from the checkpoint beside `out` if `run.resume` and there is one.

    A run that was killed and resumed ends with the same weights as one that was not (on CPU).

    Returns:
        The learner, and its curve: one value an iteration of `iteration`, `samples`, `seconds`, each term of the
        reward, `normalised_distance` (mean over the iteration's episodes), `success` and `action_std`.

    Raises:
        UsageError: The checkpoint was written under another configuration or seed.
        Interrupted: By the keyboard; the checkpoint was kept.
    """
    model = make_learner(config, env, integer(run.seed, "learner"), device)
    path = checkpoint_path(out)
    curve: Curve = {}
    done = 0
    if run.resume and path.exists():
        manifest, state = read_checkpoint(path, stage=stage)
        check_same_run(path, manifest.config, manifest.seed, full_config, run.seed)
        restore_learner(model, state["learner"])
        curve, done = state["curve"], state["done"]
        run.progress.say(f"resuming {out.name} after {done} of {config.iterations} iterations")
    elif run.resume:
        run.progress.say(f"no checkpoint beside {out}: starting from the beginning")

    def checkpoint() -> None:
        state = {"learner": learner_state(model), "curve": curve, "done": done}
        write_checkpoint(
            path, state, stage=stage, config=full_config, seed=run.seed, command=run.command, parents=parents
        )

    samples = env.num_envs * env.task.control_steps
    threshold = env.task.success_threshold
    try:
        with (
            TensorBoard(sibling(out, ".tensorboard"), done) as board,
            run.progress.bar(f"{stage} ({config.learner})", config.iterations, "iterations") as bar,
        ):
            bar.update(done)
            while done < config.iterations:
                start = time.monotonic()
                model.learn(samples, reset_num_timesteps=False)
                done += 1
                distances = env.pop_distances()
                row = {
                    "iteration": float(done),
                    "samples": float(model.num_timesteps),
                    "seconds": time.monotonic() - start,
                    **env.reward.terms(),
                    "normalised_distance": float(distances.mean()),
                    "success": float((distances < threshold).mean()),
                    "action_std": action_std(model),
                }
                for name, value in row.items():
                    curve.setdefault(name, []).append(value)
                board.write(done, row)
                bar.update(done, distance=row["normalised_distance"], returns=row["return"])
                if done % config.checkpoint_every == 0 and done < config.iterations:
                    checkpoint()
    except KeyboardInterrupt as error:
        # An iteration cut in the middle left the learner between two states: only whole ones were kept.
        kept = f"kept {path}; continue with: {run.command} --resume" if path.exists() else "no checkpoint yet"
        raise Interrupted(f"interrupted after {done} of {config.iterations} iterations; {kept}") from error
    return model, curve


def check_same_run(path: Path, found: dict[str, Any], found_seed: int, wanted: dict[str, Any], seed: int) -> None:
    """Raise UsageError unless a checkpoint belongs to the run that wants to resume it."""
    other = sorted(key for key in found.keys() | wanted.keys() if found.get(key) != wanted.get(key))
    if found_seed != seed:
        other.append("seed")
    if other:
        raise UsageError(
            f"--resume: {path} was written with another {', '.join(other)}; give the same options, or start anew"
        )


def action_std(model: BaseAlgorithm) -> float:
    """Mean standard deviation of the policy's actions, where it has a state-independent one."""
    log_std = getattr(model.policy, "log_std", None)
    return float(log_std.detach().exp().mean()) if log_std is not None else float("nan")


def curve_arrays(curve: Curve) -> dict[str, np.ndarray]:
    """A curve as datasets under `curve/`."""
    return {f"curve/{name}": np.asarray(values, np.float64) for name, values in curve.items()}


class TensorBoard:
    """Scalars for TensorBoard in a folder beside the artifact."""

    def __init__(self, folder: Path, done: int):
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
        from torch.utils.tensorboard import SummaryWriter

        self._writer = SummaryWriter(str(folder), purge_step=done + 1 if done else None)

    def write(self, step: int, row: dict[str, float]) -> None:
        for name, value in row.items():
            if name != "iteration" and np.isfinite(value):
                self._writer.add_scalar(name, value, step)

    def __enter__(self) -> TensorBoard:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._writer.close()
