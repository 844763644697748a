"""Checkpoints of a stage: what it says of them after Ctrl-C, what they cost, and when they are refused."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import stages.runtime.checkpoints
from artifacts import ArtifactError, UsageError, content_of, read_artifact, verify_artifact, write_artifact
from stages.runtime.checkpoints import Checkpoints, curve_of
from stages.runtime.run import RunOptions
from tests.artifacts.samples import OLD_FILES


@pytest.fixture
def checkpoints(tmp_path):
    def make(**options):
        return Checkpoints(RunOptions(**options), tmp_path / "x.expert.h5", "train-expert", {}, [])

    return make


def test_what_was_interrupted_right_after_writing_it_is_named(checkpoints, monkeypatch):
    write = stages.runtime.checkpoints.write_checkpoint

    def write_then_interrupt(*arguments, **options):
        write(*arguments, **options)
        raise KeyboardInterrupt

    monkeypatch.setattr(stages.runtime.checkpoints, "write_checkpoint", write_then_interrupt)
    run = checkpoints()
    with pytest.raises(KeyboardInterrupt):
        run.save({"a": np.zeros(2)})
    assert "--resume" in str(run.interrupted("2 of 4 steps"))


def test_one_that_another_run_left_is_not_taken_for_this_ones(checkpoints):
    checkpoints().save({"a": np.zeros(2)})
    run = checkpoints()
    assert "no checkpoint yet" in str(run.interrupted("1 of 4 steps"))
    run.save({"a": np.ones(2)})
    assert "--resume" in str(run.interrupted("2 of 4 steps"))


def test_a_resumed_run_names_the_one_it_came_from(checkpoints):
    checkpoints().save({"a": np.zeros(2)})
    run = checkpoints(resume=True)
    assert run.start() is not None
    assert "kept" in str(run.interrupted("3 of 4 steps"))


def test_without_any_there_is_none_to_resume(checkpoints):
    assert "no checkpoint yet" in str(checkpoints(resume=True).interrupted("0 of 4 steps"))


@pytest.fixture
def demos(tmp_path):
    """Demonstrations of 3 MB."""

    def write(seed=0, command="ifo collect-demos"):
        frames = np.random.default_rng(seed).integers(0, 256, (40, 25, 32, 32, 3), np.uint8)
        arrays = {"frames": frames, "final_distance": np.zeros(40)}
        return write_artifact(tmp_path / "x.demos.h5", "demos", arrays, config={}, seed=seed, command=command)

    return write


def bytes_read() -> int:
    """By this process so far."""
    return int(Path("/proc/self/io").read_text().split("rchar: ")[1].split()[0])


def test_checkpoints_do_not_read_their_parents(demos, tmp_path):
    size = demos().stat().st_size
    run = Checkpoints(RunOptions(), tmp_path / "x.translator.h5", "train-translator", {}, [demos()])
    run.save({"a": np.zeros(2)})
    before = bytes_read()
    for step in range(10):
        run.save({"a": np.full(2, step)})
    assert bytes_read() - before < size / 4
    assert verify_artifact(tmp_path / "x.translator.checkpoint.h5").parents == 1


def test_checkpoints_read_an_old_parent_once(tmp_path):
    size = OLD_FILES["translator"].stat().st_size
    run = Checkpoints(RunOptions(), tmp_path / "x.translation.h5", "translate", {}, [OLD_FILES["translator"]])
    before = bytes_read()
    for step in range(5):
        run.save({"a": np.full(2, step)})
    assert bytes_read() - before < 2 * size


def test_a_parent_is_recorded_as_it_was_when_it_was_opened(demos, tmp_path):
    opened, content = read_artifact(demos()), content_of(demos())
    run = Checkpoints(RunOptions(), tmp_path / "x.translator.h5", "train-translator", {}, [opened])
    demos(seed=1)
    run.save({"a": np.zeros(2)})
    saved = read_artifact(tmp_path / "x.translator.checkpoint.h5")
    assert [parent.content for parent in saved.manifest.parents] == [content]


def test_only_another_input_ends_a_run(demos, tmp_path):
    def checkpoints(*parents, **options):
        return Checkpoints(RunOptions(**options), tmp_path / "x.translator.h5", "train-translator", {}, [*parents])

    checkpoints(demos()).save({"a": np.zeros(2)})
    assert checkpoints(demos(command="ifo collect-demos --workers 2"), resume=True).start() is not None
    with pytest.raises(UsageError, match="written with another input file"):
        checkpoints(demos(seed=1), resume=True).start()
    with pytest.raises(UsageError, match="written with another input file"):
        checkpoints(resume=True).start()
    with pytest.raises(UsageError, match="written with another seed"):
        checkpoints(demos(), resume=True, seed=4).start()


@pytest.mark.parametrize(
    "restore",
    [
        lambda state: state["b"],
        lambda state: state.load(),
        lambda state: curve_of([1]),
        lambda state: curve_of({"return": [[]]}),
        lambda state: range(3)[10**30],
        lambda state: int(float("inf")),
        lambda state: np.zeros(3).reshape(state["a"].shape),
    ],
)
def test_a_state_that_cannot_be_restored_is_the_checkpoints_fault(checkpoints, restore):
    checkpoints().save({"a": np.zeros(2)})
    run = checkpoints(resume=True)
    state = run.start()
    with (
        pytest.raises(
            ArtifactError, match=r"x\.expert\.checkpoint\.h5 does not hold a state of train-expert"
        ) as caught,
        run.restoring(),
    ):
        restore(state)
    assert "\n" not in str(caught.value)


def test_a_checkpoint_that_is_no_file_is_refused(checkpoints, tmp_path):
    os.mkfifo(tmp_path / "x.expert.checkpoint.h5")
    with pytest.raises(ArtifactError, match="not a regular file"):
        checkpoints(resume=True).start()
