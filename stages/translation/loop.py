"""The loop of a training run of the translator: progress, held-out metrics, checkpoints and the weights to keep."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import numpy as np
from torch import Tensor

from artifacts import UsageError, sibling
from stages.runtime.checkpoints import Checkpoints, curve_of
from stages.runtime.interrupts import undisguised_interrupts
from stages.runtime.run import RunOptions
from stages.runtime.tensorboard import TensorBoard
from stages.translation.networks import Translator
from stages.translation.training import TranslatorTraining

SHOW_EVERY = 0.2  # minimum seconds between updates of the progress bar; each update waits for the GPU to read losses
PICTURES = 20  # of held-out translations over a training run
FEWEST = 4  # minimum number of demonstrations: two for training, two held out


def train(
    training: TranslatorTraining,
    evaluate: Callable[[Translator], dict[str, float]],
    run: RunOptions,
    out: Path,
    checkpoints: Checkpoints,
    draw: Callable[[Translator], np.ndarray] | None = None,
) -> dict[str, list[float]]:
    """Train up to the last step, starting from the checkpoint if the run resumes one.

    If there are several processes, only the main one evaluates and keeps the checkpoints and the curve.

    Args:
        training: State of the training run.
        evaluate: Function from the averaged network to held-out metrics.
        run: Options of the run.
        out: Path of the output artifact.
        checkpoints: Checkpoints of the run.
        draw: Function from the averaged network to a picture (H, W, 3), uint8, of held-out translations, which
            TensorBoard shows at up to `PICTURES` of the evaluations.

    Afterwards, `training.average` has the weights that `config.keep` asks for.

    Returns:
        The curve, with one value per evaluation: `step`, `seconds` since the previous evaluation (including this
        evaluation), the training losses and each held-out metric.

    Raises:
        Interrupted: The user interrupted the run; the checkpoint is kept.
        UsageError: Training diverged: a loss is NaN or infinite at an evaluation.
    """
    config = training.config
    curve: dict[str, list[float]] = {}
    drawn_every = config.evaluate_every * max(1, math.ceil(config.steps / config.evaluate_every / PICTURES))
    before, since = 0.0, time.monotonic()
    if (state := checkpoints.start()) is not None:
        with checkpoints.restoring():
            training.restore(state["training"])
            curve, before = curve_of(state["curve"]), float(state["seconds"])
    main = run.processes.main
    run.processes.ready(training.step)
    held = {name: values[-1] for name, values in curve.items() if name.startswith("held_out/")}

    def spent() -> float:
        """Seconds since the last evaluation, including the time before the checkpoint of a resumed run."""
        return before + time.monotonic() - since

    def measure(losses: dict[str, Tensor]) -> None:
        nonlocal before, since
        if not all(math.isfinite(value) for value in losses.values()):
            raise UsageError(
                f"--learning-rate {config.learning_rate:g}: after {training.step} steps, a loss is NaN or infinite; "
                "use a lower learning rate"
            )
        held.update({f"held_out/{name}": value for name, value in evaluate(training.average).items()})
        if config.keep == "best" and "trans" not in config.without:  # Otherwise images are not learned.
            training.best.see(training.step, held["held_out/trans"], training.average)
        times = {"step": float(training.step), "seconds": spent()}
        before, since = 0.0, time.monotonic()
        row = {**times, **{f"train/{name}": float(value) for name, value in losses.items()}, **held}
        for name, value in row.items():
            curve.setdefault(name, []).append(value)
        if board is not None:
            board.write(training.step, row)
            if draw is not None and (training.step % drawn_every == 0 or training.step == config.steps):
                board.show(training.step, "held-out translations", draw(training.average))

    since = start = shown_at = time.monotonic()
    first, folder = training.step, sibling(out, ".tensorboard")
    try:
        with (
            undisguised_interrupts(),
            TensorBoard(folder, training.step, checkpoints.config) if main else nullcontext() as board,
            run.progress.bar(f"train-translator ({config.arch})", config.steps, "steps", training.step) as bar,
        ):
            if config.steps == 0 and main:
                measure({})
            while training.step < config.steps:
                training.align()
                losses = training.train_step()
                if main and (training.step % config.evaluate_every == 0 or training.step == config.steps):
                    measure(losses)
                if time.monotonic() - shown_at >= SHOW_EVERY or training.step == config.steps:
                    shown = {k: held[f"held_out/{k}"] for k in ("psnr", "copy_psnr", "ssim", "feature_ratio") if held}
                    bar.update(training.step, trans=float(losses["trans"]), rec=float(losses["rec"]), **shown)
                    shown_at = time.monotonic()
                if main and training.step % config.checkpoint_every == 0 and training.step < config.steps:
                    checkpoints.save({"training": training.state(), "curve": curve, "seconds": spent()})
    except KeyboardInterrupt as error:
        raise checkpoints.interrupted(f"{training.step} of {config.steps} steps") from error
    run.progress.say(f"translator: {training.step - first} steps in {time.monotonic() - start:.0f} s")
    if 0 < training.best.step < training.step:
        run.progress.say(f"kept the weights of step {training.best.step}: held-out errors rose after it")
    training.best.load(training.average)
    return curve


def held_out_count(demonstrations: int, wanted: int) -> int:
    """Number of held-out demonstrations, the last ones of the file: `wanted`, but at most a fifth and at least two."""
    return max(min(wanted, demonstrations // 5), 2)
