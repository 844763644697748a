"""What a stage says of its checkpoint after Ctrl-C."""

from __future__ import annotations

import numpy as np
import pytest

import stages.runtime.checkpoints
from stages.runtime.checkpoints import Checkpoints
from stages.runtime.run import RunOptions


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
