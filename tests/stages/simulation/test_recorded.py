"""Contexts out of files are those of the task."""

from __future__ import annotations

import numpy as np
import pytest

from artifacts import ArtifactError, read_artifact, write_artifact
from stages.learners.demonstrators import filmed_contexts
from stages.simulation.recorded import recorded_contexts
from stages.simulation.registry import distribution, learner_context, make_task

CONFIG = {"task": "reach", "contexts": "paper", "vary": "", "preset": "toy"}


@pytest.fixture(scope="module")
def task():
    return make_task("reach")


@pytest.fixture
def policy(tmp_path, task):
    """A function that writes a policy with other contexts or another configuration, and opens it."""

    def write(changed=None, **config):
        found = learner_context(task, 0, distribution("paper")) | (changed or {})
        arrays = {f"contexts/{name}": values for name, values in found.items() if values is not None}
        arrays["weights/a"] = np.zeros(2)
        path = tmp_path / "a.policy.h5"
        write_artifact(path, "policy", arrays, config={**CONFIG, **config}, seed=0, command="ifo")
        return read_artifact(path)

    return write


@pytest.mark.parametrize(("contexts", "vary"), [("paper", ""), ("narrow", "azimuth"), ("fixed", "")])
def test_contexts_of_the_task_are_read(policy, task, contexts, vary):
    drawn = learner_context(task, 0, distribution(contexts, vary))
    found = recorded_contexts(policy(drawn, contexts=contexts, vary=vary), task)
    assert found.keys() == drawn.keys()
    assert all((found[name] == drawn[name]).all() for name in drawn)


@pytest.mark.parametrize(
    ("contexts", "message"),
    [
        ({"goal": None}, "its context lacks goal"),
        ({"goal": np.zeros((1, 3))}, r"contexts/goal is float64 \(1, 3\), but in task reach it is float64 \(1, 2\)"),
        ({"goal": np.zeros((2, 2))}, r"contexts/goal is float64 \(2, 2\)"),
        ({"goal": np.array([["a", "b"]])}, "contexts/goal is <U1"),
        ({"goal": np.array([[1e300, 0]])}, "contexts/goal is out of any range"),
    ],
)
def test_contexts_of_another_task_are_refused(policy, task, contexts, message):
    with pytest.raises(ArtifactError, match=rf"a\.policy\.h5: {message}"):
        recorded_contexts(policy(contexts), task)


@pytest.mark.parametrize(
    "config", [{"contexts": "round"}, {"vary": "weather"}, {"vary": "azimuth", "contexts": "fixed"}]
)
def test_unknown_distributions_are_the_files_fault(policy, task, config):
    with pytest.raises(ArtifactError, match=r"a\.policy\.h5: its configuration has --"):
        recorded_contexts(policy(**config), task)


@pytest.mark.parametrize("config", [{"contexts": "round"}, {"stage": "import-demos", "preset": "huge"}])
def test_demonstrations_of_unknown_contexts_are_refused(policy, config):
    assert filmed_contexts(policy()) == ("paper", "")
    with pytest.raises(ArtifactError, match=r"a\.policy\.h5"):
        filmed_contexts(policy(**config))
