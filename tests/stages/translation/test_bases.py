"""Weights of a translator, fitted to another frame size."""

import pytest
import torch

from artifacts import ArtifactError, read_artifact, write_artifact
from stages.translation.bases import READS_GRID, WRITES_GRID, architecture, base_weights
from stages.translation.networks import NETWORKS, make_translator


def translator(folder, arch, size, seed=0):
    torch.manual_seed(seed)
    model = make_translator(arch, size)
    arrays = {f"weights/{name}": value.numpy() for name, value in model.state_dict().items()}
    path = folder / f"{arch}.translator.h5"
    write_artifact(path, "translator", arrays, config={"arch": arch, "size": list(size)}, seed=0, command="ifo test")
    return model, read_artifact(path)


@pytest.mark.parametrize("arch", ["compact", "real", "paper"])
def test_another_frame_size_keeps_convolutions_and_the_features_of_constant_activations(tmp_path, arch):
    old, new = (16, 24), (32, 20)
    model, artifact = translator(tmp_path, arch, old)
    weights = base_weights(artifact, new)
    other = make_translator(arch, new)
    other.load_state_dict(weights)
    before, after = NETWORKS[arch].coarse_grid(old), NETWORKS[arch].coarse_grid(new)
    assert before != after
    channels = torch.randn(before[0])
    changed = set()
    for name, value in model.state_dict().items():
        if name in READS_GRID:
            read = [
                channels[:, None, None].expand(grid).flatten() @ held.T
                for grid, held in ((before, value), (after, weights[name]))
            ]
            torch.testing.assert_close(read[0], read[1], rtol=1e-4, atol=1e-4)
            changed.add(name)
        elif name in WRITES_GRID:
            changed.add(name)  # See the next test.
        else:
            assert torch.equal(value, weights[name]), name
    assert {"dec_head.weight", "dec_head.bias"} < changed


def test_resampling_writes_each_position_as_its_neighbors_did(tmp_path):
    model, artifact = translator(tmp_path, "compact", (16, 16))
    # Each position writes its column number: the finer grid writes the numbers between, in the same order.
    channels, height, width = NETWORKS["compact"].coarse_grid((16, 16))
    columns = torch.arange(width, dtype=torch.float32).expand(channels, height, width)
    arrays = {f"weights/{name}": value.numpy() for name, value in model.state_dict().items()}
    arrays["weights/dec_head.bias"] = columns.flatten().numpy()
    path = tmp_path / "columns.translator.h5"
    write_artifact(path, "translator", arrays, config=dict(artifact.config), seed=0, command="ifo test")
    written = base_weights(read_artifact(path), (16, 32))["dec_head.bias"].reshape(channels, height, 2 * width)
    expected = torch.tensor([0.0, 0.25, 0.75, 1.0])
    assert width == 2
    torch.testing.assert_close(written, expected.expand_as(written))


def test_the_same_frame_size_keeps_every_weight(tmp_path):
    model, artifact = translator(tmp_path, "compact", (16, 16))
    weights = base_weights(artifact, (16, 16))
    assert all(torch.equal(value, weights[name]) for name, value in model.state_dict().items())


def test_an_unknown_architecture_is_refused(tmp_path):
    path = tmp_path / "odd.translator.h5"
    _, artifact = translator(tmp_path, "compact", (16, 16))
    arrays = {name: artifact[name] for name in artifact.names()}
    write_artifact(path, "translator", arrays, config={"arch": "vast", "size": [16, 16]}, seed=0, command="ifo test")
    with pytest.raises(ArtifactError, match="unknown architecture 'vast'"):
        architecture(read_artifact(path))
