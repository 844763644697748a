"""The grid's jobs, and what becomes of them when they fail, are killed, or lie there already."""

import base64
import fcntl
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

import stages.reproduce
from artifacts import ArtifactError, PlatformError
from stages.config.stages import TASKS
from stages.reproduce import Execution, missing, reproduce
from stages.reproduction import times as times_of
from stages.reproduction.plan import ABLATED, COMPARED, METHODS, Grid, Job, plan, wanted
from stages.reproduction.times import longest_chain, minutes
from stages.runtime.progress import Progress

ROOT = Path(__file__).parents[2]
LOCAL = Execution("local", 2, "ifo reproduce")


@pytest.mark.parametrize("grid", [Grid(), Grid(("reach",), tuple(METHODS), 2, "toy")])
def test_jobs_come_after_what_they_read(grid):
    made = set()
    for job in plan(grid):
        assert made >= set(job.inputs)
        assert job.output not in made
        made.add(job.output)
    names = [job.name for job in plan(grid)]
    assert len(set(names)) == len(names) and all(name.isidentifier() for name in names)


def test_by_default_it_is_the_papers_grid():
    runs = [job.output for job in wanted(plan(Grid(contexts=2)))]
    expected = [f"{task}-{name}-c{seed}" for task in TASKS for name in COMPARED for seed in range(2)]
    expected += [f"{task}-{name}-c{seed}" for task, names in ABLATED.items() for name in names for seed in range(2)]
    assert sorted(runs) == sorted(f"{name}.evaluation.h5" for name in expected)


def test_runs_share_what_they_can():
    jobs = plan(Grid(("reach",), ("translation", "without-feat", "no-blur", "oracle", "gail"), 3))
    trained = [job.output for job in jobs if job.stage == "train-translator"]
    assert sorted(trained) == ["reach-blank.translator.h5", "reach-whole.translator.h5"]
    assert sum(job.stage == "collect-demos" for job in jobs) == 1
    assert sum(job.stage == "translate" for job in jobs) == 6


def test_estimates_add_up():
    jobs = plan(Grid(("reach", "push"), contexts=3))
    times = {job.output: minutes(job, "quick") for job in jobs}
    assert all(value > 0 for value in times.values())
    assert times["reach-whole.translator.h5"] > 5 > times["reach-blank.translator.h5"]
    assert times["reach-gail-c0.policy.h5"] > times["reach-oracle-c0.policy.h5"]
    assert times["reach-gail-c0.evaluation.h5"] == (times_of.START + times_of.EVALUATE) / 60
    assert max(times.values()) < longest_chain(jobs, "quick") < sum(times.values())


def test_only_what_is_still_needed_is_made(tmp_path):
    jobs = plan(Grid(("reach",), ("translation",), 2))
    assert missing(jobs, tmp_path) == jobs
    for name in ("reach-translation-c0.evaluation.h5", "reach-whole.translator.h5"):
        (tmp_path / name).touch()
    # Its demonstrations may have been deleted to save room.
    assert [job.output for job in missing(jobs, tmp_path)] == [
        "reach-whole-c1.translation.h5",
        "reach-translation-c1.policy.h5",
        "reach-translation-c1.evaluation.h5",
    ]


@dataclass(frozen=True)
class ShellJob(Job):
    """A job that runs a line of shell."""

    shell: str = ""

    @property
    def command(self) -> str:
        return f"bash -c {self.shell!r}"


def shell_job(name: str, shell: str, *inputs: str) -> ShellJob:
    stage = "evaluate" if "evaluation" in name else "learn-policy"
    return ShellJob(stage, "reach", (), inputs, name, shell=f"echo x >> {name}.count; {shell}; echo done > {name}")


@pytest.fixture
def run(monkeypatch, tmp_path, capfd):
    """A function that runs jobs in place of the grid's, without a home, and returns how often each was started."""
    monkeypatch.setenv("HOME", "/proc/none")
    monkeypatch.setenv("XDG_CACHE_HOME", "")

    def call(*jobs: ShellJob) -> dict[str, int]:
        monkeypatch.setattr(stages.reproduce, "plan", lambda grid: list(jobs))
        try:
            reproduce(Grid(preset="toy"), tmp_path, LOCAL, Progress(quiet=True))
        finally:
            capfd.readouterr()
        return {path.stem: len(path.read_text().split()) for path in tmp_path.glob("*.count")}

    return call


