"""Videos of policies are large, say how far the policy is, and change nothing that is learned from."""

from contextlib import closing

import numpy as np
import pytest

from stages.config.demonstrations import Crop
from stages.environments.making import EnvironmentFault
from stages.environments.scene import picture_spec
from stages.environments.spec import EnvironmentSpec
from stages.reporting import films
from stages.reporting.films import captioned, enlarged, factor_for, film_environment, film_task
from stages.simulation.batch import rollout
from stages.simulation.registry import distribution, learner_context, make_task
from stages.simulation.render import TileRenderer
from tests.stages.environments.test_foreign import spec


class Always:
    """A policy with one action."""

    def __init__(self, *action):
        self._action = np.array(action, np.float32)

    def act(self, observation, noise=None):
        return np.tile(self._action, (len(observation), 1))


@pytest.fixture
def said(monkeypatch):
    """The notes below the pictures of a film."""
    notes = []

    def kept(pictures, texts=()):
        notes.extend(texts)
        return captioned(pictures, texts)

    monkeypatch.setattr(films, "captioned", kept)
    return notes


def test_captions_count_frames_and_leave_pictures_as_they_are():
    pictures = np.random.default_rng(0).integers(0, 255, (3, 240, 260, 3), dtype=np.uint8)
    for notes in ((), ["distance 1.00", "distance 0.50", "distance 0.50"]):
        made = captioned(pictures, notes)
        assert made.shape == (3, 264, 260, 3)
        np.testing.assert_array_equal(made[:, :240], pictures)
        lines = made[:, 240:]
        half = round(260 * films.COUNTER) if notes else 260
        assert len({line[:, :half].tobytes() for line in lines}) == 3, "each frame has its own number"
        assert (lines[:, :, :half].min(axis=(1, 2, 3)) < 60).all(), "drawn in black"
        if notes:
            assert (lines[1, :, half:] == lines[2, :, half:]).all() and (lines[0, :, half:] != lines[1, :, half:]).any()


@pytest.mark.parametrize(("height", "factor"), [(48, 5), (64, 4), (84, 3), (239, 2), (240, 1), (480, 1)])
def test_small_frames_are_enlarged_by_a_whole_factor(height, factor):
    assert factor_for(height) == factor
    frames = np.random.default_rng(0).integers(0, 255, (2, height, 8, 3), dtype=np.uint8)
    np.testing.assert_array_equal(enlarged(frames)[:, ::factor, ::factor], frames)


@pytest.mark.gl
@pytest.mark.parametrize("name", ["reach", "dm:reacher-easy"])
def test_a_film_of_a_task_shows_the_episode_and_the_normalized_distance(said, name):
    task = make_task(name)
    context = learner_context(task, 4, distribution("paper"))
    policy = Always(*[0.3] * task.action_size)
    film = film_task(task, policy, context)
    assert film.shape == (task.frames, 264, 240, 3) and film.dtype == np.uint8
    episode = rollout(task, context, *task.context_state(context), lambda state, _: policy.act(task.observe(state)), 1)
    expected = []
    for step in range(0, task.control_steps, task.frame_every):
        initial, final = task.outcome(episode.distance[:, : step + 1])
        expected.append(f"distance {final[0] / initial[0]:.2f}")
    assert said == expected and len(set(said)) > 1
    with closing(TileRenderer(task.model, 240, 240, task.camera, fine=True)) as renderer:
        first = renderer.render(task.model_fields(context), episode.frame_qpos(task)[:, :1])[0, 0]
    np.testing.assert_array_equal(film[0, :240], first)
    with closing(TileRenderer(task.model, *task.frame_size, task.camera)) as renderer:
        plain = renderer.render(task.model_fields(context), episode.frame_qpos(task))[0]
    small = film[:, :240].reshape(task.frames, 48, 5, 48, 5, 3).mean(axis=(2, 4))
    assert np.abs(small - plain).mean() < 12, "the same scene from the same viewpoint"


@pytest.mark.gl
def test_pictures_of_the_same_pose_are_equal():
    """Shadows had specks in some frames when several were drawn before they were read back."""
    task = make_task("reach")
    context = learner_context(task, 4, distribution("paper"))
    qpos = np.repeat(task.context_state(context)[0][:, None], 25, axis=1)
    with closing(TileRenderer(task.model, 240, 240, fine=True)) as renderer:
        drawn = renderer.render(task.model_fields(context), qpos)[0]
    assert (drawn == drawn[0]).all()


def test_a_film_of_an_environment_says_how_the_episode_ends(said):
    for action, kwargs, ending in (
        ((1.0, 0.0), {}, "succeeds"),
        ((-1.0, 0.0), {}, "fails"),
        ((0.0, 0.0), {"report": ""}, "return -"),
    ):
        said.clear()
        film = film_environment(spec(**kwargs), Always(*action))
        assert film.shape == (3, 256 + 24, 256, 3), "32 pixels, all that it renders, enlarged"
        assert len(said) == 3 and all(note.startswith(ending) for note in said)


def test_environments_are_rendered_as_large_as_they_can():
    assert picture_spec(spec(), 15).size == (32, 32), "its images have 32 pixels"
    assert picture_spec(spec(width=96, height=64), 15).size == (64, 64), "with the aspect ratio of frames"
    assert picture_spec(spec(width=96, height=96), 5).size == (80, 80)
    assert picture_spec(spec(crop=Crop(2, 2, 24, 24)), 5).size == (16, 16)
    larger = picture_spec(spec(seed=7), 2)
    assert larger == spec(seed=7, size=(32, 32)), "nothing else changes"
    for broken in ("reset", "render", "frame"):
        with pytest.raises(EnvironmentFault, match="Slide"):
            picture_spec(spec(broken=broken), 2)


@pytest.mark.gl
def test_mujoco_renders_larger_images():
    found = picture_spec(EnvironmentSpec("Reacher-v5", {}, 0, 50, 25, (48, 48)), 5)
    assert found.size == (240, 240)
