"""MuJoCo's warnings reach the user once, and leave no file behind."""

from __future__ import annotations

import mujoco
import pytest

from stages.environments import engine_log
from stages.environments.making import make_environment
from stages.environments.spec import EnvironmentSpec


@pytest.fixture
def environment(monkeypatch, tmp_path):
    """HalfCheetah, whose model has a deprecated attribute, made in a folder of its own where nobody handles warnings.

    Importing dm_control sets a handler; Gymnasium does not.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(engine_log, "_seen", set())
    handler = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(None)
    made = make_environment(EnvironmentSpec("HalfCheetah-v5", control_steps=3, frames=2))
    yield made.unwrapped
    made.close()
    mujoco.set_mju_user_warning(handler)


def break_physics(environment, time):
    """Make MuJoCo warn that the simulation is unstable."""
    environment.data.time, environment.data.qvel[:] = time, 1e30
    mujoco.mj_step(environment.model, environment.data)


def test_a_warning_is_logged_once_and_written_nowhere(environment, tmp_path, caplog):
    for time in (0.0, 1.0):
        break_physics(environment, time)
    assert [record.getMessage() for record in caplog.records] == [
        "MuJoCo: Nan, Inf or huge value in QVEL at DOF 0. The simulation is unstable."
    ]
    assert list(tmp_path.iterdir()) == []


def test_a_handler_of_the_user_stays(environment):
    heard = []
    mujoco.set_mju_user_warning(heard.append)
    engine_log.log_warnings()
    break_physics(environment, 0.0)
    assert len(heard) == 1
