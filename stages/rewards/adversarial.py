"""GAIL and third-person imitation learning (TPIL) on images: a discriminator learns to classify expert and learner.

The discriminator of GAIL (Ho and Ermon, 2016) observes pairs of frames two frames apart. It does not account for
contexts: if the expert was recorded in other contexts, it can identify the expert by the context instead of the
behavior. The discriminator of TPIL (Stadie, Abbeel and Sutskever, 2017) observes pairs of frames three frames apart.
A second head with gradient reversal trains its features to contain no information about the context. So that "expert"
does not become equivalent to "other context", TPIL also learns from videos of unskilled behavior in the contexts of the
demonstrations.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from stages.environments.timing import Timing
from stages.rewards.discriminators import GailDiscriminator, TpilDiscriminator, expert_loss, frozen
from stages.rewards.frames import FrameReward
from stages.runtime.seeding import generator, integer
from stages.runtime.trees import check_optimiser, from_tree, to_tree
from stages.translation.networks import to_images

BATCH = 64  # pairs of frames per source and step
REMEMBERED = 4  # number of recent iterations whose learner frames train the discriminator
CLIP = 5.0  # logits are clipped to [-CLIP, CLIP]
DOMAIN_WEIGHT = 0.5  # weight of the domain head's loss relative to the expert head's loss


@dataclass(frozen=True)
class Schedule:
    """Training schedule of a discriminator.

    Attributes:
        steps: Optimizer steps after each iteration of the learner.
        rate: Learning rate of Adam.
    """

    steps: int
    rate: float


class AdversarialReward(FrameReward):
    """Reward of n environments: the logit log D - log(1 - D) that a pair of frames is the expert's, in [-5, 5].

    The discriminator is trained between iterations of the learner. During an iteration, its weights are fixed.
    """

    lag: int  # distance between the two frames of a pair, in frames

    def __init__(
        self,
        timing: Timing,
        experts: np.ndarray,
        schedule: Schedule,
        seed: int,
        device: str = "cpu",
    ):
        """Discriminate the frames of episodes with this `timing` from the videos `experts` (N, T, H, W, 3), uint8."""
        super().__init__(timing)
        self._experts, self._schedule, self._seed, self._device = experts, schedule, seed, device
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(integer(seed, "discriminator"))
            self._model = self.make((experts.shape[2], experts.shape[3])).to(device)
        self._judging = frozen(self._model)
        self._optimiser = torch.optim.Adam(self._model.parameters(), lr=schedule.rate, betas=(0.5, 0.99))
        self._running: dict[int, np.ndarray] = {}
        self._ended: list[np.ndarray] = []
        self._memory: list[np.ndarray] = []
        self._iteration = 0
        self._right = float("nan")

    @abstractmethod
    def make(self, size: tuple[int, int]) -> nn.Module:
        """Make a new discriminator for frames of `size` (H, W)."""

    @abstractmethod
    def loss(self, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Loss of one step and logits (B,) of the expert head, of which the first BATCH are for expert pairs."""

    @torch.no_grad()
    def judge(self, frame: int, drawn: np.ndarray) -> np.ndarray:
        if frame in self._running:  # The next round of episodes has begun.
            self._end_round()
        self._running[frame] = drawn
        before = self._running[max(frame - self.lag, 1)]
        logits = self._judging(self.images(before), self.images(drawn))
        return logits.clamp(-CLIP, CLIP).double().cpu().numpy()

    def images(self, frames: np.ndarray) -> Tensor:
        """Convert uint8 frames (n, H, W, 3) to images (n, 3, H, W)."""
        return to_images(torch.from_numpy(np.ascontiguousarray(frames)).to(self._device))

    def pairs(self, rng: np.random.Generator, videos: np.ndarray) -> tuple[Tensor, Tensor]:
        """Draw a batch of pairs of images (BATCH, 3, H, W) from videos (N, T, H, W, 3), without their frame 0."""
        chosen = rng.integers(len(videos), size=BATCH)
        after = rng.integers(1, videos.shape[1], size=BATCH)
        return self.images(videos[chosen, np.maximum(after - self.lag, 1)]), self.images(videos[chosen, after])

    def learner_pairs(self, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Draw a batch of pairs, as `pairs` does, from the learner's recent frames."""
        return self.pairs(rng, self._memory[rng.integers(len(self._memory))])

    def _end_round(self) -> None:
        """Keep the videos (n, T, H, W, 3) of the episodes that ran in lockstep."""
        first = next(iter(self._running.values()))
        self._ended.append(np.stack([self._running.get(frame, first) for frame in range(self._timing.frames)], axis=1))
        self._running = {}

    def iterate(self) -> None:
        """End an iteration of the learner: remember its frames, then train the discriminator."""
        self._end_round()
        self._memory = [*self._memory, np.concatenate(self._ended)][-REMEMBERED:]
        self._ended = []
        rng = generator(self._seed, "discriminator-batches", self._iteration)
        self._iteration += 1
        right = []
        for _ in range(self._schedule.steps):
            loss, logits = self.loss(rng)
            self._optimiser.zero_grad(set_to_none=True)
            loss.backward()
            self._optimiser.step()
            expert = torch.arange(len(logits), device=logits.device) < BATCH
            right.append(float(((logits > 0) == expert).float().mean()))
        self._judging = frozen(self._model)
        self._right = float(np.mean(right))

    def terms(self) -> dict[str, float]:
        """Mean return, and `told`: accuracy of the discriminator on pairs during its last training."""
        return {**super().terms(), "told": self._right}

    def state(self) -> dict[str, Any]:
        return {
            "model": to_tree(self._model.state_dict()),
            "optimiser": to_tree(self._optimiser.state_dict()),
            "memory": list(self._memory),
            "iteration": self._iteration,
        }

    def restore(self, state: dict[str, Any]) -> None:
        self._model.load_state_dict(from_tree(state["model"]))
        self._optimiser.load_state_dict(from_tree(state["optimiser"]))
        check_optimiser(self._optimiser)
        self._memory = [np.array(seen) for seen in state["memory"]]
        self._iteration = int(state["iteration"])
        self._judging = frozen(self._model)


class GailReward(AdversarialReward):
    """GAIL on pairs of frames two frames apart, as in the paper."""

    lag = 2

    def make(self, size: tuple[int, int]) -> nn.Module:
        return GailDiscriminator(size)

    def loss(self, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        sources = self.pairs(rng, self._experts), self.learner_pairs(rng)
        logits = self._model(*(torch.cat(frames) for frames in zip(*sources, strict=True)))
        return expert_loss(logits, BATCH), logits


class TpilReward(AdversarialReward):
    """TPIL on pairs of frames three frames apart; needs unskilled videos in the contexts of the demonstrations."""

    lag = 3

    def __init__(self, *arguments: Any, unskilled: np.ndarray, **options: Any):
        """Extend `AdversarialReward` by videos `unskilled` (M, T, H, W, 3), uint8, of unskilled behavior."""
        super().__init__(*arguments, **options)
        self._unskilled = unskilled

    def make(self, size: tuple[int, int]) -> nn.Module:
        return TpilDiscriminator(size)

    def loss(self, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        sources = self.pairs(rng, self._experts), self.pairs(rng, self._unskilled), self.learner_pairs(rng)
        before, after = (torch.cat(frames) for frames in zip(*sources, strict=True))
        expert, domain = self._model.both(before, after)  # type: ignore[operator]
        # Frames from the demonstrations' contexts come first, and there are twice as many of them as of the learner.
        learner = (torch.arange(len(before), device=before.device) >= 2 * BATCH).float().repeat(2)
        told = F.binary_cross_entropy_with_logits(domain, learner, weight=1 + learner)
        return expert_loss(expert, BATCH) + DOMAIN_WEIGHT * told, expert
