"""What happens where a stage's output exists already, and how default names tell runs apart."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from artifacts import UsageError, read_artifact, write_artifact
from artifacts.usage import is_used
from stages.config.presets import defaults
from stages.config.stages import EvaluateConfig
from stages.runtime.outputs import Output, name_tags
from stages.runtime.progress import Progress
from stages.runtime.run import RunOptions

QUIET = Progress(quiet=True)
CONFIG = EvaluateConfig(episodes=8)
RUN = RunOptions(preset="toy", seed=1, progress=QUIET)
ARRAYS = {"weights/w": np.arange(4.0)}


def output(path, config=CONFIG, run=RUN, parents=(), **extra):
    return Output.of(path, "policy", "evaluate", config, run, parents, extra)


def write(path, **changes):
    made = output(path, **changes)
    return made.write(ARRAYS, config={"stage": "evaluate"}, summary={"score": 0.5})


def test_nothing_is_kept_where_there_is_nothing(tmp_path):
    assert output(tmp_path / "a.policy.h5").kept() is None


def test_what_the_command_would_make_is_kept_with_its_figures(tmp_path):
    path = tmp_path / "a.policy.h5"
    write(path)
    before = path.read_bytes()
    kept = output(path).kept()
    assert kept is not None
    assert (kept.path, kept.summary) == (path, {"score": 0.5})
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"config": dataclasses.replace(CONFIG, episodes=9)}, "episodes"),
        ({"run": dataclasses.replace(RUN, seed=2)}, "seed"),
        ({"run": dataclasses.replace(RUN, preset="quick")}, "preset"),
        ({"task_code": "other"}, "task_code"),
    ],
)
def test_what_differs_is_refused_and_named(tmp_path, changes, named):
    path = tmp_path / "a.policy.h5"
    write(path)
    before = path.read_bytes()
    with pytest.raises(UsageError, match=named) as refused:
        output(path, **changes).kept()
    assert "--overwrite" in str(refused.value)
    assert path.read_bytes() == before


@dataclasses.dataclass(frozen=True)
class Upgraded(EvaluateConfig):
    """The configuration of a later version of ifo, with one more option."""

    smoothing: float = 0.0


def test_an_option_that_came_later_differs_only_if_it_is_set(tmp_path):
    path = tmp_path / "a.policy.h5"
    write(path)
    assert output(path, config=Upgraded(episodes=8)).kept() is not None
    with pytest.raises(UsageError, match="smoothing"):
        output(path, config=Upgraded(episodes=8, smoothing=0.5)).kept()


def test_another_input_is_refused_and_an_equal_one_kept(tmp_path):
    def parent(values):
        path = tmp_path / "p.translation.h5"
        arrays = {
            "context_frame": np.zeros((8, 8, 3), np.uint8),
            "target_features": np.zeros((2, 3)),
            "target_images": np.full((2, 8, 8, 3), values, np.float32),
        }
        write_artifact(path, "translation", arrays, config={}, seed=0, command="made at another time")
        return path

    path = tmp_path / "a.policy.h5"
    write(path, parents=[parent(1)])
    assert output(path, parents=[parent(1)]).kept() is not None
    with pytest.raises(UsageError, match="input"):
        output(path, parents=[parent(2)]).kept()


def test_files_that_are_something_else_are_refused(tmp_path):
    path = tmp_path / "a.policy.h5"
    path.write_text("my notes")
    with pytest.raises(UsageError, match="not a readable artifact"):
        output(path).kept()
    write_artifact(path, "translator", ARRAYS, config={}, seed=0, command="ifo")
    with pytest.raises(UsageError, match="holds a translator"):
        output(path).kept()


def test_overwrite_makes_it_again(tmp_path):
    path = tmp_path / "a.policy.h5"
    write(path)
    again = dataclasses.replace(RUN, overwrite=True, seed=2)
    assert output(path, run=again).kept() is None
    write(path, run=again)
    assert read_artifact(path).manifest.seed == 2


def test_a_file_that_appears_during_the_work_is_not_replaced(tmp_path):
    path = tmp_path / "a.policy.h5"
    slow = output(path)
    write(path, run=dataclasses.replace(RUN, seed=7))
    with pytest.raises(UsageError, match="in the meantime"):
        slow.write(ARRAYS, config={}, summary={})
    assert read_artifact(path).manifest.seed == 7


@pytest.mark.parametrize(
    ("stage", "changes", "run", "expected"),
    [
        ("learn-policy", {}, {}, ""),
        ("learn-policy", {"learner": "ppo"}, {}, "-ppo"),
        ("learn-policy", {"learner": "gps", "reward": "oracle"}, {}, "-gps-oracle"),
        ("learn-policy", {"without": ("img",)}, {}, "-without-img"),
        ("learn-policy", {"negatives": 5}, {"seed": 3}, "-negatives5-s3"),
        ("train-translator", {"without": ("rec", "align")}, {}, "-without-rec-align"),
        ("train-translator", {"arch": "real"}, {"preset": "paper"}, "-paper-real"),
        ("collect-demos", {"vary": "azimuth,goal"}, {}, "-vary-azimuth-goal"),
        ("collect-demos", {"contexts": "fixed", "context_seed": 2}, {}, "-fixed-own-context2"),
    ],
)
def test_names_tell_apart_what_differs(stage, changes, run, expected):
    usual = defaults("quick", stage, "reach")
    told = dataclasses.replace(RunOptions(progress=QUIET), **run)
    assert name_tags(dataclasses.replace(usual, **changes), usual, told, 0, "quick") == expected


def test_an_output_that_is_a_link_is_written_kept_and_replaced_through_it(tmp_path):
    target, link = tmp_path / "real.policy.h5", tmp_path / "a.policy.h5"
    link.symlink_to(target.name)
    assert output(link).kept() is None, "it leads nowhere yet"
    write(link)
    assert output(link).kept() is not None
    with pytest.raises(UsageError, match="seed"):
        output(link, run=dataclasses.replace(RUN, seed=2)).kept()
    write(link, run=dataclasses.replace(RUN, seed=2, overwrite=True))
    assert link.is_symlink() and read_artifact(target).manifest.recipe["seed"] == 2


def test_a_name_without_room_for_the_checkpoint_is_refused_at_once(tmp_path):
    suffixes = len(".policy.checkpoint.h5")
    output(tmp_path / f"{'x' * (255 - suffixes)}.policy.h5")
    with pytest.raises(UsageError, match="too long"):
        output(tmp_path / f"{'x' * (256 - suffixes)}.policy.h5")


def test_inputs_are_marked_as_long_as_the_stage_runs(tmp_path):
    first, second, other = (tmp_path / f"{name}.policy.h5" for name in "abc")
    for path in (first, second, other):
        write(path)
    running = output(tmp_path / "out.policy.h5", parents=[first, read_artifact(second)])
    assert [is_used(path) for path in (first, second, other)] == [True, True, False]
    running = running.made_from([other])
    assert [is_used(path) for path in (first, second, other)] == [False, False, True]
    running.write(ARRAYS, config={"stage": "evaluate"}, summary={}, parents=[other])
    del running
    assert not any(map(is_used, (first, second, other)))
