"""Every benchmark still runs, and prints one JSON line of its name."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.gl]
ROOT = Path(__file__).parent.parent
WORDS = {
    "learn_cost": ["--iterations", "1"],
    "translator_cost": ["--steps", "2"],
    "translator_learning": ["--minutes", "0.3", "--points", "1"],
}


@pytest.fixture(scope="module")
def demos(tmp_path_factory):
    """Enough demonstrations to hold some out."""
    path = tmp_path_factory.mktemp("demos") / "reach.demos.h5"
    words = ("collect-demos", "reach", "--preset", "toy", "-n", "400", "--out", path)
    subprocess.run([sys.executable, "-m", "ifo_cli.main", *words], check=True, cwd=ROOT, timeout=300)
    return path


@pytest.mark.parametrize("path", sorted((ROOT / "benchmarks").glob("*.py")), ids=lambda path: path.stem)
def test_prints_one_json_line(path, demos):
    words = [*WORDS.get(path.stem, []), *([demos] if path.stem == "translator_learning" else [])]
    done = subprocess.run([sys.executable, path, *words], capture_output=True, text=True, cwd=ROOT, timeout=900)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("\n") == 1
    assert json.loads(done.stdout)["benchmark"] == path.stem
