"""Figures of translated images and features against reference values and closed forms."""

import numpy as np
import pytest
import torch

from stages.translation.metrics import feature_ratio, psnr, squared_error, ssim


def pictures(shift: float) -> np.ndarray:
    """A picture (20, 24, 3) in [0, 1]."""
    rows, columns, colours = np.meshgrid(np.arange(20), np.arange(24), np.arange(3), indexing="ij")
    return 0.5 + 0.4 * np.sin(0.5 * rows + shift) * np.cos(0.3 * columns - 0.7 * colours)


def as_tensor(picture: np.ndarray) -> torch.Tensor:
    """(H, W, 3) in [0, 1] -> (3, H, W) in [-1, 1]."""
    return torch.from_numpy(2 * picture - 1).movedim(-1, 0)


TRUTH = pictures(0.0)
CHANGED = [pictures(0.3), 0.6 * TRUTH, TRUTH**2]
# By scikit-image 0.26 (skimage.metrics), of each `image` in CHANGED:
#   structural_similarity(image, TRUTH, data_range=1, channel_axis=2, gaussian_weights=True, sigma=1.5,
#                         use_sample_covariance=False)
#   peak_signal_noise_ratio(TRUTH, image, data_range=1)
SSIM = [0.9503056095592782, 0.7821186425711942, 0.817661500089764]
PSNR = [24.09499179037169, 13.23821682899501, 13.323964476138242]


def test_ssim_and_psnr_are_those_of_scikit_image():
    images, truth = torch.stack([as_tensor(image) for image in CHANGED]), as_tensor(TRUTH).expand(3, -1, -1, -1)
    torch.testing.assert_close(ssim(images, truth), torch.tensor(SSIM, dtype=torch.float64), rtol=1e-9, atol=0)
    torch.testing.assert_close(psnr(images, truth), torch.tensor(PSNR, dtype=torch.float64), rtol=1e-9, atol=0)
    single = ssim(images.float(), truth.float())
    assert single.dtype == torch.float32
    torch.testing.assert_close(single, torch.tensor(SSIM), rtol=1e-4, atol=0)


def test_ssim_is_one_for_equal_images_and_falls_with_noise():
    truth = torch.rand(2, 3, 48, 48, generator=torch.Generator().manual_seed(0)) * 2 - 1
    noise = torch.randn(truth.shape, generator=torch.Generator().manual_seed(1))
    torch.testing.assert_close(ssim(truth, truth), torch.ones(2))
    slightly, strongly = ssim(truth + 0.1 * noise, truth), ssim(truth + 0.8 * noise, truth)
    assert (slightly < 1).all()
    assert (strongly < slightly).all()


@pytest.mark.parametrize("metric", [psnr, ssim])
def test_colours_that_cannot_be_shown_count_as_the_nearest_that_can(metric):
    """A network's output may leave [-1, 1]; what is shown and judged is clipped."""
    truth = as_tensor(TRUTH)[None]
    too_bright = truth + 1.2
    assert float(too_bright.max()) > 1 > float(too_bright.min())
    torch.testing.assert_close(metric(too_bright, truth), metric(too_bright.clamp(max=1), truth))
    torch.testing.assert_close(metric(-too_bright, truth), metric((-too_bright).clamp(min=-1), truth))
    white = torch.ones_like(truth)
    torch.testing.assert_close(metric(white * 3, white), metric(white, white))


def test_psnr_and_squared_error_of_a_known_difference():
    truth = torch.zeros(2, 4, 3, 8, 8)
    images = torch.full_like(truth, 0.2)  # 0.1 of the range [0, 1]
    images[1] = -0.02
    torch.testing.assert_close(psnr(images, truth), torch.tensor([[20.0], [40.0]]).expand(2, 4))
    torch.testing.assert_close(squared_error(images, truth), torch.tensor([[1.92], [0.0192]]).expand(2, 4))


def test_psnr_of_equal_images_is_a_hundred():
    truth = torch.zeros(1, 3, 8, 8)
    torch.testing.assert_close(psnr(truth, truth), torch.tensor([100.0]))
    torch.testing.assert_close(psnr(truth + 2e-3, truth), torch.tensor([60.0]))


def test_feature_ratio_is_one_for_standing_still_and_zero_for_the_truth():
    truth = torch.randn(3, 5, 4, generator=torch.Generator().manual_seed(0))
    still = truth[:, :1].expand_as(truth)
    torch.testing.assert_close(feature_ratio(still, truth), torch.ones(3))
    torch.testing.assert_close(feature_ratio(truth, truth), torch.zeros(3))


def test_feature_ratio_is_the_error_over_the_motion():
    truth = torch.tensor([[[1.0, 0.0], [3.0, 0.0], [1.0, 4.0]]])  # moves by 2, then is 4 from where it was
    target = truth + torch.tensor([[[0.0, 1.0], [2.0, 0.0], [0.0, 0.0]]])
    torch.testing.assert_close(feature_ratio(target, truth), torch.tensor([5.0 / 20.0]))
    nothing_moves = torch.ones(1, 3, 2)
    assert float(feature_ratio(nothing_moves, nothing_moves)) == 0.0
    torch.testing.assert_close(
        feature_ratio(nothing_moves + 1e-6, nothing_moves), torch.tensor([6.0]), rtol=0.3, atol=0
    )
