"""Translating into a context that is only known as an image, and without the expert at hand."""

import shutil

import numpy as np
import pytest

from artifacts import read_artifact, write_png

pytestmark = pytest.mark.gl


def test_without_the_expert_there_is_a_target_but_no_truth(toy, ifo, tmp_path):
    shutil.copytree(toy.folder / "runs", tmp_path / "runs")
    next((tmp_path / "runs").glob("*.expert.h5")).unlink()
    translator = next((tmp_path / "runs").glob("*.translator.h5"))
    out = tmp_path / "x.translation.h5"
    done = ifo(tmp_path, "translate", translator, "--out", out)
    assert done.returncode == 0, done.stderr
    assert "no comparison with an expert video" in done.stderr
    target = read_artifact(out)
    np.testing.assert_array_equal(target["target_images"], read_artifact(toy.artifact("translation"))["target_images"])
    assert "expert_frames" not in target
    assert ifo(tmp_path, "learn-policy", out, "--iterations", 1).returncode == 0
    done = ifo(tmp_path, "learn-policy", out, "--reward", "video")
    assert done.returncode == 3
    assert "no video of the expert" in done.stderr


def test_a_context_image_can_be_translated_into_but_not_learned_in(toy, ifo, tmp_path):
    picture = tmp_path / "table.png"
    write_png(picture, read_artifact(toy.artifact("demos")).read("frames", (0, 0)))
    out = tmp_path / "x.translation.h5"
    done = ifo(toy.folder, "translate", toy.artifact("translator"), "--context-image", picture, "--out", out)
    assert done.returncode == 0, done.stderr
    assert read_artifact(out, "translation")["images"].shape[1:] == (25, 48, 48, 3)
    done = ifo(toy.folder, "learn-policy", out)
    assert done.returncode == 3
    assert "--context-seed" in done.stderr


def test_a_context_image_of_another_size_is_refused(toy, ifo, tmp_path):
    picture = tmp_path / "table.png"
    write_png(picture, np.zeros((30, 40, 3), np.uint8))
    done = ifo(toy.folder, "translate", toy.artifact("translator"), "--context-image", picture)
    assert done.returncode == 2
    assert "48x48" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
