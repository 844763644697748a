"""learn-policy refuses a translation that does not fit the task, or that holds nothing to track."""

from __future__ import annotations

import numpy as np
import pytest

from artifacts import ArtifactError, read_artifact, write_artifact
from stages.learn_policy import _check_frames
from stages.rewards.tracking import TrackingTarget
from stages.simulation.tasks.reach import Reach


@pytest.fixture
def translation(tmp_path):
    """A function that writes a translation and opens it."""

    def write(frames=25, side=48, **arrays):
        arrays = {
            "context_frame": np.zeros((side, side, 3), np.uint8),
            "target_features": np.zeros((frames, 4), np.float32),
            "target_images": np.zeros((frames, side, side, 3), np.float32),
            "feature_scale": np.float32(1),
            "image_scale": np.float32(1),
            **arrays,
        }
        path = tmp_path / "x.translation.h5"
        return read_artifact(write_artifact(path, "translation", arrays, config={}, seed=0, command="ifo"))

    return write


def test_a_translation_has_the_frames_of_the_task(translation):
    wanted = (Reach().frames, *Reach().frame_size)
    _check_frames(translation(), "task reach", wanted)
    for size in ({"frames": 24}, {"side": 16}):
        with pytest.raises(ArtifactError, match=r"x\.translation\.h5: .* do not fit task reach, which has 25 of 48x48"):
            _check_frames(translation(**size), "task reach", wanted)


@pytest.mark.parametrize("scale", ["feature_scale", "image_scale"])
def test_what_does_not_move_cannot_be_tracked(translation, scale):
    assert TrackingTarget.of(translation(), 0.0).feature_scale == 1
    for value in (0, -1):
        with pytest.raises(
            ArtifactError, match=rf"x\.translation\.h5: its demonstrations do not move.*{scale} {value}"
        ):
            TrackingTarget.of(translation(**{scale: np.float32(value)}), 0.0)


def test_targets_in_any_type_of_number_are_tracked(translation):
    target = TrackingTarget.of(translation(target_features=np.ones((25, 4), ">f8")), 0.0)
    assert (target.features == 1).all()
