"""Which frames are taken: those that a player shows at the wanted times."""

from types import SimpleNamespace

import numpy as np
import pytest

from artifacts import ArtifactError
from stages.footage.moments import Segment, choose_frames


def footage(times=None, last=0.1, cut=""):
    """A video with these time stamps: twenty, ten a second."""
    times = np.arange(20) / 10 if times is None else np.asarray(times, float)
    return SimpleNamespace(label="x.mp4", times=times, duration=float(times[-1]) + last, cut=cut)


@pytest.mark.parametrize(
    ("segment", "indices", "behind"),
    [
        (Segment(4), [0, 6, 12, 19], 0),
        (Segment(2), [0, 19], 0),
        (Segment(3, start=0.5), [5, 12, 19], 0),
        (Segment(3, start=0.5, end=1.5), [5, 10, 15], 0),
        (Segment(3, end=2.0), [0, 10, 19], 0),
        (Segment(3, end=1.04), [0, 5, 10], 0),
        (Segment(4, fps=5), [0, 2, 4, 6], 0),
        (Segment(4, fps=10, start=0.3), [3, 4, 5, 6], 0),
        (Segment(5, fps=2), [0, 5, 10, 15, 19], 1),  # 2.0 s lies behind the end
        (Segment(5, fps=1), [0, 10, 19, 19, 19], 3),
        (Segment(2, fps=1 / 1.99), [0, 19], 0),
        (Segment(4, fps=30), [0, 0, 0, 1], 0),
        (Segment(3, end=0.2003), [0, 1, 2], 0),
    ],
)
def test_the_last_frame_not_after_the_wanted_time_is_shown(segment, indices, behind):
    found, late = choose_frames(footage(), segment)
    assert (found.tolist(), late) == (indices, behind)


def test_frames_of_changing_rate_are_shown_until_the_next_comes():
    found, _ = choose_frames(footage([0.0, 0.1, 1.0, 1.05, 3.0]), Segment(7))
    assert found.tolist() == [0, 1, 2, 3, 3, 3, 4]


def test_times_that_a_container_rounded_are_met():
    rounded = np.round(np.arange(31) / 30, 3)
    found, _ = choose_frames(footage(rounded), Segment(31, fps=30))
    assert found.tolist() == list(range(31))
    found, _ = choose_frames(footage(np.arange(31) / 30 + 0.0004 * (np.arange(31) < 30)), Segment(31, end=1.0))
    assert found.tolist() == list(range(31))


@pytest.mark.parametrize(
    ("made", "segment", "message"),
    [
        (footage([0.0]), Segment(3), "x.mp4: has only one frame"),
        (footage(), Segment(3, start=2.0), r"is 2\.00 s long, which does not reach --start 2"),
        (footage(), Segment(3, start=2.5), "does not reach --start 2.5"),
        (footage(), Segment(3, end=2.1), r"is 2\.00 s long, less than --end 2\.1"),
        (footage(), Segment(3, start=1.0, end=1.05), r"has only one frame between 1\.00 and 1\.05 s"),
        (footage(), Segment(3, start=1.95), r"has only one frame between 1\.95 and 1\.95 s"),
        (
            footage(cut="holds 20 of 25 frames"),
            Segment(3),
            r"x\.mp4: holds 20 of 25 frames: get the complete file, .* up to 1\.90 s",
        ),
        (footage(cut="is truncated"), Segment(3, end=1.95), "is truncated"),
        (footage(cut="is truncated"), Segment(3, fps=1), "is truncated"),
    ],
)
def test_videos_that_do_not_reach_are_refused(made, segment, message):
    with pytest.raises(ArtifactError, match=message) as caught:
        choose_frames(made, segment)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("segment", [Segment(3, end=1.9), Segment(3, fps=2), Segment(3, start=0.5, end=1.0)])
def test_what_is_there_of_a_truncated_video_may_be_taken(segment):
    whole, cut = (choose_frames(footage(cut=cut), segment) for cut in ("", "is truncated"))
    np.testing.assert_array_equal(whole[0], cut[0])


def test_an_end_a_rounding_error_beyond_the_video_is_its_end():
    assert choose_frames(footage(), Segment(3, end=2.0004))[0].tolist() == [0, 10, 19]
