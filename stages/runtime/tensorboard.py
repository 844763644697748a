"""Scalars for TensorBoard, in a folder beside the artifact."""

from __future__ import annotations

import math
import os
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from artifacts import PlatformError

_usual = threading.excepthook


class TensorBoard:
    """Writes scalars; what an earlier run left beyond step `done` is hidden.

    Raises:
        PlatformError: The folder cannot be written; of its methods, all.
    """

    def __init__(self, folder: Path, done: int = 0):
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
        from torch.utils.tensorboard import SummaryWriter

        self._folder = folder
        threading.excepthook = _heed
        made = not folder.exists()
        try:
            with self._writing():
                self._writer = SummaryWriter(str(folder), purge_step=done + 1 if done else 0)
        except PlatformError:
            if made:
                shutil.rmtree(folder, ignore_errors=True)
            raise

    def write(self, step: int, row: dict[str, float]) -> None:
        with self._writing():
            for name, value in row.items():
                if math.isfinite(value):
                    self._writer.add_scalar(name, value, step)

    def __enter__(self) -> TensorBoard:
        return self

    def __exit__(self, *exc_info: object) -> None:
        with self._writing():
            self._writer.close()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            reason = error.strerror or str(error)
            raise PlatformError(
                f"{self._folder}: cannot be written ({reason}): free some room or choose another place"
            ) from error


def _heed(what: threading.ExceptHookArgs) -> None:
    """As ever, but for TensorBoard's own thread: what it fails to write is raised again by whoever asked for it."""
    if type(what.thread).__name__ != "_AsyncWriterThread" or not isinstance(what.exc_value, OSError):
        _usual(what)
