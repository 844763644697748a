"""Held-out metrics are means over frames of translations that are made here one by one."""

import numpy as np
import pytest
import torch

from stages.translation import evaluation
from stages.translation.evaluation import draw_translations, evaluate_translator
from stages.translation.metrics import psnr, ssim
from stages.translation.networks import CompactTranslator, RealTranslator, to_frames, to_images


@pytest.fixture
def model():
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(1)
        made = CompactTranslator((16, 16), 12, 8, 8, 16)
        for parameter in made.parameters():
            parameter.data += 0.05 * torch.randn_like(parameter)
    return made


@pytest.mark.parametrize("chunk", [2, 8])
def test_each_video_is_translated_into_the_context_of_the_one_before(model, chunk, monkeypatch):
    monkeypatch.setattr(evaluation, "CHUNK", chunk)
    count, times = 5, 4
    rng = np.random.default_rng(0)
    frames = torch.from_numpy(rng.integers(0, 256, (count, times, 16, 16, 3), dtype=np.uint8))
    found = evaluate_translator(model, frames, "cpu")
    images = to_images(frames)
    rows, ratios = [], []
    with torch.no_grad():
        for j in range(count):
            context = model.encode_context(images[j, :1])
            own, other = model.encode(images[j]), model.encode(images[(j + 1) % count])
            z3 = model.translate(other, context)
            made, again = model.decode(z3, context), model.decode(own, context)
            for t in range(1, times):
                truth, copied = images[j, t : t + 1], images[j, :1]
                rows.append(
                    {
                        "psnr": psnr(made[t : t + 1], truth),
                        "copy_psnr": psnr(copied, truth),
                        "ssim": ssim(made[t : t + 1], truth),
                        "copy_ssim": ssim(copied, truth),
                        "trans": (made[t] - truth).square().sum() / 4,
                        "copy_trans": (copied - truth).square().sum() / 4,
                        "rec": (again[t] - truth).square().sum() / 4,
                        "align": (z3[t] - own[t]).square().sum(),
                        "copy_align": (own[0] - own[t]).square().sum(),
                    }
                )
            ratios.append(float((z3 - own).square().sum() / (own - own[0]).square().sum()))
    assert set(found) == {*rows[0], "feature_ratio"}
    for name in rows[0]:
        assert found[name] == pytest.approx(np.mean([float(row[name]) for row in rows]), rel=1e-4), name
    assert found["feature_ratio"] == pytest.approx(np.median(ratios), rel=1e-4)


def test_dropout_is_off_while_it_is_measured_and_then_on_again():
    model = RealTranslator((16, 16))
    frames = torch.from_numpy(np.random.default_rng(0).integers(0, 256, (2, 3, 16, 16, 3), dtype=np.uint8))
    first = evaluate_translator(model, frames, "cpu")
    assert model.training
    assert evaluate_translator(model, frames, "cpu") == first
    model.eval()
    assert evaluate_translator(model, frames, "cpu") == first and not model.training


def test_a_picture_shows_sources_translations_and_true_videos(model, monkeypatch):
    monkeypatch.setattr(evaluation, "DRAWN_HEIGHT", 32)
    asked = {}

    def tiled(rows, **options):
        asked.update(options, rows=np.array(rows))
        return np.zeros((1, 2, 2, 3), np.uint8)

    monkeypatch.setattr(evaluation, "tile_videos", tiled)
    rng = np.random.default_rng(0)
    frames = torch.from_numpy(rng.integers(0, 256, (4, 9, 16, 16, 3), dtype=np.uint8))
    assert draw_translations(model.train(), frames, "cpu").shape == (2, 2, 3)
    assert model.training and asked["scale"] == 2
    assert asked["row_labels"] == ["source", "translation", "true video"] * 3
    images, moments = to_images(frames), [0, 2, 4, 6, 8]
    with torch.no_grad():
        for k in range(3):
            source, made, truth = asked["rows"][3 * k : 3 * k + 3]
            context = model.encode_context(images[k, :1])
            expected = model.decode(model.translate(model.encode(images[k + 1, moments]), context), context)
            np.testing.assert_array_equal(source, frames[k + 1, moments])
            np.testing.assert_array_equal(truth, frames[k, moments])
            np.testing.assert_allclose(made.astype(int), to_frames(expected).int(), atol=1)
    draw_translations(model, frames[:2, :2], "cpu")
    assert asked["rows"].shape == (6, 2, 16, 16, 3), "two videos of two frames"
