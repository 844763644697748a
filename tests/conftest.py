"""Chooses the GL backend before any test imports mujoco, and skips what draws where there is none."""

from __future__ import annotations

import pytest

from stages.simulation.gl import choose_backend

BACKEND = choose_backend(required=False)


def pytest_collection_modifyitems(items):
    if not BACKEND:
        for item in items:
            if item.get_closest_marker("gl"):
                item.add_marker(pytest.mark.skip(reason="no OpenGL backend works here"))
