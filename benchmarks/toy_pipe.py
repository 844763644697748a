"""How long the toy pipeline takes, beside another commit's.

    python benchmarks/toy_pipe.py --against REVISION

Runs the five stages of preset toy, from no expert on, by this tree and by REVISION alternately, each in a new folder,
and prints one JSON line: the fastest of --rounds runs of each in seconds, and the ratio (below 1: this tree is faster).
Without --against only this tree is timed. The last figure is a second run of the same commands in the same folder,
which keeps every artifact.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
IFO = f"{shlex.quote(sys.executable)} -m ifo_cli.main"
STAGES = ("collect-demos reach --preset toy", "train-translator", "translate", "learn-policy", "evaluate")
PIPELINE = " | ".join(f"{IFO} {stage}" for stage in STAGES)


def seconds(code: Path, folder: Path) -> float:
    """Of the pipeline of the tree `code`, run in `folder`."""
    environment = {**os.environ, "PYTHONPATH": str(code)}
    start = time.monotonic()
    subprocess.run(["bash", "-o", "pipefail", "-c", PIPELINE], cwd=folder, env=environment, check=True, stdout=2)
    return time.monotonic() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--against", help="the commit to compare with")
    parser.add_argument("--rounds", type=int, default=2)
    options = parser.parse_args()
    spent: dict[str, list[float]] = {"now": [], "before": [], "kept": []}
    with tempfile.TemporaryDirectory() as temporary:
        before = Path(temporary, "tree")
        if options.against:
            subprocess.run(["git", "worktree", "add", "-q", "--detach", before, options.against], cwd=ROOT, check=True)
        try:
            for k in range(options.rounds):
                for name, code in {"before": before, "now": ROOT}.items():
                    if not code.exists():
                        continue
                    folder = Path(temporary, f"{name}-{k}")
                    folder.mkdir()
                    spent[name].append(seconds(code, folder))
                spent["kept"].append(seconds(ROOT, folder))
        finally:
            if options.against:
                subprocess.run(["git", "worktree", "remove", "--force", before], cwd=ROOT, check=True)
    line = {"benchmark": "toy_pipe", **{f"{name}_s": round(min(runs), 2) for name, runs in spent.items() if runs}}
    if spent["before"]:
        line |= {"against": options.against, "ratio": round(min(spent["now"]) / min(spent["before"]), 3)}
    print(json.dumps(line | {"load": round(os.getloadavg()[0], 1)}))


if __name__ == "__main__":
    main()