def test_what_fails_is_tried_twice_and_does_not_stop_the_others(run, tmp_path):
    jobs = [
        shell_job("bad.policy.h5", "echo ifo: no luck; exit 3"),
        shell_job("bad.evaluation.h5", "true", "bad.policy.h5"),
        shell_job("good.policy.h5", "true"),
        shell_job("good.evaluation.h5", "true", "good.policy.h5"),
    ]
    with pytest.raises(ArtifactError) as caught:
        run(*jobs)
    assert "1 of 2 runs are missing" in str(caught.value)
    assert "logs/bad_policy.log (no luck)" in str(caught.value) and "\n" not in str(caught.value)
    assert (tmp_path / "good.evaluation.h5").exists()
    assert (tmp_path / "bad.policy.h5.count").read_text().split() == ["x", "x"]
    mended = [shell_job("bad.policy.h5", "true"), *jobs[1:]]
    counts = run(*mended)
    assert counts["bad.policy.h5"] == 3
    assert counts["good.policy.h5"] == counts["good.evaluation.h5"] == 1


def test_files_of_another_machine_count_whatever_their_dates(run, tmp_path):
    jobs = [shell_job("a.policy.h5", "true"), shell_job("a.evaluation.h5", "true", "a.policy.h5")]
    for name, age in (("a.policy.h5", 0), ("a.evaluation.h5", 1000)):
        (tmp_path / name).write_text("copied")
        os.utime(tmp_path / name, (time.time() - age,) * 2)
    more = [shell_job("b.evaluation.h5", "true", "a.policy.h5")]
    assert run(*jobs, *more) == {"b.evaluation.h5": 1}


def test_a_whole_file_that_a_killed_engine_took_no_note_of_counts(run, tmp_path):
    jobs = [shell_job("a.policy.h5", "true"), shell_job("a.evaluation.h5", "true", "a.policy.h5")]
    run(*jobs)
    mark = tmp_path / ".snakemake" / "incomplete" / base64.b64encode(b"a.policy.h5").decode()
    mark.write_text('{"external_jobid": null}')
    counts = run(*jobs, shell_job("b.evaluation.h5", "true", "a.policy.h5"))
    assert counts == {"a.policy.h5": 1, "a.evaluation.h5": 1, "b.evaluation.h5": 1}


SCRIPT = """
import sys
sys.path.insert(0, {tests!r})
from pathlib import Path
import stages.reproduce
from stages.runtime.progress import Progress
from stages.reproduction.plan import Grid
from artifacts import IfoError
from test_reproduce import LOCAL, WAITING, shell_job
jobs = [
    shell_job("a.policy.h5", "true"),
    shell_job("a.evaluation.h5", WAITING, "a.policy.h5"),
]
stages.reproduce.plan = lambda grid: jobs
try:
    stages.reproduce.reproduce(Grid(preset="toy"), Path({folder!r}), LOCAL, Progress(quiet=True))
except IfoError as error:
    print(type(error).__name__, error)
"""
WAITING = "trap 'echo told >> signals; exit 130' INT; test -e go || { touch begun; sleep 60 & jobs -p > job; wait; }"


@pytest.fixture
def begin(tmp_path):
    """A function that starts the script, by itself, and returns it once its last job runs."""
    content = SCRIPT.format(tests=str(Path(__file__).parent), folder=str(tmp_path))
    command = [sys.executable, "-c", content]

    def start(wait: bool = True, interrupts=signal.default_int_handler, errors=subprocess.DEVNULL) -> subprocess.Popen:
        process = subprocess.Popen(
            command,
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            start_new_session=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, interrupts),
        )
        while wait and not (tmp_path / "begun").exists():
            assert process.poll() is None
            time.sleep(0.1)
        return process

    return start


