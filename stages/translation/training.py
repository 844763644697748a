"""The translator's training loop: batches of pairs, optimiser, averaged weights, checkpoints."""

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
from stages.runtime.checkpoints import Checkpoints
from stages.runtime.processes import Processes
from stages.runtime.run import RunOptions
from stages.runtime.seeding import generator, integer
from stages.runtime.tensorboard import TensorBoard
from stages.runtime.trees import from_tree, to_tree
from stages.translation.alignment import video_index
from stages.translation.augmentation import augmented
from stages.translation.layers import DropoutLinear
from stages.translation.losses import LossWeights, translation_losses
from stages.translation.networks import Translator, make_translator, to_images

WARM_UP = 200  # steps to the peak learning rate
FINAL_RATE = 0.02  # of the peak, at the end of the cosine
GRADIENT_NORM = 50.0
ALIGN_AT = (0.2, 0.5)  # shares of the steps after which videos are aligned, and aligned better
SHOW_EVERY = 0.2  # seconds between two updates of the progress bar; each reads losses, and so waits for a GPU
FEWEST = 4  # demonstrations: two to train on, two held out
GPU_SHARE = 0.5  # of a GPU's free memory that training videos may take


class TranslatorTraining:
    """State of a training run: networks, optimiser and step. Batches follow from seed and step alone."""

    def __init__(
        self, config: TranslatorConfig, frames: Tensor, seed: int, device: str, processes: Processes | None = None
    ):
        """Start from fresh weights.

        Args:
            config: How to train.
            frames: Training demonstrations (N, T, H, W, 3), uint8; frame 0 of each is its context.
            seed: The run's seed.
            device: Torch device.
            processes: The processes that share each step's groups (None: this one alone).

        Raises:
            UsageError: The groups cannot be shared out evenly.
        """
        self._processes = processes or Processes()
        self._groups = self._processes.share(config.groups)
        self.config, self.seed, self.device = config, seed, device
        self._frames = on_gpu(frames, device)
        self._red_blue_green = torch.tensor([0, 2, 1], device=device)  # A list would be waited for at each step.
        self._index: np.ndarray | None = None  # Frames (N, T) that bring the videos to one tempo.
        self.step = 0
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(integer(seed, "translator"))
            self.model: Translator = make_translator(config.arch, (frames.shape[2], frames.shape[3])).to(device)
        self._drops = any(isinstance(layer, DropoutLinear) and layer.dropout for layer in self.model.modules())
        self.average = copy.deepcopy(self.model) if config.ema else self.model
        self.optimiser = torch.optim.AdamW(
            self.model.parameters(),
            lr=config.learning_rate,
            betas=(0.9, 0.99) if config.schedule == "cosine" else (0.9, 0.999),
            weight_decay=config.weight_decay,
            fused=device.startswith("cuda") or None,
        )
        self._weights = LossWeights(
            trans=float("trans" not in config.without),
            rec=config.lambda_rec * ("rec" not in config.without),
            align=config.lambda_align * ("align" not in config.without),
        )
        losses: Callable[..., dict[str, Tensor]] = translation_losses
        # A step is hundreds of small kernels: by CUDA graphs, one launch. A graph's gradients stay where its next run
        # writes, so that no second group can be added to them; and what dropout draws is seeded outside.
        graphs = device.startswith("cuda") and len(self._groups) == 1 and not self._drops
        self._losses = (
            torch.compile(losses, mode="reduce-overhead" if graphs else "default") if config.compile else losses
        )

    def train_step(self) -> dict[str, Tensor]:
        """One optimiser step; returns the three losses, sums over pixels in [-1, 1] or features, a frame.

        They are numbers (float64) on the device: to read them is to wait for it.
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
        """Add the gradients of one of this process's groups, for their mean; returns its three losses (3,)."""
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
        """What a group's dropout draws follows from seed, step and group, as its batch does: no state to keep."""
        if not self._drops:
            yield
            return
        with torch.random.fork_rng([self.device] if self.device.startswith("cuda") else []):
            torch.manual_seed(integer(self.seed, "dropout", self.step, group))
            yield

    def _share(self, losses: Tensor) -> Tensor:
        """Average gradients and losses (3,) over the processes.

        In one vector, after the backward pass, and not by DistributedDataParallel: that hooks into one call of one
        module's `forward`, where here Enc1, T and Dec are called by themselves and some groups may come first.
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
        """Videos (V, K, 3, H, W), contexts (V, 3, H, W), each pairing's sources (V,), and the times (R,) of L_rec."""
        config = self.config
        rng = generator(self.seed, "batch", self.step, *([group] if group else []))
        count, times = self._frames.shape[:2]
        chosen = rng.choice(count, min(config.videos, count), replace=False)
        moments = 1 + rng.choice(times - 1, min(config.frames, times - 1), replace=False)
        shown = np.concatenate([[0], np.sort(moments)])
        index = np.tile(shown, (len(chosen), 1)) if self._index is None else self._index[chosen][:, shown]
        images = to_images(self._picked(chosen, index))
        # Neither changes what a video means, though a mirrored one shows a robot that bends the other way.
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
        """Frames `index` (V, F) of the training videos (V,), on the device."""
        if self._frames.is_cuda:
            return self._frames[self._sent(videos)[:, None], self._sent(index)]
        return self._sent(self._frames[torch.from_numpy(videos)[:, None], torch.from_numpy(index)])

    def _sent(self, values: np.ndarray | Tensor) -> Tensor:
        """Values on the device; a GPU is not waited for."""
        values = torch.as_tensor(values)
        return values.pin_memory().to(self.device, non_blocking=True) if self.device.startswith("cuda") else values

    def align(self) -> None:
        """Bring all videos to one tempo by what the network has learned so far, if they are to be aligned now."""
        due = (round(share * self.config.steps) for share in ALIGN_AT)
        if self.config.align == "dtw" and self.step in due:
            self._index = video_index(self.average, self._frames, self._frames[0, 0], self.device)

    def state(self) -> dict[str, Any]:
        """Everything that decides how training goes on, as a tree of arrays and numbers."""
        return {
            "step": self.step,
            **({} if self._index is None else {"index": self._index}),
            "model": to_tree(self.model.state_dict()),
            "average": to_tree(self.average.state_dict()),
            "optimiser": to_tree(self.optimiser.state_dict()),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Put `state` back, bit for bit."""
        self.step = state["step"]
        self._index = state.get("index")
        self.model.load_state_dict(from_tree(state["model"]))
        self.average.load_state_dict(from_tree(state["average"]))
        self.optimiser.load_state_dict(from_tree(state["optimiser"]))


def on_gpu(frames: Tensor, device: str) -> Tensor:
    """The training videos in the memory of the GPU, if `device` is one and they fit well; else as they are."""
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
    """Train to the last step, from the checkpoint if the run resumes one.

    Of several processes, the main one alone evaluates and keeps checkpoints and the curve.

    Args:
        evaluate: Maps the averaged network to held-out metrics.

    Returns:
        The curve: one value an evaluation of `step`, of `seconds` since the one before (the evaluation included), of
        the training losses and of each held-out metric.

    Raises:
        Interrupted: By the keyboard; the checkpoint was kept.
        UsageError: Where it is measured, the training has diverged.
    """
    config = training.config
    curve: dict[str, list[float]] = {}
    before, since = 0.0, time.monotonic()
    if (state := checkpoints.start()) is not None:
        training.restore(state["training"])
        curve, before = state["curve"], state["seconds"]
    main = run.processes.main
    run.processes.ready(training.step)
    held = {name: values[-1] for name, values in curve.items() if name.startswith("held_out/")}

    def spent() -> float:
        """Seconds since the last evaluation, those before a resumed run's checkpoint included."""
        return before + time.monotonic() - since

    def measure(losses: dict[str, Tensor]) -> None:
        nonlocal before, since
        if not all(math.isfinite(value) for value in losses.values()):
            raise UsageError(
                f"--learning-rate {config.learning_rate:g}: after {training.step} steps the losses are no finite "
                "numbers any more: train with a lower one"
            )
        held.update({f"held_out/{name}": value for name, value in evaluate(training.average).items()})
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
    return curve


def held_out_count(demonstrations: int, wanted: int) -> int:
    """Demonstrations never trained on, the file's last: `wanted`, but at most a fifth and at least two."""
    return max(min(wanted, demonstrations // 5), 2)
