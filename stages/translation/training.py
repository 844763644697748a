"""The training loop of the translator: batches of pairs, optimizer, averaged weights and checkpoints."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from artifacts import UsageError, sibling
from stages.config.stages import LOSSES, TranslatorConfig
from stages.runtime.checkpoints import Checkpoints, curve_of
from stages.runtime.interrupts import undisguised_interrupts
from stages.runtime.processes import Processes
from stages.runtime.run import RunOptions
from stages.runtime.seeding import generator, integer
from stages.runtime.tensorboard import TensorBoard
from stages.runtime.trees import check_optimiser, from_tree, to_tree
from stages.translation.alignment import video_index
from stages.translation.augmentation import augmented
from stages.translation.best import BestWeights
from stages.translation.layers import DropoutLinear
from stages.translation.losses import LossWeights, translation_losses
from stages.translation.networks import Translator, make_translator, to_images

WARM_UP = 200  # steps until the learning rate reaches its peak
FINAL_RATE = 0.02  # final learning rate of the cosine schedule, relative to the peak
GRADIENT_NORM = 50.0
ALIGN_AT = (0.2, 0.5)  # shares of the steps after which videos are aligned, and aligned again
SHOW_EVERY = 0.2  # minimum seconds between updates of the progress bar; each update waits for the GPU to read losses
FEWEST = 4  # minimum number of demonstrations: two for training, two held out
GPU_SHARE = 0.5  # maximum share of the free GPU memory for training videos


class TranslatorTraining:
    """State of a training run: networks, optimizer and step. Batches depend only on the seed and the step."""

    def __init__(
        self,
        config: TranslatorConfig,
        frames: Tensor,
        seed: int,
        device: str,
        processes: Processes | None = None,
        weights: dict[str, Tensor] | None = None,
    ):
        """Start from newly initialized weights, or from those of another translator.

        Args:
            config: Training configuration.
            frames: Training demonstrations (N, T, H, W, 3), uint8; frame 0 of each is its context.
            seed: Seed of the run.
            device: Torch device.
            processes: Processes that share the groups of each step (None: only this process).
            weights: Weights to start from, for `config.arch` and this frame size (None: newly initialized).

        Raises:
            UsageError: The number of groups is not a multiple of the number of processes.
        """
        self._processes = processes or Processes()
        self._groups = self._processes.share(config.groups)
        self.config, self.seed, self.device = config, seed, device
        self._frames = on_gpu(frames, device)
        self._red_blue_green = torch.tensor([0, 2, 1], device=device)  # A list would wait for the GPU at each step.
        self._index: np.ndarray | None = None  # Frame indices (N, T) that warp the videos to a common timeline.
        self.step = 0
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(integer(seed, "translator"))
            self.model: Translator = make_translator(config.arch, (frames.shape[2], frames.shape[3])).to(device)
        if weights is not None:
            self.model.load_state_dict(weights)
        self._drops = any(isinstance(layer, DropoutLinear) and layer.dropout for layer in self.model.modules())
        self.average = copy.deepcopy(self.model) if config.ema else self.model
        self.best = BestWeights()
        self.optimiser = torch.optim.AdamW(
            self.model.parameters(),
            lr=config.learning_rate,
            betas=(0.9, 0.99) if config.schedule == "cosine" else (0.9, 0.999),
            weight_decay=config.weight_decay,
            fused=True,
        )
        self._weights = LossWeights(
            trans=float("trans" not in config.without),
            rec=config.lambda_rec * ("rec" not in config.without),
            align=config.lambda_align * ("align" not in config.without),
        )
        losses: Callable[..., dict[str, Tensor]] = translation_losses
        # A step runs hundreds of small kernels; CUDA graphs reduce them to one launch. They are not used with several
        # groups, because a graph overwrites its gradients when it runs again and they would not accumulate, nor with
        # dropout, because its random numbers are seeded outside the graph.
        graphs = device.startswith("cuda") and len(self._groups) == 1 and not self._drops
        self._losses = (
            torch.compile(losses, mode="reduce-overhead" if graphs else "default") if config.compile else losses
        )

    def train_step(self) -> dict[str, Tensor]:
        """Run one optimizer step.

        Returns:
            The three losses: sums per frame over features or pixels in [-1, 1]. They are float64 scalars on the device,
            and reading them waits for the device.
        """
        config = self.config
        for group in self.optimiser.param_groups:
            group["lr"] = self._rate()
        self.optimiser.zero_grad(set_to_none=True)
        first, *others = [self._backward(group) for group in self._groups]
        losses = sum(others, first) / len(self._groups)
        if self._processes.count > 1:
            losses = self._share(losses)
        if config.schedule == "cosine":
            torch.nn.utils.clip_grad_norm_(self.model.parameters(), GRADIENT_NORM)
        self.optimiser.step()
        self.step += 1
        if config.ema:
            decay = min(config.ema, (1 + self.step) / (10 + self.step))
            with torch.no_grad():
                torch._foreach_lerp_(list(self.average.parameters()), list(self.model.parameters()), 1 - decay)
        return dict(zip(LOSSES, losses.unbind(), strict=True))

    def _backward(self, group: int) -> Tensor:
        """Accumulate the gradients of one group of this process, for the mean over groups; returns its losses (3,)."""
        config = self.config
        videos, contexts, sources, reconstructed = self._batch(group)
        use_amp = config.amp and self.device.startswith("cuda")
        with self._dropout(group), torch.autocast("cuda", torch.bfloat16, enabled=use_amp):
            losses = self._losses(self.model, videos, contexts, sources, config.motion_weight, reconstructed)
            total = (
                self._weights.trans * losses["trans"]
                + self._weights.rec * losses["rec"]
                + self._weights.align * losses["align"]
            )
        (total / len(self._groups)).backward()
        return torch.stack([losses[name].detach() for name in LOSSES]).double()

    @contextmanager
    def _dropout(self, group: int) -> Iterator[None]:
        """Seed dropout by the run's seed, step and group, as for the batches, so that no generator state is stored."""
        if not self._drops:
            yield
            return
        with torch.random.fork_rng([self.device] if self.device.startswith("cuda") else []):
            torch.manual_seed(integer(self.seed, "dropout", self.step, group))
            yield

    def _share(self, losses: Tensor) -> Tensor:
        """Average gradients and losses (3,) over all processes.

        They are averaged as one vector after the backward pass. DistributedDataParallel is not used, because it hooks
        into a single call of `forward` of one module. Here, Enc1, T and Dec are called separately, and several groups
        may be accumulated first.
        """
        gradients = [parameter.grad for parameter in self.model.parameters() if parameter.grad is not None]
        mean = self._processes.mean(torch.cat([*(gradient.flatten() for gradient in gradients), losses.float()]))
        *parts, values = mean.split([*(gradient.numel() for gradient in gradients), len(losses)])
        for gradient, part in zip(gradients, parts, strict=True):
            gradient.copy_(part.view_as(gradient))
        return values.double()

    def _rate(self) -> float:
        config = self.config
        if config.schedule == "constant":
            return config.learning_rate
        warm = min(1.0, (self.step + 1) / min(WARM_UP, max(config.steps // 5, 1)))
        cosine = 0.5 * (1 + math.cos(math.pi * self.step / config.steps))
        return config.learning_rate * warm * max(cosine, FINAL_RATE)

    def _batch(self, group: int = 0) -> tuple[Tensor, Tensor, list[Tensor], Tensor | None]:
        """Videos (V, K, 3, H, W), contexts (V, 3, H, W), sources (V,) of each pairing, and times (R,) for L_rec."""
        config = self.config
        rng = generator(self.seed, "batch", self.step, *([group] if group else []))
        count, times = self._frames.shape[:2]
        chosen = rng.choice(count, min(config.videos, count), replace=False)
        moments = 1 + rng.choice(times - 1, min(config.frames, times - 1), replace=False)
        shown = np.concatenate([[0], np.sort(moments)])
        index = np.tile(shown, (len(chosen), 1)) if self._index is None else self._index[chosen][:, shown]
        images = to_images(self._picked(chosen, index))
        # Mirroring and swapping colors keep the meaning of a video, though a mirrored robot bends the other way.
        mirrored, swapped = self._sent(rng.random((2, len(chosen))) < 0.5)
        if config.mirror:
            images = torch.where(mirrored[:, None, None, None, None], images.flip(-1), images)
        if config.swap_colours:
            images = torch.where(swapped[:, None, None, None, None], images[:, :, self._red_blue_green], images)
        if config.augment:
            images = augmented(images, generator(self.seed, "augment", self.step, group))
        shifts = 1 + rng.choice(len(chosen) - 1, min(config.pairings, len(chosen) - 1), replace=False)
        sources = [self._sent((np.arange(len(chosen)) + shift) % len(chosen)) for shift in shifts]
        reconstructed = None
        if 0 < config.rec_frames < len(moments):
            reconstructed = self._sent(rng.choice(len(moments), config.rec_frames, replace=False))
        return images[:, 1:], images[:, 0], sources, reconstructed

    def _picked(self, videos: np.ndarray, index: np.ndarray) -> Tensor:
        """Frames `index` (V, F) of the training videos with numbers `videos` (V,), on the device."""
        if self._frames.is_cuda:
            return self._frames[self._sent(videos)[:, None], self._sent(index)]
        return self._sent(self._frames[torch.from_numpy(videos)[:, None], torch.from_numpy(index)])

    def _sent(self, values: np.ndarray | Tensor) -> Tensor:
        """Copy values to the device, without waiting for a GPU."""
        values = torch.as_tensor(values)
        return values.pin_memory().to(self.device, non_blocking=True) if self.device.startswith("cuda") else values

    def align(self) -> None:
        """Warp all videos to a common timeline with the current network, if an alignment is due at this step."""
        due = (round(share * self.config.steps) for share in ALIGN_AT)
        if self.config.align == "dtw" and self.step in due:
            self._index = video_index(self.average, self._frames, self._frames[0, 0], self.device)

    def state(self) -> dict[str, Any]:
        """The complete state that determines the rest of training, as a tree of arrays and numbers."""
        return {
            "step": self.step,
            **({} if self._index is None else {"index": self._index}),
            "model": to_tree(self.model.state_dict()),
            "average": to_tree(self.average.state_dict()),
            "optimiser": to_tree(self.optimiser.state_dict()),
            "best": self.best.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a state returned by `state`, bit for bit."""
        self.step = range(self.config.steps)[state["step"]]
        self._index = None if state.get("index") is None else self._checked_index(state["index"])
        self.model.load_state_dict(from_tree(state["model"]))
        self.average.load_state_dict(from_tree(state["average"]))
        self.optimiser.load_state_dict(from_tree(state["optimiser"]))
        check_optimiser(self.optimiser)
        self.best.restore(state.get("best", {}), self.average)

    def _checked_index(self, index: np.ndarray) -> np.ndarray:
        count, length = self._frames.shape[:2]
        if index.shape != (count, length) or index.dtype.kind != "i" or not 0 <= index.min() <= index.max() < length:
            raise ValueError("its frame indices do not fit the videos")
        return index


def on_gpu(frames: Tensor, device: str) -> Tensor:
    """Move the training videos to GPU memory if `device` is a GPU and they need at most GPU_SHARE of its free memory.

    Otherwise, the videos are returned unchanged.
    """
    if device.startswith("cuda") and frames.nbytes <= GPU_SHARE * torch.cuda.mem_get_info(device)[0]:
        return frames.to(device)
    return frames


def train(
    training: TranslatorTraining,
    evaluate: Callable[[Translator], dict[str, float]],
    run: RunOptions,
    out: Path,
    checkpoints: Checkpoints,
) -> dict[str, list[float]]:
    """Train up to the last step, starting from the checkpoint if the run resumes one.

    If there are several processes, only the main one evaluates and keeps the checkpoints and the curve.

    Args:
        training: State of the training run.
        evaluate: Function from the averaged network to held-out metrics.
        run: Options of the run.
        out: Path of the output artifact.
        checkpoints: Checkpoints of the run.

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

    since = start = shown_at = time.monotonic()
    first = training.step
    try:
        with (
            undisguised_interrupts(),
            TensorBoard(sibling(out, ".tensorboard"), training.step) if main else nullcontext() as board,
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
