"""Videos of their own tempo go through the pipeline, aligned, and a killed training resumes with its alignment."""

import numpy as np
import pytest

from artifacts import read_artifact

pytestmark = pytest.mark.gl
TRAIN = ("--align", "dtw", "--steps", 20, "--evaluate-every", 20, "--checkpoint-every", 5)


@pytest.fixture(scope="module")
def demos(ifo, tmp_path_factory):
    folder = tmp_path_factory.mktemp("jitter")
    words = ("collect-demos", "reach", "--preset", "toy", "-n", 24, "--jitter", 0.4, "--out", "j.demos.h5")
    done = ifo(folder, *words)
    assert done.returncode == 0, done.stderr
    return folder / "j.demos.h5"


def test_jittered_videos_start_alike_and_differ_then(demos):
    artifact = read_artifact(demos, "demos")
    playback = artifact["playback"]
    assert playback.shape == artifact["frames"].shape[:2]
    assert (playback[:, 0] == 0).all()
    assert np.ptp(playback[:, 10]) > 2


@pytest.mark.slow
def test_aligned_from_training_to_translation(demos, ifo):
    done = ifo(demos.parent, "train-translator", demos, *TRAIN)
    assert done.returncode == 0, done.stderr
    translator = done.stdout.strip()
    aligned = ifo(demos.parent, "translate", translator, "--out", "a.translation.h5")
    assert aligned.returncode == 0, aligned.stderr
    plain = ifo(demos.parent, "translate", translator, "--align", "none", "--out", "b.translation.h5")
    assert plain.returncode == 0, plain.stderr
    one, other = (read_artifact(demos.parent / f"{name}.translation.h5") for name in "ab")
    assert (one.config["align"], other.config["align"]) == ("dtw", "none")
    assert not np.array_equal(one["target_images"], other["target_images"])
    np.testing.assert_array_equal(one["features"][:, 0], other["features"][:, 0])
