"""The README's Python runs as it stands, on the toy pipeline's files."""

from __future__ import annotations

import re
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import ifo
from ifo import suite

pytestmark = pytest.mark.gl
README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
SNIPPETS = re.findall(r"```python\n(.*?)```", README, re.S)


def test_there_are_snippets():
    assert len(SNIPPETS) >= 5


@pytest.mark.parametrize("snippet", SNIPPETS)
def test_a_snippet_runs(snippet, toy, monkeypatch):
    monkeypatch.chdir(toy.folder)
    code = re.sub(r'"runs/[^"]*\.(\w+)\.h5"', lambda found: repr(str(toy.artifact(found[1]))), snippet)
    names: dict = {}
    exec(code.replace("env).learn(total_timesteps=300_000)", "env, n_steps=8, batch_size=8).learn(8)"), names)
    assert "stages" not in snippet and "artifacts" not in snippet
    if "frames" in names:
        assert names["frames"].shape == (10, 25, 48, 48, 3)
    if isinstance(names.get("env"), gymnasium.Env):
        names["env"].close()


def test_a_loaded_policy_does_what_evaluate_measured(toy):
    """In a dm_control environment it ends where a rollout in the batch ends."""
    from stages.simulation.batch import rollout

    policy, source = ifo.load_policy(toy.artifact("policy")), ifo.read_artifact(toy.artifact("policy"))
    contexts = source.group("contexts")
    env = suite.load("reach", contexts=lambda rng, n: contexts, seed=3)
    task, time_step = env.task.task, env.reset()
    start = env.physics.task_state()
    while not time_step.last():
        time_step = env.step(policy.act(task.observe(env.physics.task_state()))[0])
    episode = rollout(task, contexts, start.qpos, start.qvel, lambda state, _: policy.act(task.observe(state)))
    assert env.task.distance(env.physics) == pytest.approx(episode.final_distance[0], rel=1e-4)
    assert np.isfinite(episode.final_distance).all()
    env.close()
