"""One training by several processes, started by `accelerate launch`: on the CPU, as it would be on several GPUs."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from artifacts import Interrupted, checkpoint_path, read_artifact, write_artifact
from stages.config.stages import TranslatorConfig
from stages.runtime.run import RunOptions
from stages.train_translator import train_translator
from stages.translation.training import TranslatorTraining

pytest.importorskip("accelerate")
ROOT = Path(__file__).resolve().parents[2]
IFO = Path(sys.executable).with_name("ifo")
OPTIONS = {"steps": 6, "videos": 4, "frames": 2, "groups": 2, "ema": 0.9, "evaluate_every": 3, "checkpoint_every": 2}
WORDS = [word for name, value in OPTIONS.items() for word in (f"--{name.replace('_', '-')}", str(value))]

# What goes wrong in one of the two processes alone; `ifo` is started by the last line.
BROKEN = """
import os, sys
from artifacts import PlatformError
from stages.translation.training import TranslatorTraining
from stages.runtime.processes import Processes
where, step = sys.argv.pop(1), int(sys.argv.pop(1))

def broken(*_):
    raise PlatformError("this process's disk is full")

plain = TranslatorTraining.train_step
if os.environ["RANK"] == where and step:
    TranslatorTraining.train_step = lambda self: broken() if self.step == step else plain(self)
elif os.environ["RANK"] == where:
    TranslatorTraining.__init__ = broken
from ifo_cli.main import main
sys.exit(main())
"""

# `ifo`, then the names of the threads that are left. Those of the process group could abort the process as it ends.
THREADS = """
import os, sys
from pathlib import Path
from ifo_cli.main import main
code = main()
tasks = Path("/proc/self/task")
left = [(task / "comm").read_text().strip() for task in tasks.iterdir()] if tasks.exists() else []
sys.stderr.write(f"threads of rank {os.environ['RANK']}: {' '.join(left)}\\n")
sys.exit(code)
"""


@pytest.fixture(scope="module")
def demos(tmp_path_factory):
    """40 videos of a square that moves right, each on a background of its own."""
    rng = np.random.default_rng(0)
    frames = np.empty((40, 6, 16, 16, 3), np.uint8)
    frames[:] = rng.integers(0, 120, (40, 1, 1, 1, 3))
    for video, row in zip(frames, rng.integers(2, 11, 40), strict=True):
        for t in range(6):
            video[t, row : row + 4, 2 * t : 2 * t + 4] = 230
    return write_artifact(
        tmp_path_factory.mktemp("demos") / "squares.demos.h5",
        "demos",
        {"frames": frames, "final_distance": np.zeros(40, np.float32)},
        config={"stage": "collect-demos", "preset": "toy"},
        seed=7,
        command="ifo collect-demos",
        parents=[],
        environment={},
    )


@pytest.fixture(scope="module")
def alone(demos):
    """What one process makes of it."""
    out = demos.with_name("alone.translator.h5")
    train_translator(TranslatorConfig(**OPTIONS), RunOptions(seed=7, device="cpu", workers=1, out=out), demos)
    return read_artifact(out)


def launch(folder, program, *words, **options):
    """Start two processes of a program, on any machine the CPU's; returns the finished launcher."""
    flags = "--multi_gpu --num_processes 2 --num_machines 1 --mixed_precision no --dynamo_backend no"
    command = [sys.executable, "-m", "accelerate.commands.launch", *flags.split(), "--main_process_port", "0"]
    # No configuration of accelerate that whoever runs the tests may have.
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "HF_HOME": str(folder), "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        [*command, *program, *map(str, words)],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        **options,
    )


def train(folder, demos, *words, program=("-m", "ifo_cli")):
    return launch(folder, program, "train-translator", demos, "--preset", "toy", "--device", "cpu", *WORDS, *words)


def write_namesakes(folder):
    """Modules of the user's with the names of our packages, in the folder where the processes run."""
    (folder / "stages").mkdir()
    for name in ("artifacts.py", "stages/__init__.py"):
        (folder / name).write_text("raise RuntimeError('this is the user's own')\n")


def threads_left(done, processes):
    """Names of the threads that the processes had left at their end; `processes`: how many must say so."""
    lines = [line for line in done.stderr.splitlines() if line.startswith("threads of rank")]
    assert len(lines) >= processes, done.stderr
    return " ".join(lines)


