"""The training loop of the translator: batches of pairs, optimizer, averaged weights and checkpoints."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from stages.config.stages import LOSSES, TranslatorConfig
from stages.runtime.processes import Processes
from stages.runtime.seeding import generator, integer
from stages.runtime.trees import check_optimiser, from_tree, to_tree
from stages.translation.alignment import video_index
from stages.translation.augmentation import augmented
from stages.translation.best import BestWeights
from stages.translation.layers import DropoutLinear
from stages.translation.losses import LossWeights, translation_losses
from stages.translation.networks import NETWORKS, Translator, make_translator, to_images

WARM_UP = 200  # steps until the learning rate reaches its peak
FINAL_RATE = 0.02  # final learning rate of the cosine schedule, relative to the peak
GRADIENT_NORM = 50.0
ALIGN_AT = (0.2, 0.5)  # shares of the steps after which videos are aligned, and aligned again
GPU_SHARE = 0.5  # maximum share of the free GPU memory for training videos


class Batch(NamedTuple):
    """Videos of one group, with the arguments of `translation_losses`.

    Attributes:
        videos: Frames (V, K, 3, H, W) in [-1, 1].
        contexts: First frames (V, 3, H, W).
        sources: Source (V,) of each video in each pairing.
        reconstructed: Indices of the times at which L_rec is computed (None: all K).
        translated: Indices of the times at which L_trans is computed (None: all K).
    """

    videos: Tensor
    contexts: Tensor
    sources: list[Tensor]
    reconstructed: Tensor | None
    translated: Tensor | None


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
        threads: int = 1,
    ):
        """Start from newly initialized weights, or from those of another translator.

        Args:
            config: Training configuration.
            frames: Training demonstrations (N, T, H, W, 3), uint8; frame 0 of each is its context.
            seed: Seed of the run.
            device: Torch device.
            processes: Processes that share the groups of each step (None: only this process).
            weights: Weights to start from, for `config.arch` and this frame size (None: newly initialized).
            threads: Number of groups to compute in parallel, at most `parallel_groups`. It does not change the result
                if torch uses equally many threads within each of them.

        Raises:
            UsageError: The number of groups is not a multiple of the number of processes.
        """
        self._processes = processes or Processes()
        self._groups = self._processes.share(config.groups)
        self._pool = ThreadPoolExecutor(threads, "group") if threads > 1 else None
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
        first, *others = self._in_threads() if self._pool else [self._backward(group) for group in self._groups]
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
        with self._dropout(group):
            total, losses = self._forward(group)
        total.backward()
        return losses

    def _in_threads(self) -> list[Tensor]:
        """Compute all groups of this process in parallel, and add up their gradients in the order of the groups.

        Torch computes a backward pass on the CPU in the thread that asks for it, and releases Python's lock in each of
        its functions, so that threads use the cores nearly as well as processes would, without copies of the weights.

        Returns:
            The losses (3,) of each group.
        """
        parameters = [parameter for parameter in self.model.parameters() if parameter.requires_grad]

        def differentiated(group: int) -> tuple[tuple[Tensor | None, ...], Tensor]:
            total, losses = self._forward(group)
            return torch.autograd.grad(total, parameters, allow_unused=True), losses

        assert self._pool is not None
        found = []
        for gradients, losses in self._pool.map(differentiated, self._groups):
            for parameter, gradient in zip(parameters, gradients, strict=True):
                if gradient is not None:
                    parameter.grad = gradient if parameter.grad is None else parameter.grad.add_(gradient)
            found.append(losses)
        return found

    def _forward(self, group: int) -> tuple[Tensor, Tensor]:
        """The weighted loss of one group as its share of the mean over groups, and its three losses (3,), detached."""
        config = self.config
        batch = self._batch(group)
        use_amp = config.amp and self.device.startswith("cuda")
        with torch.autocast("cuda", torch.bfloat16, enabled=use_amp):
            losses = self._losses(
                self.model,
                batch.videos,
                batch.contexts,
                batch.sources,
                config.motion_weight,
                batch.reconstructed,
                batch.translated,
            )
            total = (
                self._weights.trans * losses["trans"]
                + self._weights.rec * losses["rec"]
                + self._weights.align * losses["align"]
            )
        return total / len(self._groups), torch.stack([losses[name].detach() for name in LOSSES]).double()

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

    def _batch(self, group: int = 0) -> Batch:
        """What a step trains one group on."""
        config = self.config
        rng = generator(self.seed, "batch", self.step, *([group] if group else []))
        count, length = self._frames.shape[:2]
        chosen = rng.choice(count, min(config.videos, count), replace=False)
        moments = 1 + rng.choice(length - 1, min(config.frames, length - 1), replace=False)
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
        reconstructed = translated = None
        times = np.arange(len(moments))
        if 0 < config.rec_frames < len(moments):
            own = rng.choice(len(moments), config.rec_frames, replace=False)
            reconstructed, times = self._sent(own), np.setdiff1d(times, own)
        if 0 < config.trans_frames < len(moments):
            # Times that are not reconstructed, if there are enough.
            among = times if len(times) >= config.trans_frames else len(moments)
            translated = self._sent(rng.choice(among, config.trans_frames, replace=False))
        return Batch(images[:, 1:], images[:, 0], sources, reconstructed, translated)

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


def parallel_groups(config: TranslatorConfig, device: str, groups: int) -> int:
    """Number of groups, out of `groups` per step, that threads can compute in parallel; 1: one after another.

    Groups are not parallel on a GPU, which one group keeps busy, nor if they are compiled, nor with dropout, because
    its random numbers come from the generator that all threads share.
    """
    drops = getattr(NETWORKS[config.arch], "DROPOUT", 0.0) > 0
    return groups if device == "cpu" and not config.compile and not drops else 1


def on_gpu(frames: Tensor, device: str) -> Tensor:
    """Move the training videos to GPU memory if `device` is a GPU and they need at most GPU_SHARE of its free memory.

    Otherwise, the videos are returned unchanged.
    """
    if device.startswith("cuda") and frames.nbytes <= GPU_SHARE * torch.cuda.mem_get_info(device)[0]:
        return frames.to(device)
    return frames
