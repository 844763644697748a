"""Scalars for TensorBoard, in a folder beside the artifact."""

from __future__ import annotations

import math
import os
from pathlib import Path


class TensorBoard:
    """Writes scalars; what an earlier run left beyond step `done` is hidden."""

    def __init__(self, folder: Path, done: int = 0):
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
        from torch.utils.tensorboard import SummaryWriter

        self._writer = SummaryWriter(str(folder), purge_step=done + 1 if done else 0)

    def write(self, step: int, row: dict[str, float]) -> None:
        for name, value in row.items():
            if math.isfinite(value):
                self._writer.add_scalar(name, value, step)

    def __enter__(self) -> TensorBoard:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._writer.close()
