"""A pytest plugin of mutation testing: run the test files that take least first, since one failure is enough."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

STATISTICS = Path("mutmut-stats.json")  # mutmut wrote it in the folder that tests run in


def pytest_collection_modifyitems(items):
    if not STATISTICS.exists():
        return
    durations = json.loads(STATISTICS.read_text())["duration_by_test"]
    seconds: Counter[Path] = Counter()
    for item in items:
        seconds[item.path] += durations.get(item.nodeid, 0.0)
    items.sort(key=lambda item: (seconds[item.path], item.path))
