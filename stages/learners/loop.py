"""The learning loop that experts and imitating policies share: iterate, log, checkpoint, resume."""

from __future__ import annotations

import re
import time
from pathlib import Path

import numpy as np

from artifacts import UsageError, sibling
from stages.config.stages import LearnerConfig
from stages.learners.algorithms import Learner, learner_state, make_learner, restore_learner
from stages.learners.environment import EpisodeEnv
from stages.learners.gps.learner import GuidedPolicySearch
from stages.learners.policy import policy_weights
from stages.runtime.checkpoints import Checkpoints
from stages.runtime.run import RunOptions
from stages.runtime.seeding import integer
from stages.runtime.tensorboard import TensorBoard

Curve = dict[str, list[float]]
FLAT = 0.01  # of the return's range: less is no gain


def learn(
    env: EpisodeEnv,
    config: LearnerConfig,
    run: RunOptions,
    out: Path,
    stage: str,
    checkpoints: Checkpoints,
) -> tuple[Learner, Curve]:
    """Run all iterations, from the checkpoint if the run resumes one.

    Small networks on small batches are fastest, and resume bit for bit, on the CPU: that is where learners live.

    A run that was killed and resumed ends with the same weights as one that was not (on CPU).

    Returns:
        The learner, and its curve: one value an iteration of `iteration`, `samples`, `seconds`, each term of the
        reward, `normalised_distance` (mean over the iteration's episodes), `success` and `action_std`.

    Raises:
        UsageError: The checkpoint was written under another configuration or seed, or learning has diverged.
        Interrupted: By the keyboard; the checkpoint was kept.
    """
    with np.errstate(all="ignore"):  # What it comes to is looked at after the first iteration.
        model = make_learner(config, env, integer(run.seed, "learner"))
    curve: Curve = {}
    done = 0
    if (state := checkpoints.start()) is not None:
        restore_learner(model, state["learner"])
        env.reward.restore(state["reward"])
        curve, done = state["curve"], state["done"]
    samples = env.num_envs * env.task.control_steps
    threshold = env.task.success_threshold
    try:
        with (
            TensorBoard(sibling(out, ".tensorboard"), done) as board,
            run.progress.bar(f"{stage} ({config.learner})", config.iterations, "iterations", done) as bar,
        ):
            bar.update(done)
            while done < config.iterations and not is_flat(curve.get("return", []), config.patience):
                start = time.monotonic()
                _learn_once(model, samples, done)
                done += 1
                env.reward.iterate()
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
                    checkpoints.save(
                        {"learner": learner_state(model), "reward": env.reward.state(), "curve": curve, "done": done}
                    )
    except KeyboardInterrupt as error:
        # The learner stands between two states: only the checkpoint's counts.
        raise checkpoints.interrupted(f"{done} of {config.iterations} iterations") from error
    if done < config.iterations:
        run.progress.say(f"{stage}: stopped after {done} iterations, the return has been flat for {config.patience}")
    return model, curve


def _learn_once(model: Learner, samples: int, done: int) -> None:
    """One iteration.

    Raises:
        UsageError: The numbers that it computes with are no finite ones any more.
    """
    try:
        with np.errstate(all="ignore"):
            model.learn(samples, reset_num_timesteps=False)
        finite = is_finite(model)
    except FloatingPointError:
        finite = False
    except ValueError as error:  # What torch raises about such numbers; it shows them.
        if is_finite(model) and not re.search(r"\b(inf|nan)\b", str(error)):
            raise
        finite = False
    if not finite:
        raise UsageError(
            f"iteration {done + 1} left no finite numbers to go on with: give a smaller --kl, --critic-rate, --log-std "
            "or weight of the reward"
        )


def is_finite(model: Learner) -> bool:
    """Whether the policy's weights are numbers to compute with."""
    return all(np.isfinite(values).all() for values in policy_weights(model).values())


def is_flat(returns: list[float], patience: int) -> bool:
    """Whether the last `patience` returns are on average no better than as many before them.

    Better is by more than a hundredth of the whole curve's range. Never with a patience of 0.
    """
    if not patience or len(returns) < 2 * patience:
        return False
    before, last = np.mean(returns[-2 * patience : -patience]), np.mean(returns[-patience:])
    return bool(last - before <= FLAT * np.ptp(returns))


def action_std(model: Learner) -> float:
    """Mean standard deviation of the policy's actions, where it has a state-independent one."""
    if isinstance(model, GuidedPolicySearch):
        return model.controller.std()
    log_std = getattr(model.policy, "log_std", None)
    return float(log_std.detach().exp().mean()) if log_std is not None else float("nan")


def curve_arrays(curve: Curve) -> dict[str, np.ndarray]:
    """A curve as datasets under `curve/`."""
    return {f"curve/{name}": np.asarray(values, np.float64) for name, values in curve.items()}
