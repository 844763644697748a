"""Environments of Gymnasium with MuJoCo underneath: the camera moves, and images are small and plain."""

from contextlib import closing

import numpy as np
import pytest

from stages.environments.making import EnvironmentFault, episode_limit, frame_of, make_environment, rendered
from stages.environments.spec import EnvironmentSpec
from stages.environments.viewpoints import Viewpoint

pytestmark = pytest.mark.gl
HERE = "tests.stages.environments.slides"


def shown(viewpoint=None, size=(48, 48), **kwargs):
    """The environment's frame, and the pose of the viewer's camera."""
    spec = EnvironmentSpec("Reacher-v5", kwargs, 0, 50, 25, size, None, viewpoint)
    with closing(make_environment(spec)) as env:
        env.reset(seed=0)
        image = rendered(env, spec)
        viewer = env.unwrapped.mujoco_renderer.viewer
        pose = viewer.cam.azimuth, viewer.cam.elevation, viewer.cam.distance, *viewer.cam.lookat
        return frame_of(image, spec), image, pose, env.unwrapped.model.vis.quality


def test_a_viewpoint_is_relative_to_the_environments_own_camera():
    own, _, (azimuth, elevation, distance, *at), _ = shown()
    same, _, pose, _ = shown(Viewpoint())
    np.testing.assert_array_equal(own, same)
    assert pose == pytest.approx((azimuth, elevation, distance, *at))
    moved, _, pose, _ = shown(Viewpoint(30, -10, 0.5))
    assert pose == pytest.approx((azimuth + 30, elevation - 10, 0.5 * distance, *at))
    assert (moved != own).mean() > 0.2


def test_images_are_twice_as_large_as_frames_unless_the_user_chose_their_size():
    frame, image, _, quality = shown()
    assert image.shape == (96, 96, 3) and frame.shape == (48, 48, 3)
    assert quality.offsamples == 0 and quality.shadowsize == 0
    assert shown(width=120, height=120)[1].shape == (120, 120, 3)
    assert shown(size=(16, 24))[1].shape == (48, 48, 3), "in the environment's own aspect ratio"


def test_a_camera_of_the_model_moves_around_what_it_looks_at():
    frames = []
    for viewpoint in (None, Viewpoint(), Viewpoint(60, 0, 1)):
        spec = EnvironmentSpec("HalfCheetah-v5", {"camera_name": "track"}, 0, 100, 25, (48, 48), None, viewpoint)
        with closing(make_environment(spec)) as env:
            env.reset(seed=0)
            frames.append(frame_of(rendered(env, spec), spec).astype(float))
    own, same, moved = frames
    assert np.abs(same - own).mean() < 0.05 * np.abs(moved - own).mean(), "a free camera with the same pose"


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_environments_of_dm_control_are_seen_from_anywhere_too():
    frames = []
    for viewpoint in (None, Viewpoint(), Viewpoint(60, 0, 0.7)):
        spec = EnvironmentSpec("dm_control/reacher-easy-v0", {}, 0, 0, 25, (48, 48), None, viewpoint)
        with closing(make_environment(spec)) as env:
            observation, _ = env.reset(seed=0)
            assert observation.shape == (6,) and env.get_wrapper_attr("can_move")
            assert episode_limit(env) == 1000
            image = rendered(env, spec)
            assert image.shape == (96, 96, 3)
            frames.append(frame_of(image, spec).astype(float))
    own, same, moved = frames
    np.testing.assert_array_equal(own, same)
    assert np.abs(moved - own).mean() > 5


def test_where_no_camera_can_be_moved_a_viewpoint_is_refused():
    spec = EnvironmentSpec(f"{HERE}:Slide", {}, 0, 10, 3, (16, 16), None, Viewpoint(10, 0, 1))
    with pytest.raises(EnvironmentFault, match="leave --viewpoint out"):
        make_environment(spec)
