"""Several processes that train together, as `accelerate launch` (or torchrun) starts them, on one machine or more.

Every process does the same on its own share of each step's groups, and their gradients are averaged. The main process
alone writes, prints and evaluates. What goes wrong is said once:

- Before training, all tell each other whether they are fit (`ready`, `failed`); the first that is not says why.
- In training, whoever fails says so and ends with an exit code that makes the launcher end the others, and what
  others notice of that (a lost connection) stays unsaid.

A process that leaves the word to another ends with exit code 0: by any other, the launcher might end the one that has
the word before it has spoken.
"""

from __future__ import annotations

import os
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from artifacts.errors import IfoError, Interrupted, PlatformError, UsageError

if TYPE_CHECKING:
    from torch import Tensor


class OtherFailed(IfoError):
    """Another process says what went wrong: this one ends in silence."""

    exit_code = 0


def process_count() -> int:
    """Processes that were launched together; one, where nobody launched several."""
    launched = {"RANK", "LOCAL_RANK", "WORLD_SIZE"} <= os.environ.keys()
    return int(os.environ["WORLD_SIZE"]) if launched else 1


def is_main() -> bool:
    """Whether this is the process that writes and prints."""
    return process_count() == 1 or os.environ["RANK"] == "0"


class Processes:
    """The processes of this run; by default there is just this one, and nothing here does anything.

    Attributes:
        count: How many there are.
        index: This one's number, from 0; 0 is the main process.
        here: How many run on this machine.
        device: This one's own torch device; empty: whatever --device says.
    """

    def __init__(self, count: int = 1, index: int = 0, here: int = 1, device: str = ""):
        self.count, self.index, self.here, self.device = count, index, here, device
        self._training = False

    @property
    def main(self) -> bool:
        """Whether this is the process that writes and prints."""
        return self.index == 0

    def share(self, groups: int) -> range:
        """The groups of a step that this process computes, of `groups`.

        Raises:
            UsageError: They cannot be shared out evenly.
        """
        if groups % self.count:
            raise UsageError(f"--groups {groups} with {self.count} processes: expected a multiple of {self.count}")
        return range(self.index, groups, self.count)

    def ready(self, step: int) -> None:
        """Wait until all processes are about to train on from `step`.

        Raises:
            OtherFailed: Another is not, and says why.
            UsageError: They are not at the same step.
        """
        if self.count == 1:
            return
        met = self._meet(0, step)
        self._training = True
        if any(code for code, _ in met):
            raise OtherFailed
        if len({at for _, at in met}) > 1:
            unlike = UsageError("--resume: the processes see different checkpoints; keep --out on a disk they share")
            raise _said_by_main(unlike, self.main)

    def failed(self, error: IfoError) -> bool:
        """Whether it is for this process to say `error`, which ends it."""
        if self.count == 1:
            return True
        if isinstance(error, OtherFailed):
            return False
        if self._training:
            return self.main or not isinstance(error, Interrupted)  # A keyboard interrupt reaches them all.
        return next(index for index, (code, _) in enumerate(self._meet(1, 0)) if code) == self.index

    def mean(self, values: Tensor) -> Tensor:
        """Mean of the processes' `values`, the same bits in each of them."""
        return values if self.count == 1 else self._together("reduce", values, reduction="mean")

    def finish(self) -> None:
        """Wait for all, and part: nothing is left to be done together."""
        if self.count > 1:
            from accelerate import PartialState

            self._meet(0, 0)
            PartialState().destroy_process_group()

    def _meet(self, code: int, step: int) -> list[list[int]]:
        """Every process's `code` and `step`, in their order."""
        import torch

        own = torch.tensor([[code, step]], device=self.device)
        return self._together("gather", own).tolist()

    def _together(self, operation: str, values: Tensor, **options: Any) -> Tensor:
        """One of accelerate's operations on all processes' values."""
        from accelerate.utils import operations

        try:
            return getattr(operations, operation)(values, **options)
        except RuntimeError as error:  # What torch makes of a lost connection.
            lost = PlatformError(
                "the connection to another process of this training is lost: see what that one said; where there is a "
                "checkpoint, --resume continues from it"
            )
            raise _said_by_main(lost, self.main) from error


def join(stage: str, device: str, shared: bool) -> Processes:
    """Meet the processes that were launched with this one, if any were.

    Args:
        stage: Name of the stage that they run.
        device: What --device says.
        shared: Whether the stage's work can be shared.

    Raises:
        PlatformError: accelerate or a GPU is missing.
        UsageError: The stage cannot be shared, or not on that device.
        OtherFailed: As above, in all but the main process.
    """
    count = process_count()
    if count == 1:
        return Processes()
    here = int(os.environ.get("LOCAL_WORLD_SIZE", count))
    try:
        on_cpu = _check(stage, device, shared, count, here)
    except IfoError as error:
        raise _said_by_main(error, is_main()) from error
    from accelerate import PartialState

    state = PartialState(cpu=on_cpu)
    return Processes(state.num_processes, state.process_index, here, "cpu" if on_cpu else str(state.device))


def _check(stage: str, device: str, shared: bool, count: int, here: int) -> bool:
    """Whether `count` processes, `here` of them on this machine, share the stage's work on the CPU; or raise."""
    if not shared:
        raise UsageError(f"{stage} runs in one process, expected no launcher of {count}")
    if find_spec("accelerate") is None:
        raise PlatformError(f"{count} processes train together by accelerate: pip install 'ifo[accelerate]'")
    if device.startswith("cuda:"):
        raise UsageError(
            f"--device {device} with {count} processes: each takes a GPU of its own; leave it out, or choose by "
            "CUDA_VISIBLE_DEVICES"
        )
    import torch

    from stages.runtime.devices import pick_device

    asked_of_launcher = os.environ.get("ACCELERATE_USE_CPU", "").lower() in ("1", "true", "yes")
    on_cpu = pick_device("cpu" if device == "auto" and asked_of_launcher else device) == "cpu"
    if not on_cpu and here > torch.cuda.device_count():
        raise PlatformError(
            f"{here} processes on a machine with {torch.cuda.device_count()} GPUs: launch as many as there are GPUs, "
            "or give --device cpu"
        )
    return on_cpu


def _said_by_main(error: IfoError, main: bool) -> IfoError:
    """What a process raises for an error that all of them meet: the error itself in the main one alone."""
    return error if main else OtherFailed(str(error))
