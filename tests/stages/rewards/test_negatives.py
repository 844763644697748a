"""Tuning on negatives mends features that rate the learner's frames too kindly, and resumes bit for bit."""

import numpy as np
import pytest
import torch

from artifacts import UsageError, pack, unpack
from stages.config.stages import PolicyConfig
from stages.learn_policy import learn_policy
from stages.rewards.negatives import BATCH, CAPACITY, NegativeTuning
from stages.rewards.tracking import TrackingTarget, motion
from stages.runtime.progress import Progress
from stages.runtime.run import RunOptions
from stages.translation.networks import to_images

T, SIZE = 4, 16


def video(row: int, seed: int) -> np.ndarray:
    """A square that moves right along `row` (T, H, W, 3), with a little noise."""
    frames = np.random.default_rng(seed).integers(0, 12, (T, SIZE, SIZE, 3), dtype=np.uint8)
    for t in range(T):
        frames[t, row : row + 4, 3 * t : 3 * t + 4] = 220
    return frames


class Blind(torch.nn.Module):
    """Features of columns' means, and of single pixels with weights that start at zero."""

    def __init__(self):
        super().__init__()
        generator = torch.Generator().manual_seed(0)
        self.columns = torch.nn.Parameter(torch.randn(8, 3 * SIZE, generator=generator))
        self.pixels = torch.nn.Parameter(torch.zeros(8, 3 * SIZE * SIZE))

    def encode(self, images: torch.Tensor) -> torch.Tensor:
        return images.mean(dim=2).flatten(1) @ self.columns.T + images.flatten(1) @ self.pixels.T


@pytest.fixture
def tuning():
    """Features that are blind to rows, for which a square on a wrong row looks like a demonstration."""
    positives = np.stack([video(2, seed) for seed in range(20)])
    model = Blind()
    model.requires_grad_(False)
    images = to_images(torch.from_numpy(positives))
    features = model.encode(images.flatten(0, 1)).unflatten(0, images.shape[:2])
    scales = float(motion(features).mean()), float(motion(images).mean())
    target = TrackingTarget(features.mean(dim=0), images.mean(dim=0), *scales)
    return NegativeTuning(model, target, positives, every=1, seed=0, device="cpu")


def watch(tuning: NegativeTuning) -> None:
    for t in range(1, T):
        tuning.see(t, np.stack([video(10, 100 + k)[t] for k in range(8)]))


def gaps(tuning: NegativeTuning) -> tuple[float, float]:
    """Mean feature distances from the target, of unseen demonstrations and of unseen negatives."""
    times = torch.arange(1, T)
    found = []
    for row in (2, 10):
        images = to_images(torch.from_numpy(np.stack([video(row, 1000 + k) for k in range(10)])))[:, 1:]
        judged = [tuning._judge(times, one).features.mean() for one in images]
        found.append(float(torch.stack(judged).mean()))
    return found[0], found[1]


def test_tuned_features_put_unseen_negatives_behind_unseen_demonstrations(tuning):
    watch(tuning)
    with torch.no_grad():
        good, bad = gaps(tuning)
    assert bad < 3 * good, "they start hardly told apart"
    first = tuning.iterate()
    for _ in range(15):
        last = tuning.iterate()
    with torch.no_grad():
        tuned_good, tuned_bad = gaps(tuning)
    assert tuned_bad > bad + 0.5
    assert tuned_bad > 3 * tuned_good
    assert last >= first
    assert last > 0.95


def test_a_learner_that_does_as_demonstrated_changes_little(tuning):
    for t in range(1, T):
        tuning.see(t, np.stack([video(2, 100 + k)[t] for k in range(8)]))
    images = to_images(torch.from_numpy(video(2, 7)))
    before = tuning.model.encode(images).detach()
    for _ in range(5):
        tuning.iterate()
    moved = (tuning.model.encode(images) - before).square().sum().item()
    assert moved < 0.05 * tuning._target.feature_scale


def test_it_tunes_every_so_many_iterations(tuning):
    tuning.every = 3
    watch(tuning)
    start = tuning.model.pixels.detach().clone()
    changed = []
    for _ in range(6):
        tuning.iterate()
        changed.append(not torch.equal(tuning.model.pixels, start))
        start = tuning.model.pixels.detach().clone()
    assert changed == [False, False, True, False, False, True]
    assert not torch.equal(tuning.model.pixels, tuning._original.pixels)


def test_a_batch_draws_from_all_demonstrations_and_all_frames_seen_at_a_time(tuning):
    watch(tuning)
    times, *pairs = tuning._batch(np.random.default_rng(0))
    assert set(times.tolist()) == {1, 2, 3} and len(times) == BATCH
    seen = np.stack([video(10, 100 + k) for k in range(8)])
    for images, videos in zip(pairs, (tuning._positives, seen), strict=True):
        drawn = [
            [torch.equal(image, other[int(time)]) for other in to_images(torch.from_numpy(videos))].index(True)
            for time, image in zip(times, images, strict=True)
        ]
        assert set(drawn) == set(range(len(videos)))


def test_the_oldest_frames_make_way(tuning):
    for k in range(CAPACITY + 3):
        tuning.see(1, np.full((1, SIZE, SIZE, 3), k, np.uint8))
    assert sorted(tuning._seen[1, :, 0, 0, 0].tolist()) == list(range(3, CAPACITY + 3))


def test_a_restored_tuning_goes_on_bit_for_bit(tuning):
    watch(tuning)
    tuning.iterate()
    again = NegativeTuning(tuning._original, tuning._target, tuning._positives, 1, 0, "cpu")
    again.restore(unpack(*pack(tuning.state())))
    assert tuning.iterate() == again.iterate()
    for name, value in tuning.model.state_dict().items():
        assert torch.equal(value, again.model.state_dict()[name]), name


@pytest.mark.parametrize(
    "options", [{"reward": "oracle"}, {"reward": "video"}, {"without": ("feat",)}, {"patience": 5}, {"learner": "sac"}]
)
def test_negatives_go_with_the_features_of_a_translation(options, tmp_path):
    run = RunOptions(
        preset="toy", seed=0, device="cpu", workers=1, out=None, resume=False, command="", progress=Progress(quiet=True)
    )
    with pytest.raises(UsageError, match="--negatives"):
        learn_policy(PolicyConfig(negatives=2, **options), run, tmp_path / "none.translation.h5")
