"""Scalars, the configuration and pictures for TensorBoard, in a folder next to the artifact."""

from __future__ import annotations

import json
import math
import os
import shutil
import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from artifacts import PlatformError
from artifacts.usage import InUse


class TensorBoard:
    """Writer of scalars and pictures, used as a context manager.

    What an earlier run wrote after step `done` is hidden. The configuration is shown as text.

    Raises:
        PlatformError: The folder cannot be written. Every method may raise it.
    """

    def __init__(self, folder: Path, done: int = 0, config: Mapping[str, Any] | None = None):
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
        from torch.utils.tensorboard import SummaryWriter

        self._folder = folder
        made = not os.path.lexists(folder)
        with ExitStack() as stack:
            stack.enter_context(_silent_writer_thread())
            try:
                with self._writing():
                    self._writer = SummaryWriter(str(folder), purge_step=done + 1 if done else 0)
                    if config and not done:  # A resumed run has the same configuration.
                        self._writer.add_text("configuration", _code(config), 0)
            except PlatformError:
                if made:
                    shutil.rmtree(folder, ignore_errors=True)
                raise
            self._mark = InUse([folder])  # `ifo gc` neither removes it nor the checkpoint next to it.
            stack.callback(self._mark.end)
            self._on_exit = stack.pop_all()

    def write(self, step: int, row: dict[str, float]) -> None:
        with self._writing():
            for name, value in row.items():
                if math.isfinite(value):
                    self._writer.add_scalar(name, value, step)

    def show(self, step: int, name: str, picture: np.ndarray) -> None:
        """Write a picture (H, W, 3), uint8."""
        with self._writing():
            self._writer.add_image(name, picture, step, dataformats="HWC")

    def __enter__(self) -> TensorBoard:
        return self

    def __exit__(self, *exc_info: object) -> None:
        with self._on_exit, self._writing():
            self._writer.close()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except (OSError, UnicodeEncodeError) as error:  # TensorBoard takes only paths in UTF-8.
            reason = getattr(error, "strerror", None) or str(error)
            raise PlatformError(
                f"{self._folder}: cannot be written ({reason}): free some space or choose another location"
            ) from error


def _code(config: Mapping[str, Any]) -> str:
    """A configuration as JSON in a code block of Markdown, in which nothing is interpreted."""
    lines = json.dumps(config, indent=2, default=str).splitlines()
    return "\n".join(f"    {line}" for line in lines)


@contextmanager
def _silent_writer_thread() -> Iterator[None]:
    """Suppress OSErrors printed by TensorBoard's own thread in the block; the next write raises the error again."""
    usual = threading.excepthook

    def hook(what: threading.ExceptHookArgs) -> None:
        if type(what.thread).__name__ != "_AsyncWriterThread" or not isinstance(what.exc_value, OSError):
            usual(what)

    threading.excepthook = hook
    try:
        yield
    finally:
        if threading.excepthook is hook:
            threading.excepthook = usual
