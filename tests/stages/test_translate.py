"""translate refuses a translator that contradicts the demonstrations that it was trained on."""

from __future__ import annotations

import numpy as np
import pytest

from artifacts import ArtifactError, read_artifact, write_artifact
from stages.translate import _check_demonstrations

CONFIG = {"demonstrations": 6, "held_out_demonstrations": 2, "size": [16, 20]}


@pytest.mark.parametrize(
    "change",
    [
        {"demonstrations": 10**12},
        {"demonstrations": 5},
        {"held_out_demonstrations": 0},
        {"held_out_demonstrations": 6},
        {"size": [20, 16]},
    ],
)
def test_a_configuration_that_contradicts_the_demonstrations(tmp_path, change):
    def written(kind, arrays, config):
        path = tmp_path / f"x.{kind}.h5"
        return read_artifact(write_artifact(path, kind, arrays, config=config, seed=0, command="ifo"))

    demos = written("demos", {"frames": np.zeros((6, 2, 16, 20, 3), np.uint8)}, {})
    _check_demonstrations(written("translator", {"weights/a": np.zeros(2)}, CONFIG), demos)
    with pytest.raises(ArtifactError, match=r"x\.translator\.h5: .*x\.demos\.h5, which has 6 demonstrations of 20x16"):
        _check_demonstrations(written("translator", {"weights/a": np.zeros(2)}, CONFIG | change), demos)
