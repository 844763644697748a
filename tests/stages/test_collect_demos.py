"""When a demonstrator is given up."""

from __future__ import annotations

import dataclasses

import pytest

from artifacts import ArtifactError
from stages.collect_demos import FEWEST_ATTEMPTS, collect_demos
from stages.config.stages import DemosConfig
from stages.runtime.progress import Progress
from stages.runtime.run import RunOptions
from stages.simulation import batch

pytestmark = pytest.mark.gl


@pytest.fixture
def collect(tmp_path, monkeypatch):
    """A function that collects two demonstrations of push-real, whose first `failing` attempts fail."""
    plain = batch.rollout

    def run(failing: float):
        seen = 0

        def rollout(task, contexts, *arguments, **options):
            nonlocal seen
            episode = plain(task, contexts, *arguments, **options)
            seen += len(episode.final_distance)
            left = episode.initial_distance if seen <= failing else 0.1 * episode.initial_distance
            return dataclasses.replace(episode, final_distance=left)

        monkeypatch.setattr(batch, "rollout", rollout)
        options = RunOptions(workers=1, out=tmp_path / "x.demos.h5", progress=Progress(quiet=True))
        return collect_demos("push-real", DemosConfig(n=2), options, None).summary

    return run


def test_a_few_failures_do_not_give_a_demonstrator_up(collect):
    """Of an expert that succeeds in half of the contexts, every fourth pair of attempts fails."""
    summary = collect(failing=10)
    assert (summary["demos"], summary["dropped"]) == (2, 10)


def test_a_demonstrator_that_always_fails_is_given_up(collect, tmp_path):
    with pytest.raises(ArtifactError, match=f"failed in {FEWEST_ATTEMPTS} of {FEWEST_ATTEMPTS} contexts"):
        collect(failing=float("inf"))
    assert list(tmp_path.iterdir()) == []