def test_an_interrupt_reaches_the_jobs_once_and_says_how_to_go_on(begin, tmp_path):
    for tell in (os.killpg, os.kill):  # as a terminal does, and as `kill` does
        process = begin()
        tell(process.pid, signal.SIGINT)
        said, _ = process.communicate(timeout=30)
        assert "Interrupted" in said and "continue with: ifo reproduce" in said
        assert (tmp_path / "signals").read_text().split() == ["told"]
        (tmp_path / "signals").unlink()
        (tmp_path / "begun").unlink()


def test_an_interrupt_while_the_engine_starts_shows_no_traceback(begin, tmp_path):
    process = begin(wait=False, errors=subprocess.PIPE)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    while len(children.read_text().split()) < 2:  # the engine, and what watches over it
        assert process.poll() is None
        time.sleep(0.01)
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    said, errors = process.communicate(timeout=30)
    assert "Interrupted" in said and "Traceback" not in errors, errors


def test_terminated_behind_an_ampersand_it_stops_its_jobs(begin, tmp_path):
    process = begin(interrupts=signal.SIG_IGN)  # as a shell does where there is no terminal
    process.terminate()
    said, _ = process.communicate(timeout=30)
    assert "continue with: ifo reproduce" in said
    assert (tmp_path / "signals").read_text().split() == ["told"]


def test_no_more_jobs_at_a_time_than_cores(tmp_path, monkeypatch):
    # After a job that all wait for: where some versions of Snakemake counted wrongly.
    count = "touch running.$$; ls | grep -c running >> ../most; sleep 1; rm running.$$"
    jobs = [shell_job("a.policy.h5", "mkdir runners")]
    jobs += [shell_job(f"{k}.evaluation.h5", f"(cd runners; {count})", "a.policy.h5") for k in range(5)]
    monkeypatch.setattr(stages.reproduce, "plan", lambda grid: jobs)
    reproduce(Grid(preset="toy"), tmp_path, LOCAL, Progress(quiet=True))
    assert max(map(int, (tmp_path / "most").read_text().split())) == LOCAL.cores


def is_running(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state not in "ZX"


@pytest.mark.parametrize("place", ["file/grid", "loop", "x" * 300, "readonly", "pipe"])
def test_a_folder_that_cannot_be_used_is_one_line(place, tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "readonly").mkdir()
    (tmp_path / "readonly" / stages.reproduce.LOCK).mkdir()
    (tmp_path / "pipe").mkdir()
    os.mkfifo(tmp_path / "pipe" / stages.reproduce.LOCK)
    with pytest.raises(PlatformError, match=r"cannot be used .*choose another --out") as caught:
        reproduce(Grid(("reach",), ("oracle",), 1, "toy"), tmp_path / place, LOCAL, Progress(quiet=True))
    assert "\n" not in str(caught.value)


def test_killed_and_begun_again_it_repeats_at_most_what_was_running(begin, tmp_path):
    first = begin()
    said, _ = begin(wait=False).communicate(timeout=60)
    assert "another `ifo reproduce` is running" in said
    job = int((tmp_path / "job").read_text())
    first.kill()
    first.wait()
    with open(tmp_path / stages.reproduce.LOCK) as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
    assert not is_running(job), "the lock is released only once the jobs are killed"
    (tmp_path / "go").touch()
    assert begin(wait=False).wait(timeout=60) == 0
    assert (tmp_path / "a.evaluation.h5").exists()
    assert len((tmp_path / "a.policy.h5.count").read_text().split()) == 1
    assert len((tmp_path / "a.evaluation.h5.count").read_text().split()) == 2


def test_missing_engines_are_named(tmp_path, monkeypatch):
    with pytest.raises(PlatformError, match="pip install snakemake-executor-plugin-slurm"):
        reproduce(Grid(), tmp_path, Execution("slurm", 2, ""), Progress(quiet=True))
    monkeypatch.setattr(stages.reproduce, "find_spec", lambda name: None)
    with pytest.raises(PlatformError, match=r"ifo\[reproduce\]"):
        reproduce(Grid(), tmp_path, LOCAL, Progress(quiet=True))
    assert not list(tmp_path.iterdir())


def test_the_plan_survives_json():
    jobs = plan(Grid(("reach",), contexts=1))
    rules = json.loads(json.dumps(stages.reproduce._as_rules(jobs, "quick")))
    assert sum(rule["wanted"] for rule in rules) == len(wanted(jobs))