def said(done):
    return [line for line in done.stderr.splitlines() if line.startswith("ifo: ")]


def assert_same(one, other):
    names = [name for name in one.names() if name.startswith(("weights/", "curve/")) and name != "curve/seconds"]
    assert names == [n for n in other.names() if n.startswith(("weights/", "curve/")) and n != "curve/seconds"]
    for name in names:
        np.testing.assert_allclose(other[name], one[name], rtol=1e-5, atol=1e-6, err_msg=name)


def test_two_processes_train_as_one_does_on_both_their_groups(tmp_path, demos, alone):
    script, out = tmp_path / "threads.py", tmp_path / "two.translator.h5"
    script.write_text(THREADS)
    done = train(tmp_path, demos, "--out", out, program=[str(script)])
    assert done.returncode == 0, done.stderr
    assert "gloo" not in threads_left(done, 2)
    assert done.stdout == f"{out}\n"
    assert [path.name for path in tmp_path.glob("*.h5")] == [out.name]
    assert done.stderr.count("translator: 6 steps") == 1
    together = read_artifact(out, "translator")
    assert together.manifest.environment["processes"] == "2"
    assert_same(alone, together)


def test_dropout_and_augmentation_are_a_groups_whoever_computes_it(tmp_path, demos):
    one, two = tmp_path / "one.translator.h5", tmp_path / "two.translator.h5"
    config = TranslatorConfig(**OPTIONS, arch="real", augment=True, lambda_align=0.2)
    train_translator(config, RunOptions(seed=7, device="cpu", workers=1, out=one), demos)
    write_namesakes(tmp_path)
    # The form that README recommends, where the script is installed.
    program = ("--no_python", str(IFO)) if IFO.exists() else ("-m", "ifo_cli")
    done = train(tmp_path, demos, "--arch", "real", "--augment", "--out", two, program=program)
    assert done.returncode == 0, done.stderr
    assert_same(read_artifact(one), read_artifact(two))


def test_together_they_resume(tmp_path, demos, alone, monkeypatch):
    out = tmp_path / "resumed.translator.h5"
    plain = TranslatorTraining.train_step

    def interrupted(training):
        if training.step == 3:
            raise KeyboardInterrupt
        return plain(training)

    monkeypatch.setattr(TranslatorTraining, "train_step", interrupted)
    run = RunOptions(preset="toy", seed=7, device="cpu", workers=1, out=out)
    with pytest.raises(Interrupted):
        train_translator(TranslatorConfig(**{**OPTIONS, "held_out": 8}), run, demos)
    assert checkpoint_path(out).exists()
    write_namesakes(tmp_path)
    done = train(tmp_path, demos, "--out", out, "--resume")
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("resuming resumed.translator.h5") == 1
    assert "translator: 4 steps" in done.stderr, "from step 2 on, in both"
    assert_same(alone, read_artifact(out))
    assert not checkpoint_path(out).exists()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--groups", "3"], "ifo: --groups 3 with 2 processes: expected a multiple of 2"),
        (["--xyzzy", "3"], "ifo: No such option: --xyzzy (see ifo train-translator --help)"),
    ],
)
def test_what_both_find_wrong_is_said_once(tmp_path, demos, words, expected):
    script = tmp_path / "threads.py"
    script.write_text(THREADS)
    done = train(tmp_path, demos, *words, "--out", tmp_path / "new" / "x.h5", program=[str(script)])
    assert "gloo" not in threads_left(done, 1), "the launcher may have ended the other one"
    assert done.returncode != 0 and done.stdout == ""
    assert said(done) == [expected]
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("rank", "step"), [(1, 3), *(pytest.param(*ends, marks=pytest.mark.slow) for ends in ((1, 0), (0, 3)))]
)
def test_what_ends_one_process_ends_the_other(tmp_path, demos, rank, step):
    script = tmp_path / "broken.py"
    script.write_text(BROKEN)
    out = tmp_path / "x.translator.h5"
    words = [str(rank), str(step), "train-translator", demos, "--device", "cpu", *WORDS, "--out", out]
    done = launch(tmp_path, [str(script)], *words)
    assert done.returncode != 0 and done.stdout == ""
    assert "ifo: this process's disk is full" in said(done)
    assert len(said(done)) <= (2 if rank and step else 1), "at most that the connection is lost"
    assert "bug in ifo" not in done.stderr
    assert not out.exists()
