"""GAIL and third-person imitation (TPIL) on images: a discriminator learns to tell the learner from the expert.

GAIL (Ho and Ermon, 2016) sees pairs of frames two apart; it knows nothing of contexts, so that where the expert was
filmed in others it can tell the two apart without looking at what they do. TPIL (Stadie, Abbeel and Sutskever, 2017)
sees frames three apart through features that a second head, behind a gradient reversal, must not tell the context
from; so that "expert" does not mean "another context", it also learns from videos of somebody unskilled in the
demonstrations' contexts.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from stages.rewards.discriminators import GailDiscriminator, TpilDiscriminator, expert_loss, frozen
from stages.rewards.frames import FrameReward
from stages.runtime.seeding import generator, integer
from stages.runtime.trees import from_tree, to_tree
from stages.simulation.contexts import Contexts
from stages.simulation.render import RenderPool
from stages.simulation.task import Task
from stages.translation.networks import to_images

BATCH = 64  # pairs of frames of each source, a step
REMEMBERED = 4  # iterations whose frames of the learner the discriminator learns from
CLIP = 5.0  # logits beyond this say no more
DOMAIN_WEIGHT = 0.5  # of the domain head's loss beside the expert head's


@dataclass(frozen=True)
class Schedule:
    """How a discriminator learns.

    Attributes:
        steps: Optimiser steps after each of the learner's iterations.
        rate: Adam's learning rate.
    """

    steps: int
    rate: float


class AdversarialReward(FrameReward):
    """Reward of n simulations: the logit of a pair of frames being the expert's, log D - log(1 - D), in [-5, 5].

    The discriminator learns between the learner's iterations, and judges with weights that stand still during one.
    """

    lag: int  # frames between the two of a pair

    def __init__(
        self,
        task: Task,
        context: Contexts,
        pool: RenderPool,
        experts: np.ndarray,
        schedule: Schedule,
        seed: int,
        device: str = "cpu",
    ):
        """Learn to tell frames of `context` from those of `experts` (N, T, H, W, 3), uint8."""
        super().__init__(task, context, pool)
        self._experts, self._schedule, self._seed, self._device = experts, schedule, seed, device
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(integer(seed, "discriminator"))
            self._model = self.make(task.frame_size).to(device)
        self._judging = frozen(self._model)
        self._optimiser = torch.optim.Adam(self._model.parameters(), lr=schedule.rate, betas=(0.5, 0.99))
        self._running: dict[int, np.ndarray] = {}
        self._memory: list[np.ndarray] = []
        self._iteration = 0
        self._right = float("nan")

    @abstractmethod
    def make(self, size: tuple[int, int]) -> nn.Module:
        """A fresh discriminator of frames of `size` (H, W)."""

    @abstractmethod
    def loss(self, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """The loss of one step, and the expert head's logits (B,), those of BATCH of the expert's pairs first."""

    @torch.no_grad()
    def judge(self, frame: int, drawn: np.ndarray) -> np.ndarray:
        self._running[frame] = drawn
        before = self._running[max(frame - self.lag, 1)]
        logits = self._judging(self.images(before), self.images(drawn))
        return logits.clamp(-CLIP, CLIP).double().cpu().numpy()

    def images(self, frames: np.ndarray) -> Tensor:
        """Frames (n, H, W, 3), uint8 -> images (n, 3, H, W)."""
        return to_images(torch.from_numpy(np.ascontiguousarray(frames)).to(self._device))

    def pairs(self, rng: np.random.Generator, videos: np.ndarray) -> tuple[Tensor, Tensor]:
        """A batch of pairs of frames (BATCH, 3, H, W) from videos (N, T, H, W, 3), whose frame 0 is never shown."""
        chosen = rng.integers(len(videos), size=BATCH)
        after = rng.integers(1, videos.shape[1], size=BATCH)
        return self.images(videos[chosen, np.maximum(after - self.lag, 1)]), self.images(videos[chosen, after])

    def learner_pairs(self, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """As `pairs`, from what the learner did lately."""
        return self.pairs(rng, self._memory[rng.integers(len(self._memory))])

    def iterate(self) -> None:
        """End an iteration of the learner: remember its frames, and learn to tell them from the expert's."""
        first = next(iter(self._running.values()))
        seen = np.stack([self._running.get(frame, first) for frame in range(self._task.frames)], axis=1)
        self._memory = [*self._memory, seen][-REMEMBERED:]
        self._running = {}
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
        """The mean return, and `told`: the share of pairs that the discriminator got right when it last learned."""
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
        self._memory = [np.array(seen) for seen in state["memory"]]
        self._iteration = int(state["iteration"])
        self._judging = frozen(self._model)


class GailReward(AdversarialReward):
    """GAIL on pairs of frames two apart, as the paper ran it."""

    lag = 2

    def make(self, size: tuple[int, int]) -> nn.Module:
        return GailDiscriminator(size)

    def loss(self, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        sources = self.pairs(rng, self._experts), self.learner_pairs(rng)
        logits = self._model(*(torch.cat(frames) for frames in zip(*sources, strict=True)))
        return expert_loss(logits, BATCH), logits


class TpilReward(AdversarialReward):
    """TPIL on pairs of frames three apart; needs videos of somebody unskilled in the demonstrations' contexts."""

    lag = 3

    def __init__(self, *arguments: Any, unskilled: np.ndarray, **options: Any):
        """As `AdversarialReward`; `unskilled` are videos (M, T, H, W, 3), uint8, like the experts' but unskilled."""
        super().__init__(*arguments, **options)
        self._unskilled = unskilled

    def make(self, size: tuple[int, int]) -> nn.Module:
        return TpilDiscriminator(size)

    def loss(self, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        sources = self.pairs(rng, self._experts), self.pairs(rng, self._unskilled), self.learner_pairs(rng)
        before, after = (torch.cat(frames) for frames in zip(*sources, strict=True))
        expert, domain = self._model.both(before, after)  # type: ignore[operator]
        # Frames of the demonstrations' contexts come first; two of them to one of the learner's.
        learner = (torch.arange(len(before), device=before.device) >= 2 * BATCH).float().repeat(2)
        told = F.binary_cross_entropy_with_logits(domain, learner, weight=1 + learner)
        return expert_loss(expert, BATCH) + DOMAIN_WEIGHT * told, expert
