"""Checkpoints of long-running stages: one file next to the artifact, removed when the artifact is written."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from artifacts import (
    Artifact,
    ArtifactError,
    Interrupted,
    UsageError,
    checkpoint_path,
    is_unchanged,
    read_artifact,
    read_checkpoint,
    remove_checkpoint,
    write_checkpoint,
)
from artifacts.paths import is_missing
from stages.runtime.run import RunOptions


class Checkpoints:
    """The checkpoint of one run of a stage.

    Attributes:
        config: The complete configuration of the run.
    """

    def __init__(
        self, run: RunOptions, out: Path, stage: str, config: dict[str, Any], parents: Sequence[Path | Artifact]
    ):
        self._run, self._out, self._stage, self.config = run, out, stage, config
        # Opened only once, so that digests are not computed again and a file that replaces a parent is not recorded.
        self._parents = [parent if isinstance(parent, Artifact) else read_artifact(parent) for parent in parents]
        self._path = checkpoint_path(out)
        self._others = _identity(self._path)

    def start(self) -> Any:
        """Return the state to continue from: the checkpoint's if `run.resume` is set and it exists, otherwise None.

        Raises:
            UsageError: The checkpoint was written with another configuration, seed or input.
        """
        if not self._run.resume:
            return None
        if is_missing(self._path):
            self._run.progress.say(f"no checkpoint next to {self._out}: starting from the beginning")
            return None
        manifest, state = read_checkpoint(self._path, stage=self._stage)
        found = manifest.config
        other = sorted(key for key in found.keys() | self.config.keys() if found.get(key) != self.config.get(key))
        if manifest.seed != self._run.seed:
            other.append("seed")
        if len(manifest.parents) != len(self._parents) or not all(map(is_unchanged, manifest.parents, self._parents)):
            other.append("input file")
        if other:
            raise UsageError(
                f"--resume: {self._path} was written with another {', '.join(other)}; use the same, or omit --resume"
            )
        self._others = None
        self._run.progress.say(f"resuming {self._out.name} from {self._path.name}")
        return state

    @contextmanager
    def restoring(self) -> Iterator[None]:
        """Report what fails in the block, which restores a state, as the fault of the checkpoint.

        Raises:
            ArtifactError: The state is not one that the stage wrote.
        """
        try:
            yield
        except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
            reason = " ".join(str(error).split())[:200]
            raise ArtifactError(
                f"{self._path} does not hold a state of {self._stage} ({reason}): start again without --resume"
            ) from error

    def save(self, state: Any) -> None:
        """Write the checkpoint atomically; `state` is a tree of arrays and plain values."""
        write_checkpoint(
            self._path,
            state,
            stage=self._stage,
            config=self.config,
            seed=self._run.seed,
            command=self._run.command,
            parents=self._parents,
        )

    def interrupted(self, done: str) -> Interrupted:
        """Return the exception to raise after a keyboard interrupt; `done` describes the stage's progress."""
        # Look at the file itself: the interrupt may have come between writing the checkpoint and recording that.
        if _identity(self._path) in (None, self._others):
            return Interrupted(f"interrupted after {done}; there is no checkpoint yet")
        again = self._run.command if self._run.resume else f"{self._run.command} --resume"
        return Interrupted(f"interrupted after {done}; kept {self._path}; continue with: {again}")

    def remove(self) -> None:
        """Remove the checkpoint, after the artifact is written."""
        remove_checkpoint(self._out)


def curve_of(state: Any) -> dict[str, list[float]]:
    """Return a learning curve that a checkpoint holds: name -> values. Call it within `Checkpoints.restoring`."""
    return {str(name): [float(value) for value in values] for name, values in state.items()}


def _identity(path: Path) -> tuple[int, int] | None:
    """Return what distinguishes a file from one that replaces it; None: there is no file."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns
