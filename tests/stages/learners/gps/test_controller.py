"""Linear-Gaussian controllers: actions and their noise, and the policy that a file holds."""

import dataclasses

import numpy as np
import pytest
import torch

from stages.learners.gps.controller import LinearGaussianController
from stages.learners.policy import ControllerPolicy


def test_a_constant_controller_is_noise_about_zero():
    controller = LinearGaussianController.constant(7, 5, 3, 0.5)
    assert controller.steps == 7
    assert controller.gains.shape == (7, 3, 5) and not controller.gains.any()
    assert controller.offsets.shape == (7, 3) and not controller.offsets.any()
    np.testing.assert_array_equal(controller.covariances, np.tile(0.25 * np.eye(3), (7, 1, 1)))
    assert controller.std() == pytest.approx(0.5)


def test_the_mean_action_is_linear_in_the_state(any_controller):
    controller, states = any_controller(0), np.random.default_rng(1).normal(size=(5, 4))
    for step in (0, 11):
        by_hand = np.einsum("ij,nj->ni", controller.gains[step], states) + controller.offsets[step]
        np.testing.assert_allclose(controller.act(step, states), by_hand)


def test_noise_has_the_covariance_of_its_time_step(any_controller):
    """Of unit vectors as noise, what the actions add is a root of the covariance."""
    controller, states = any_controller(0), np.zeros((2, 4))
    for step in (0, 5):
        root = controller.sample(step, states, np.eye(2)) - controller.act(step, states)
        np.testing.assert_allclose(root.T @ root, controller.covariances[step], rtol=1e-12)
    assert not np.allclose(controller.covariances[0], controller.covariances[5])


def test_a_policys_actions_have_the_covariance_that_its_file_holds(any_controller):
    made = any_controller(0)
    controller = dataclasses.replace(made, covariances=0.01 * made.covariances)  # so that nothing is clipped
    policy, n = ControllerPolicy(controller), 20_000
    for step in (0, 3, 11):
        seen = np.zeros((n, 5), np.float32)
        seen[:, -1] = step / 12
        actions = policy.act(seen, torch.Generator().manual_seed(step))
        assert actions.shape == (n, 2)
        np.testing.assert_allclose(actions.mean(axis=0), controller.offsets[step], atol=0.01)
        scale = controller.covariances[step].max()
        np.testing.assert_allclose(np.cov(actions.T), controller.covariances[step], atol=0.05 * scale)
        np.testing.assert_allclose(policy.act(seen)[0], controller.offsets[step], atol=1e-12)


def test_a_policy_reads_its_time_step_from_the_clock_and_ignores_no_other_entry(any_controller):
    controller = any_controller(0)
    controller = dataclasses.replace(controller, gains=0.1 * controller.gains)
    policy, state = ControllerPolicy(controller), np.array([0.5, -0.2, 0.1, 0.4])
    for clock, step in ((0.0, 0), (1 / 12, 1), (0.9 / 12, 1), (11 / 12, 11), (1.0, 11)):
        seen = np.append(state, clock)[None].repeat(3, axis=0)
        np.testing.assert_allclose(policy.act(seen), controller.act(step, state[None].repeat(3, axis=0)))


def test_a_policys_actions_are_clipped(any_controller):
    controller = dataclasses.replace(any_controller(0), offsets=np.tile([3.0, -3.0], (12, 1)))
    policy, seen = ControllerPolicy(controller), np.zeros((4, 5))
    np.testing.assert_array_equal(policy.act(seen), np.tile([1.0, -1.0], (4, 1)))
    np.testing.assert_array_equal(policy.act(seen, torch.Generator().manual_seed(0)), np.tile([1.0, -1.0], (4, 1)))


def test_widening_leaves_directions_as_they_are():
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    narrow = LinearGaussianController(
        np.zeros((2, 2, 3)),
        np.zeros((2, 2)),
        np.stack([turn @ np.diag(v) @ turn.T for v in ([4.0, 0.01], [0.04, 0.09])]),
    )
    wide = narrow.widened(0.5)
    np.testing.assert_allclose(wide.covariances[0], turn @ np.diag([4.0, 0.25]) @ turn.T)
    np.testing.assert_allclose(wide.covariances[1], 0.25 * np.eye(2), atol=1e-12)


def test_a_lifted_controller_ignores_the_entries_that_are_new(any_controller):
    controller, states = any_controller(0), np.random.default_rng(1).normal(size=(5, 6))
    lifted = controller.lifted(6)
    assert lifted.gains.shape == (12, 2, 6)
    np.testing.assert_allclose(lifted.act(3, states), controller.act(3, states[:, :4]))
    np.testing.assert_array_equal(lifted.covariances, controller.covariances)


def test_std_is_the_mean_over_time_and_actions():
    covariances = np.array([[[1.0, 0.5], [0.5, 9.0]], [[4.0, 0.0], [0.0, 16.0]]])
    assert LinearGaussianController(np.zeros((2, 2, 3)), np.zeros((2, 2)), covariances).std() == pytest.approx(2.5)


def test_arrays_make_the_controller_again_and_wrong_ones_are_refused(any_controller):
    arrays = any_controller(0).arrays()
    again = LinearGaussianController.from_arrays(arrays)
    for name, values in again.arrays().items():
        np.testing.assert_array_equal(values, arrays[name])
    single = LinearGaussianController.from_arrays({name: values.astype(np.float32) for name, values in arrays.items()})
    assert single.gains.dtype == np.float64
    wrong = [
        ({"gains": arrays["gains"][:, :1]}, "do not match"),
        ({"gains": arrays["gains"][:5]}, "do not match"),
        ({"covariances": arrays["covariances"][:5]}, "do not match"),
        ({"covariances": arrays["covariances"][:, :1]}, "do not match"),
        ({"offsets": np.where(np.arange(2), np.inf, arrays["offsets"])}, "finite"),
        ({"covariances": arrays["covariances"] + np.array([[0.0, 1.0], [0.0, 0.0]])}, "not symmetric"),
        ({"covariances": np.tile(np.diag([1.0, -1.0]), (12, 1, 1))}, "positive definite"),
        ({name: values[:0] for name, values in arrays.items()}, "no control step"),
    ]
    for changed, message in wrong:
        with pytest.raises(ValueError, match=message):
            LinearGaussianController.from_arrays({**arrays, **changed})
    with pytest.raises(KeyError, match="offsets"):
        LinearGaussianController.from_arrays({name: arrays[name] for name in ("gains", "covariances")})
