"""Torch's states become trees of arrays and back, sharing no memory."""

import collections

import numpy as np
import pytest
import torch

from stages.runtime.trees import check_optimiser, from_tree, to_tree


def test_tensors_become_arrays_wherever_they_are():
    tensor = torch.arange(4.0, requires_grad=True)
    tree = to_tree({"a": [tensor, {"b": (tensor, 3)}], 5: None, "s": "x"})
    assert isinstance(tree["a"][0], np.ndarray) and tree["a"][0].dtype == np.float32
    assert isinstance(tree["a"][1]["b"], tuple) and tree["a"][1]["b"][1] == 3
    assert tree[5] is None and tree["s"] == "x"
    tree["a"][0][0] = 9
    assert tensor[0] == 0 and tree["a"][1]["b"][0][0] == 0, "copies"


def test_arrays_become_tensors_wherever_they_are():
    array = np.arange(4)
    tree = from_tree({"a": [array, {"b": (array, 3)}], 5: None, "s": "x"})
    assert torch.equal(tree["a"][0], torch.arange(4)) and isinstance(tree["a"], list)
    assert isinstance(tree["a"][1]["b"], tuple) and tree["a"][1]["b"][1] == 3
    assert tree[5] is None and tree["s"] == "x"
    tree["a"][0][0] = 9
    assert array[0] == 0, "copies"


def test_there_and_back_is_the_same():
    state = torch.optim.Adam(torch.nn.Linear(2, 2).parameters()).state_dict()
    assert from_tree(to_tree(state)) == state
    ordered = torch.nn.Linear(2, 2).state_dict()
    assert isinstance(ordered, collections.OrderedDict)
    again = from_tree(to_tree(ordered))
    assert list(again) == list(ordered) and all(torch.equal(again[name], ordered[name]) for name in ordered)


def test_the_byte_order_in_a_file_does_not_matter():
    assert torch.equal(from_tree(np.arange(3, dtype=">f4")), torch.arange(3.0))


def test_the_state_of_another_optimizer_is_refused():
    def trained(size):
        layer = torch.nn.Linear(size, 2)
        optimiser = torch.optim.Adam(layer.parameters())
        layer(torch.zeros(1, size)).sum().backward()
        optimiser.step()
        return optimiser

    optimiser = trained(3)
    check_optimiser(optimiser)
    optimiser.load_state_dict(trained(4).state_dict())
    with pytest.raises(ValueError, match=r"exp_avg of the optimizer is torch\.float32 of shape \(2, 4\)"):
        check_optimiser(optimiser)
    state = trained(3).state_dict()
    state["state"][0]["step"] = torch.tensor(True)
    optimiser.load_state_dict(state)
    with pytest.raises(ValueError, match=r"step of the optimizer is torch\.bool"):
        check_optimiser(optimiser)
