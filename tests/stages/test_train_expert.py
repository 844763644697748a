"""The quick preset's experts solve their tasks, and move one way in one context."""

import numpy as np
import pytest

from artifacts import read_artifact
from stages.config.presets import defaults
from stages.config.stages import TASKS
from stages.runtime.run import RunOptions
from stages.train_expert import CONSISTENT_SPREAD, train_expert


@pytest.mark.slow
@pytest.mark.parametrize("task", TASKS)
def test_the_quick_expert_solves_its_task_consistently(tmp_path, task):
    out = tmp_path / "x.expert.h5"
    result = train_expert(task, defaults("quick", "train-expert", task), RunOptions(out=out))
    artifact = read_artifact(result.path, "expert")
    distances, spread = artifact["test/normalised_distance"], artifact["test/spread"]
    assert len(distances) == 200
    assert (distances < 0.3).mean() >= 0.95
    assert (spread.max(axis=1) < CONSISTENT_SPREAD).mean() >= 0.9
    assert result.summary["success"] == pytest.approx(np.mean(distances < 0.3))
    assert artifact["curve/normalised_distance"][-1] < 0.1 < artifact["curve/normalised_distance"][0]
