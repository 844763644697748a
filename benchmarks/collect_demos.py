"""Frames a second of `ifo collect-demos TASK -n 3000`, the whole command: start, rollouts, drawing, files written.

    python benchmarks/collect_demos.py

The experts are barely trained, and failures are kept: what a video shows does not change what it costs. Prints one line
of JSON; `wanted` is what the command is held to for reach and push on two cores.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from stages.config.stages import TASKS

DEMOS, FRAMES = 3000, 25
WANTED = 2000.0


def ifo(*words: object) -> str:
    """Run one command; returns what it prints."""
    command = [sys.executable, "-m", "ifo_cli.main", *map(str, words), "--quiet"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def main() -> None:
    result: dict[str, object] = {"benchmark": "collect_demos", "demos": DEMOS, "wanted": WANTED}
    with tempfile.TemporaryDirectory() as folder:
        for task in TASKS:
            expert = ifo("train-expert", task, "--preset", "toy", "--out", Path(folder) / f"{task}.expert.h5")
            words = ("--expert", expert, "-n", DEMOS, "--contexts", "paper", "--keep-failures")
            start = time.perf_counter()
            demos = ifo("collect-demos", task, *words, "--out", Path(folder) / f"{task}.demos.h5")
            result[f"{task}_fps"] = round(DEMOS * FRAMES / (time.perf_counter() - start), 1)
            Path(demos).unlink()
    print(json.dumps(result))


if __name__ == "__main__":
    main()
