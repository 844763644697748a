"""The learning loop shared by experts and imitation policies: iterate, log, save checkpoints, resume."""

from __future__ import annotations

import re
import time
from pathlib import Path

import numpy as np

from artifacts import UsageError, sibling
from stages.config.stages import LearnerConfig
from stages.environments.protocol import Environment
from stages.learners.algorithms import Learner, learner_state, make_learner, restore_learner
from stages.learners.gps.learner import GuidedPolicySearch
from stages.learners.policy import policy_weights
from stages.runtime.checkpoints import Checkpoints, curve_of
from stages.runtime.interrupts import undisguised_interrupts
from stages.runtime.run import RunOptions
from stages.runtime.seeding import integer
from stages.runtime.tensorboard import TensorBoard

Curve = dict[str, list[float]]
SHOWN = {"normalised_distance": "distance"}  # shorter names of figures, for the progress bar
FLAT = 0.01  # smallest gain that counts as an improvement, as a share of the range of returns


def learn(
    env: Environment,
    config: LearnerConfig,
    run: RunOptions,
    out: Path,
    stage: str,
    checkpoints: Checkpoints,
) -> tuple[Learner, Curve]:
    """Run all iterations, starting from the checkpoint if the run resumes one.

    Learners run on the CPU: it is fastest for small networks and small batches, and there a resumed run ends with
    exactly the same weights as an uninterrupted one.

    Returns:
        The learner and its curve. The curve has one value per iteration of `iteration`, `samples`, `seconds`, each
        term of the reward, each figure of the environment (means over the iteration's episodes; in simulation
        `normalised_distance` and `success`), and `action_std`.

    Raises:
        UsageError: The checkpoint was written with another configuration or seed, or learning diverged.
        Interrupted: The user interrupted the run; the checkpoint is kept.
    """
    with np.errstate(all="ignore"):  # Non-finite values are reported after the first iteration.
        model = make_learner(config, env, integer(run.seed, "learner"))
    curve: Curve = {}
    done = 0
    if (state := checkpoints.start()) is not None:
        with checkpoints.restoring():
            restore_learner(model, state["learner"])
            env.reward.restore(state["reward"])
            curve, done = curve_of(state["curve"]), range(config.iterations)[state["done"]]
    samples = env.num_envs * env.rounds * env.timing.control_steps
    try:
        with (
            undisguised_interrupts(),
            TensorBoard(sibling(out, ".tensorboard"), done, checkpoints.config) as board,
            run.progress.bar(f"{stage} ({config.learner})", config.iterations, "iterations", done) as bar,
        ):
            bar.update(done)
            while done < config.iterations and not is_flat(curve.get("return", []), config.patience):
                start = time.monotonic()
                _learn_once(model, samples, done)
                done += 1
                env.reward.iterate()
                figures = env.pop_figures()
                row = {
                    "iteration": float(done),
                    "samples": float(model.num_timesteps),
                    "seconds": time.monotonic() - start,
                    **env.reward.terms(),
                    **figures,
                    "action_std": action_std(model),
                }
                for name, value in row.items():
                    curve.setdefault(name, []).append(value)
                board.write(done, row)
                bar.update(
                    done, **{SHOWN.get(name, name): value for name, value in figures.items()}, returns=row["return"]
                )
                if done % config.checkpoint_every == 0 and done < config.iterations:
                    checkpoints.save(
                        {"learner": learner_state(model), "reward": env.reward.state(), "curve": curve, "done": done}
                    )
    except KeyboardInterrupt as error:
        # The learner may be in the middle of an update, so only the checkpoint is valid.
        raise checkpoints.interrupted(f"{done} of {config.iterations} iterations") from error
    if done < config.iterations:
        run.progress.say(f"{stage}: stopped after {done} iterations; no gain in the last {config.patience}")
    return model, curve


def _learn_once(model: Learner, samples: int, done: int) -> None:
    """Run one iteration.

    Raises:
        UsageError: Learning diverged: a value became NaN or infinite.
    """
    try:
        with np.errstate(all="ignore"):
            model.learn(samples, reset_num_timesteps=False)
        finite = is_finite(model)
    except FloatingPointError:
        finite = False
    except ValueError as error:  # torch raises ValueError for non-finite values and prints them in the message.
        if is_finite(model) and not re.search(r"\b(inf|nan)\b", str(error)):
            raise
        finite = False
    if not finite:
        raise UsageError(
            f"learning diverged in iteration {done + 1} (NaN or infinite values); lower --kl, --critic-rate, --log-std "
            "or the weights of the reward"
        )


def is_finite(model: Learner) -> bool:
    """Whether all weights of the policy are finite."""
    return all(np.isfinite(values).all() for values in policy_weights(model).values())


def is_flat(returns: list[float], patience: int) -> bool:
    """Whether the mean of the last `patience` returns is no better than the mean of the `patience` returns before.

    A gain counts if it exceeds one hundredth of the range of all returns. With a patience of 0, the result is False.
    """
    if not patience or len(returns) < 2 * patience:
        return False
    before, last = np.mean(returns[-2 * patience : -patience]), np.mean(returns[-patience:])
    return bool(last - before <= FLAT * np.ptp(returns))


def action_std(model: Learner) -> float:
    """Mean standard deviation of the policy's actions; NaN if it depends on the state."""
    if isinstance(model, GuidedPolicySearch):
        return model.controller.std()
    log_std = getattr(model.policy, "log_std", None)
    return float(log_std.detach().exp().mean()) if log_std is not None else float("nan")


def curve_arrays(curve: Curve) -> dict[str, np.ndarray]:
    """The datasets of a curve, with names under `curve/`."""
    return {f"curve/{name}": np.asarray(values, np.float64) for name, values in curve.items()}
