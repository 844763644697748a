"""Small artifacts of each kind."""

from __future__ import annotations

import numpy as np
import pytest

from artifacts import write_artifact
from tests.artifacts.samples import PROVENANCE, demos_arrays


@pytest.fixture
def demos(tmp_path):
    return write_artifact(tmp_path / "x.demos.h5", "demos", demos_arrays(), **PROVENANCE)


@pytest.fixture
def translator(tmp_path, demos):
    weights = {"weights/encoder/0": np.arange(6, dtype=np.float32).reshape(2, 3)}
    return write_artifact(tmp_path / "x.translator.h5", "translator", weights, **PROVENANCE, parents=[demos])


@pytest.fixture
def leftovers(tmp_path):
    """A function that lists temporary files under tmp_path."""
    return lambda: [path.name for path in tmp_path.rglob(".*")]
