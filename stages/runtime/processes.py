"""Several processes that train together, started by `accelerate launch` or torchrun, on one or more machines.

Each process computes its own share of the groups of a step, and the gradients are averaged. Only the main process
writes, prints and evaluates. Each error is reported once:

- Before training, all processes exchange whether they are ready (`ready`, `failed`); the first one that is not reports
  why.
- During training, a process that fails reports the error and ends with an exit code that makes the launcher end the
  other processes. Those do not report the lost connection that they notice.

A process that leaves the report to another one ends with exit code 0. With any other code, the launcher might end the
reporting process too early.
"""

from __future__ import annotations

import os
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from artifacts.errors import IfoError, Interrupted, PlatformError, UsageError

if TYPE_CHECKING:
    from torch import Tensor


class OtherFailed(IfoError):
    """Another process reports the error; this process ends silently."""

    exit_code = 0


def process_count() -> int:
    """Return the number of processes that were launched together; 1 without a launcher."""
    launched = {"RANK", "LOCAL_RANK", "WORLD_SIZE"} <= os.environ.keys()
    return int(os.environ["WORLD_SIZE"]) if launched else 1


def is_main() -> bool:
    """Return whether this is the process that writes and prints."""
    return process_count() == 1 or os.environ["RANK"] == "0"


class Processes:
    """The processes of this run. By default there is only this one, and all methods are no-ops.

    Attributes:
        count: Number of processes.
        index: Index of this process, from 0; 0 is the main process.
        here: Number of processes on this machine.
        device: Torch device of this process; empty: the device given by --device.
    """

    def __init__(self, count: int = 1, index: int = 0, here: int = 1, device: str = ""):
        self.count, self.index, self.here, self.device = count, index, here, device
        self._training = False

    @property
    def main(self) -> bool:
        """Whether this is the process that writes and prints."""
        return self.index == 0

    def share(self, groups: int) -> range:
        """Return the indices of the groups of a step, out of `groups`, that this process computes.

        Raises:
            UsageError: The groups cannot be shared evenly.
        """
        if groups % self.count:
            raise UsageError(f"--groups {groups} with {self.count} processes: expected a multiple of {self.count}")
        return range(self.index, groups, self.count)

    def ready(self, step: int) -> None:
        """Wait until all processes are ready to train from `step` on.

        Raises:
            OtherFailed: Another process is not ready, and reports why.
            UsageError: The processes are not at the same step.
        """
        if self.count == 1:
            return
        met = self._meet(0, step)
        self._training = True
        if any(code for code, _ in met):
            self._leave()
            raise OtherFailed
        if len({at for _, at in met}) > 1:
            self._leave()
            unlike = UsageError("--resume: the processes see different checkpoints; put --out on a shared disk")
            raise _said_by_main(unlike, self.main)

    def failed(self, error: IfoError) -> bool:
        """Return whether this process must report `error`, which ends it."""
        if self.count == 1:
            return True
        if isinstance(error, OtherFailed):
            return False
        if self._training:
            return self.main or not isinstance(error, Interrupted)  # A keyboard interrupt reaches all processes.
        first = next(index for index, (code, _) in enumerate(self._meet(1, 0)) if code)
        self._leave()
        return first == self.index

    def mean(self, values: Tensor) -> Tensor:
        """Return the mean of `values` over all processes, bit for bit the same in each process."""
        return values if self.count == 1 else self._together("reduce", values, reduction="mean")

    def finish(self) -> None:
        """Wait for all processes, then leave the process group."""
        if self.count > 1:
            self._meet(0, 0)
            self._leave()

    def _leave(self) -> None:
        """Leave the process group, which ends its threads."""
        from accelerate import PartialState

        PartialState().destroy_process_group()

    def _meet(self, code: int, step: int) -> list[list[int]]:
        """Return `code` and `step` of every process, in the order of their indices."""
        import torch

        own = torch.tensor([[code, step]], device=self.device)
        return self._together("gather", own).tolist()

    def _together(self, operation: str, values: Tensor, **options: Any) -> Tensor:
        """Apply one of accelerate's operations to the values of all processes."""
        from accelerate.utils import operations

        try:
            return getattr(operations, operation)(values, **options)
        except RuntimeError as error:  # torch raises this if the connection is lost.
            lost = PlatformError(
                "the connection to another process of this training is lost: see the message of that process; if there "
                "is a checkpoint, --resume continues from it"
            )
            raise _said_by_main(lost, self.main) from error


def join(stage: str, device: str, shared: bool) -> Processes:
    """Join the processes that were launched together with this one, if any.

    Args:
        stage: Name of the stage that they run.
        device: Value of --device.
        shared: Whether several processes can run the stage together.

    Raises:
        PlatformError: accelerate or a GPU is missing.
        UsageError: Several processes cannot run the stage, or not on that device.
        OtherFailed: One of the above, in all processes except the main process.
    """
    count = process_count()
    if count == 1:
        return Processes()
    here = int(os.environ.get("LOCAL_WORLD_SIZE", count))
    try:
        on_cpu = _check(stage, device, shared, count, here)
    except IfoError as error:
        raise _said_by_main(error, is_main()) from error
    # Default arguments of this module are the process group that exists when it is first imported. Imported later, it
    # would keep the group and its threads until the interpreter ends, where they may end the process with SIGABRT.
    import torch.distributed.nn.functional  # noqa: F401
    from accelerate import PartialState

    state = PartialState(cpu=on_cpu)
    return Processes(state.num_processes, state.process_index, here, "cpu" if on_cpu else str(state.device))


def _check(stage: str, device: str, shared: bool, count: int, here: int) -> bool:
    """Return whether the processes (`count`, of them `here` on this machine) train on the CPU; raise if they cannot."""
    if not shared:
        raise UsageError(f"{stage} runs in one process, but a launcher started {count}: run it without a launcher")
    if find_spec("accelerate") is None:
        raise PlatformError(f"{count} processes need accelerate to train together: pip install 'ifo[accelerate]'")
    if device.startswith("cuda:"):
        raise UsageError(
            f"--device {device} with {count} processes: each process uses its own GPU; leave --device out, or select "
            "GPUs with CUDA_VISIBLE_DEVICES"
        )
    import torch

    from stages.runtime.devices import pick_device

    asked_of_launcher = os.environ.get("ACCELERATE_USE_CPU", "").lower() in ("1", "true", "yes")
    on_cpu = pick_device("cpu" if device == "auto" and asked_of_launcher else device) == "cpu"
    if not on_cpu and here > torch.cuda.device_count():
        raise PlatformError(
            f"{here} processes on a machine with {torch.cuda.device_count()} GPUs: launch at most one per GPU, or give "
            "--device cpu"
        )
    return on_cpu


def _said_by_main(error: IfoError, main: bool) -> IfoError:
    """Return what to raise for an error that occurs in all processes: the error itself only in the main process."""
    return error if main else OtherFailed(str(error))
