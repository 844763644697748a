"""Shared by the scripts here: run a command, read its evaluations, check that these are what their names say."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from artifacts import read_artifact
from stages.reporting.rows import Run, read_runs


def ifo(*words: object, out: Path) -> Path:
    """Run one command, unless its artifact is there already."""
    if not out.exists():
        command = [sys.executable, "-m", "ifo_cli.main", *map(str, words), "--out", str(out)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return out


def runs_of(evaluation: Path, options: Sequence[object] = ()) -> list[Run]:
    """The runs of an evaluation.

    Args:
        evaluation: The artifact.
        options: Of learn-policy, name and value in turn, that the runs must have been learned with.

    Raises:
        SystemExit: They were learned with others: a file has another's name.
    """
    runs = read_runs(read_artifact(evaluation, "evaluation"))
    for name, value in zip(options[::2], options[1::2], strict=True):
        key = str(name).removeprefix("--").replace("-", "_")
        for run in runs:
            found = run.recorded.get(key)
            if found != value and found != [value]:
                raise SystemExit(f"{evaluation}: learned with {key} {found}, expected {value}: remove it and try again")
    return runs
