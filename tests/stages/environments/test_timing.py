"""When episodes show the frames of a video."""

import numpy as np
import pytest

from stages.environments.timing import Timing


def test_regular_frames_are_those_of_a_simulated_task():
    timing = Timing.regular(7, 3)
    assert timing.frame_steps == (0, 3, 6) and timing.frames == 3 and timing.period == 3
    assert [timing.frame_at(step) for step in range(8)] == [0, None, None, 1, None, None, 2, None]
    np.testing.assert_array_equal(timing.last_frames(), [0, 0, 0, 1, 1, 1, 2, 2])


def test_frames_are_spread_from_the_first_observation_to_the_last():
    timing = Timing.spread(10, 4)
    assert timing.frame_steps == (0, 3, 7, 10) and timing.control_steps == 10 and timing.period == 3
    np.testing.assert_array_equal(timing.last_frames(), [0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 3])
    assert Timing.spread(500, 25).frame_steps[-2:] == (479, 500)
    assert Timing.spread(3, 4).frame_steps == (0, 1, 2, 3)


@pytest.mark.parametrize(("steps", "frames"), [(3, 5), (10, 1)])
def test_frames_that_do_not_fit_are_refused(steps, frames):
    with pytest.raises(ValueError, match=f"{frames} frames do not fit into {steps}"):
        Timing.spread(steps, frames)
