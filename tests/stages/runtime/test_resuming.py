"""What a stage resumes from, what it refuses to resume from, and what it says of both."""

from __future__ import annotations

import numpy as np
import pytest

from artifacts import ArtifactError, UsageError, read_artifact, write_artifact
from stages.runtime.checkpoints import Checkpoints
from stages.runtime.progress import Progress
from stages.runtime.run import RunOptions


@pytest.fixture
def checkpoints(tmp_path):
    def make(**options):
        return Checkpoints(RunOptions(**options), tmp_path / "x.expert.h5", "train-expert", {}, [])

    return make


def test_the_state_comes_back_and_is_gone_once_removed(checkpoints, tmp_path):
    run = checkpoints(seed=4, resume=True, command="ifo train-expert reach")
    assert run.start() is None
    run.save({"a": np.arange(3), "done": 2})
    path = tmp_path / "x.expert.checkpoint.h5"
    assert path.exists()
    state = checkpoints(seed=4, resume=True).start()
    np.testing.assert_array_equal(state["a"], [0, 1, 2])
    assert state["done"] == 2
    manifest = read_artifact(path, "checkpoint").manifest
    assert (manifest.seed, manifest.command) == (4, "ifo train-expert reach")
    run.remove()
    assert not path.exists()
    assert checkpoints(seed=4, resume=True).start() is None


def test_without_resume_a_checkpoint_is_left_alone(checkpoints):
    checkpoints().save({"a": np.zeros(2)})
    assert checkpoints(resume=False).start() is None


class TestOtherRuns:
    """A checkpoint of another run is refused in one line that names what differs."""

    @pytest.fixture
    def run(self, tmp_path):
        def make(seed=4, stage="train-expert", parent=None, **config):
            options = RunOptions(seed=seed, resume=True, progress=Progress(quiet=True))
            return Checkpoints(options, tmp_path / "x.expert.h5", stage, config, [] if parent is None else [parent])

        return make

    @pytest.fixture
    def parents(self, tmp_path):
        about = {"config": {}, "seed": 0, "command": "ifo"}
        return [
            write_artifact(tmp_path / f"{k}.policy.h5", "policy", {"weights/a": np.full(2, k)}, **about)
            for k in range(2)
        ]

    def test_the_same_run_goes_on(self, run, parents):
        run(parent=parents[0], steps=5).save({"done": 1})
        assert run(parent=parents[0], steps=5).start() == {"done": 1}

    @pytest.mark.parametrize(
        ("changes", "named"),
        [
            ({"seed": 5}, "another seed;"),
            ({"steps": 6}, "another steps;"),
            ({"rate": 0.2, "steps": 6}, "another rate, steps;"),
            ({"more": 1}, "another more;"),
            ({"seed": 5, "steps": 6}, "another steps, seed;"),
        ],
    )
    def test_another_configuration_or_seed(self, run, changes, named):
        run(steps=5, rate=0.1).save({"done": 1})
        with pytest.raises(UsageError, match=named) as caught:
            run(**{"steps": 5, "rate": 0.1, **changes}).start()
        assert "x.expert.checkpoint.h5" in str(caught.value) and "\n" not in str(caught.value)

    def test_an_option_that_is_gone(self, run):
        run(steps=5, rate=0.1).save({"done": 1})
        with pytest.raises(UsageError, match="another rate;"):
            run(steps=5).start()

    def test_another_input(self, run, parents):
        run(parent=parents[0]).save({"done": 1})
        for parent in (parents[1], None):
            with pytest.raises(UsageError, match="another input file;"):
                run(parent=parent).start()

    def test_another_stage(self, run):
        run().save({"done": 1})
        with pytest.raises(ArtifactError, match="expected one of learn-policy"):
            run(stage="learn-policy").start()


def test_says_what_it_resumes_from_or_that_there_is_nothing(tmp_path, capsys):
    run = Checkpoints(RunOptions(resume=True), tmp_path / "x.expert.h5", "train-expert", {}, [])
    run.start()
    assert "no checkpoint next to" in capsys.readouterr().err
    run.save({"done": 1})
    run.start()
    assert "resuming x.expert.h5 from x.expert.checkpoint.h5" in capsys.readouterr().err


def test_how_to_continue_is_the_command_with_resume_once(checkpoints, tmp_path):
    for resume, command in ((False, "ifo train-expert reach --resume"), (True, "ifo train-expert reach")):
        run = checkpoints(resume=resume, command="ifo train-expert reach")
        run.save({"done": 1})
        said = str(run.interrupted("1 of 4 steps"))
        assert said.startswith("interrupted after 1 of 4 steps")
        assert str(tmp_path / "x.expert.checkpoint.h5") in said and said.endswith(f"continue with: {command}")
