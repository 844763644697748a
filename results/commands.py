"""What the scripts here share: running a command, and naming what it made."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def ifo(*words: object, out: Path) -> Path:
    """Run one command, unless its artifact is there already."""
    if not out.exists():
        command = [sys.executable, "-m", "ifo_cli.main", *map(str, words), "--out", str(out)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return out
