"""What every option resolves to, for each preset, stage, task, learner and network, does not drift."""

from __future__ import annotations

import json

from tests.stages.config.dump_defaults import FIXTURE, dump


def test_every_resolved_value_is_the_recorded_one():
    recorded = json.loads(FIXTURE.read_text(encoding="utf-8"))
    now = json.loads(json.dumps(dump()))
    assert now["presets"] == recorded["presets"]
    assert now["others"] == recorded["others"]
