"""A folder of awkward videos gives the right frames, and a line for each that cannot be used."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from artifacts import UsageError, read_artifact, read_mp4, read_png, verify_artifact, write_png
from ifo_cli.main import main
from stages.config.stages import TranslateConfig
from stages.runtime.progress import Progress
from stages.runtime.run import RunOptions
from stages.simulation.registry import distribution, learner_context, make_task
from stages.translate import _simulate_context
from tests.stages.videos import FPS, X265, cut, number_in, picture, write_sound, write_video

ROOT = Path(__file__).parents[2]
T = 7
EVEN = [0, 4, 8, 12, 16, 20, 24]  # of 25 frames, 7 at equal times
VARIABLE = [0, 40, 80, 120, 1000, 1040, 1080, 1500, 2000, 2400, 3000]
GOOD = {
    "anamorphic.mp4": EVEN,
    "animation.gif": EVEN,
    "b-frames.avi": EVEN,
    "b-frames.mp4": EVEN,
    "eight.ts": EVEN,
    "hevc-10-bit.mov": EVEN,
    "long-sound.mkv": EVEN,
    "motion.avi": EVEN,
    "mpeg4.avi": EVEN,
    "odd-444.mp4": EVEN,
    "odd-vp9.webm": EVEN,
    "phone.mp4": EVEN,
    "ten-bit.mkv": EVEN,
    "upside-down.mov": EVEN,
    "variable.mp4": [0, 3, 4, 7, 8, 9, 10],  # shown at 0, .5, 1, 1.5, 2, 2.5 and 3 s
    "vp8.webm": EVEN,
}
BAD = {
    "empty.mp4": "is empty",
    "headless.mp4": "is not a video, or is truncated",
    "no-frames.mkv": "contains no frames",
    "one-frame.mp4": "has only one frame",
    "playlist.mp4": "is not a video",
    "sound.mp4": "contains no video stream",
    "text.mp4": "is not a video",
    "tiny.mkv": "2x2 pixels: expected 16 to 16384",
    "truncated.gif": "is damaged or truncated",
    "truncated.mkv": "is truncated",
    "truncated.mp4": "of 25 frames",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Sixteen good videos and eleven bad ones, among what else lies in a folder."""
    at = tmp_path_factory.mktemp("footage")
    fast = {"preset": "ultrafast", "bf": "2", "g": "8"}
    write_video(at / "anamorphic.mp4", stretch=2, size=(48, 96))
    write_video(at / "animation.gif", "gif", "rgb8")
    write_video(at / "b-frames.avi")
    write_video(at / "b-frames.mp4", options=fast)
    write_video(at / "eight.ts", "libx264", options=fast)
    write_video(at / "hevc-10-bit.mov", "libx265", "yuv420p10le", options=X265)
    write_video(at / "long-sound.mkv", audio=4)
    write_video(at / "motion.avi", "mjpeg", "yuvj420p")
    write_video(at / "mpeg4.avi", "mpeg4", options={"bf": "2"})
    write_video(at / "odd-444.mp4", pixels="yuv444p", size=(49, 63))
    write_video(at / "odd-vp9.webm", "libvpx-vp9", size=(49, 65), options={"cpu-used": "8", "deadline": "realtime"})
    write_video(at / "phone.mp4", turns=3, size=(64, 48))
    write_video(at / "ten-bit.mkv", pixels="yuv420p10le")
    write_video(at / "upside-down.mov", turns=2)
    write_video(at / "variable.mp4", milliseconds=VARIABLE)
    write_video(at / "vp8.webm", "libvpx", options={"auto-alt-ref": "1", "lag-in-frames": "10"})

    (at / "empty.mp4").touch()
    cut(at / "b-frames.mp4", at / "headless.mp4", 0.5)
    cluster = (at / "ten-bit.mkv").read_bytes().index(b"\x1f\x43\xb6\x75")  # where frames begin
    (at / "no-frames.mkv").write_bytes((at / "ten-bit.mkv").read_bytes()[: cluster + 30])
    write_video(at / "one-frame.mp4", count=1)
    (at / "playlist.mp4").write_text("ffconcat version 1.0\nfile 'b-frames.mp4'\n")
    write_sound(at / "sound.mp4")
    (at / "text.mp4").write_text("This is no video.\n" * 40)
    write_video(at / "tiny.mkv", "ffv1", "yuv444p", size=(2, 2))
    cut(at / "animation.gif", at / "truncated.gif", 0.6)
    truncated(at / "truncated.mp4", {"movflags": "+faststart"})
    truncated(at / "truncated.mkv", {})
    (at / "notes.txt").write_text("mine")
    (at / ".hidden.mp4").touch()
    return at


def truncated(path, container):
    """A video of which the last part is missing, though its header tells of it."""
    whole = write_video(path.with_name(f"whole{path.suffix}"), container=container, options={"g": "4"})
    cut(whole, path, 0.85)
    whole.unlink()


@pytest.fixture
def ifo(tmp_path, capfd):
    """A function that runs import-demos, anew each time: (exit code, what --json printed, standard error)."""

    def run(*words, out=tmp_path / "x.demos.h5", frames=T):
        capfd.readouterr()
        options = ["--out", str(out), "--frames", str(frames), "--json", "--overwrite"]
        code = main(["import-demos", *map(str, words), *options])
        printed, said = capfd.readouterr()
        return code, json.loads(printed) if printed else None, said

    return run


def numbers(path):
    """What the frames of an artifact show: name of a video -> numbers (T,)."""
    demos = read_artifact(path, "demos")
    names = [Path(video["name"]).name for video in demos.config["videos"]]
    return {name: [number_in(frame) for frame in video] for name, video in zip(names, demos["frames"], strict=True)}


def test_quiet_tells_only_what_is_left_out(ifo, folder):
    code, result, said = ifo(folder, "--quiet")
    assert code == 0 and result["skipped"]
    assert len(said.splitlines()) == len(BAD) and all(line.startswith("skipped ") for line in said.splitlines())


def test_every_video_is_imported_or_complained_of(ifo, folder, tmp_path):
    code, result, said = ifo(folder)
    assert code == 0, said
    assert numbers(result["path"]) == GOOD
    assert {Path(item["name"]).name for item in result["skipped"]} == set(BAD)
    for name, words in BAD.items():
        [line] = [line for line in said.splitlines() if line.startswith(f"skipped {folder / name}: ")]
        assert words in line
    assert said.count("skipped ") == len(BAD) + 1 and f"skipped {len(BAD)}" in said
    assert result["demos"] == len(GOOD) and verify_artifact(result["path"])
    demos = read_artifact(result["path"])
    assert demos["frames"].shape == (len(GOOD), T, 48, 48, 3)
    videos = {Path(video["name"]).name: video for video in demos.config["videos"]}
    assert (videos["phone.mp4"]["rotation"], videos["phone.mp4"]["size"]) == (270, [48, 64])
    assert (videos["anamorphic.mp4"]["size"], videos["anamorphic.mp4"]["crop"]) == ([96, 48], [24, 0, 48, 48])
    times = dict(zip(videos, demos["times"], strict=True))
    assert times["variable.mp4"] == pytest.approx(np.array(VARIABLE)[GOOD["variable.mp4"]] / 1000)
    assert times["odd-vp9.webm"] == pytest.approx(np.array(EVEN) / FPS)
    assert read_mp4(result["video"]).shape[0] == T and read_png(result["contact_sheet"]).size


def test_the_same_twice_gives_the_same(ifo, folder, tmp_path):
    words = [folder / "phone.mp4", folder / "variable.mp4"]
    first, second = (read_artifact(ifo(*words, out=tmp_path / f"{k}.demos.h5")[1]["path"]) for k in range(2))
    np.testing.assert_array_equal(first["frames"], second["frames"])
    assert first.config == second.config


def test_strict_makes_a_bad_video_fatal_and_writes_nothing(ifo, folder, tmp_path):
    code, printed, said = ifo(folder, "--strict", out=tmp_path / "new" / "x.demos.h5")
    assert (code, printed) == (3, None) and str(folder / "empty.mp4") in said.splitlines()[-1]
    assert not (tmp_path / "new").exists()


def test_nothing_usable_is_an_error(ifo, folder, tmp_path):
    code, printed, said = ifo(folder / "text.mp4", tmp_path / "gone.mp4", out=tmp_path / "new" / "x.demos.h5")
    assert (code, printed) == (3, None) and "none of the 2 videos" in said and not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--start", 0.4, "--end", 1.6], [4, 6, 8, 10, 12, 14, 16]),
        (["--start", 0.45, "--end", 1.65], [4, 6, 8, 10, 12, 14, 16]),  # shown then, not next
        (["--fps", 10, "--start", 0.2], [2, 3, 4, 5, 6, 7, 8]),
        (["--fps", 5, "--start", 1.6], [16, 18, 20, 22, 24, 24, 24]),
        (["--start", 2.1], [21, 21, 22, 22, 23, 23, 24]),
    ],
)
@pytest.mark.parametrize("name", ["b-frames.mp4", "odd-vp9.webm", "mpeg4.avi"])
def test_segments(ifo, folder, name, words, expected):
    code, result, said = ifo(folder / name, *words)
    assert code == 0, said
    assert numbers(result["path"])[name] == expected
    assert ("repeat their last frame" in said) == (expected[-3:] == [24] * 3)
    assert ("repeat some of them" in said) == (words == ["--start", 2.1])


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--start", 2.5], "does not reach --start"),
        (["--end", 2.51], "is 2.50 s long, less than --end 2.51"),
        (["--end", 4], "less than --end 4"),
        (["--start", 0.51, "--end", 0.59], "only one frame"),
        (["--crop", "30,0,48,48"], "extends beyond its image of 64x48"),
    ],
)
def test_a_video_that_does_not_reach_is_left_out(ifo, folder, words, complaint):
    code, _, said = ifo(folder / "b-frames.mp4", *words)
    assert code == 3 and complaint in said and said.splitlines()[-1].startswith("ifo: none of the 1 videos")


def test_a_link_to_nothing_is_named_and_counted(ifo, folder, tmp_path):
    videos = tmp_path / "videos"
    videos.mkdir()
    (videos / "here.mp4").symlink_to(folder / "b-frames.mp4")
    (videos / "gone.mp4").symlink_to(tmp_path / "nothing.mp4")
    code, result, said = ifo(videos)
    assert code == 0 and [Path(skipped["name"]).name for skipped in result["skipped"]] == ["gone.mp4"]
    assert f"skipped {videos / 'gone.mp4'}" in said
    assert ifo(videos, "--strict")[0] == 3


def test_videos_that_the_tasks_learner_does_not_have_are_told_of(ifo, folder):
    assert "push-real has" not in ifo(folder / "b-frames.mp4", "--task", "push-real", frames=25)[2]
    code, _, said = ifo(folder / "b-frames.mp4", "--task", "push-real", frames=7)
    assert code == 0 and "push-real has 25 frames of 48x48 pixels" in said


@pytest.mark.parametrize("name", ["truncated.mp4", "truncated.mkv"])
def test_what_is_left_of_a_truncated_video_can_be_used(ifo, folder, name):
    code, result, said = ifo(folder / name, "--end", 0.6)
    assert code == 0 and "truncated or damaged, but complete in" in said
    assert numbers(result["path"])[name] == [0, 1, 2, 3, 4, 5, 6]
    assert ifo(folder / name, "--fps", 3)[0] == 3
    there = float(re.search(r"up to (\d+\.\d+) s", ifo(folder / name)[2]).group(1))
    assert ifo(folder / name, "--end", there)[0] == 0
    code, _, said = ifo(folder / name, "--end", there + 0.02)
    assert code == 3 and ("use --end to take a segment" in said or "less than --end" in said)


def test_images_in_natural_order(ifo, tmp_path):
    shots = tmp_path / "shots"
    shots.mkdir()
    for k in range(12):
        write_png(shots / f"shot{k + 1}.png", picture(k))
    exif = (
        b"\xff\xe1\x00\x22Exif\x00\x00MM\x00*\x00\x00\x00\x08\x00\x01\x01\x12\x00\x03\x00\x00\x00\x01\x00\x06"
        + bytes(6)
    )
    data = cv2.imencode(".jpg", np.ascontiguousarray(np.rot90(picture(12))[..., ::-1]))[1].tobytes()
    (shots / "shot13.jpg").write_bytes(data[:2] + exif + data[2:])  # lying on its side, and saying so
    code, result, said = ifo(shots)
    assert code == 0, said
    assert numbers(result["path"])["shots"] == [0, 2, 4, 6, 8, 10, 12]
    (shots / "shot13.jpg").write_bytes(data[:-200])
    code, _, said = ifo(shots)
    assert code == 3 and "shot13.jpg: is not a complete PNG or JPEG" in said
    (shots / "shot13.jpg").unlink()
    write_png(shots / "shot12.png", picture(11, 40, 64))
    assert "image size changes" in ifo(shots)[2]


def test_crops(ifo, folder, tmp_path):
    _, result, _ = ifo(folder / "b-frames.mp4", folder / "phone.mp4", "--crop", "8,0,24,48")
    demos = read_artifact(result["path"])
    assert [video["crop"] for video in demos.config["videos"]] == [[8, 0, 24, 48]] * 2
    table = tmp_path / "crops.csv"
    table.write_text(f"video,x,y,w,h\nphone.mp4, 0, 8, 48, 48\n{folder / 'b-frames.mp4'},8,0,48,48\nold.mp4,0,0,9,9\n")
    _, result, said = ifo(folder / "b-frames.mp4", folder / "phone.mp4", "--crop-file", table)
    assert numbers(result["path"]) == {"b-frames.mp4": EVEN, "phone.mp4": EVEN}
    assert "rows that match no video: old.mp4" in said
    code, _, said = ifo(folder / "b-frames.mp4", folder / "variable.mp4", "--crop-file", table)
    assert code == 3 and f"has no row for {folder / 'variable.mp4'}: add one" in said.splitlines()[-1]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("video,x,y,w\na,1,2,3\n", "no column 'h'"),
        ("video,x,y,w,h\na,1,2,3\n", "line 2: expected x,y,w,h"),
        ("video,x,y,w,h\na,1,2,3,0\n", "line 2: expected x,y,w,h"),
        ("video,x,y,w,h\na,1,2,3,4\na,1,2,3,4\n", "second row for a"),
        ("x,y,w,h,video\n1,2,3,4\n", "line 2: expected the name of a video"),
        ("video,x,y,w,h\na\0b,1,2,3,4\n", "line 2: expected the name of a video"),
        ("\xff", "not a UTF-8 CSV file"),
    ],
)
def test_bad_crop_files(ifo, folder, tmp_path, text, words):
    (tmp_path / "crops.csv").write_bytes(text.encode("latin-1"))
    code, _, said = ifo(folder / "phone.mp4", "--crop-file", tmp_path / "crops.csv")
    assert code == 3 and said.count("\n") == 1 and words in said


def test_preview_shows_the_crop_and_writes_nothing_else(ifo, folder, tmp_path):
    code, result, _ = ifo(folder, "--preview")
    assert code == 0 and result["kind"] == "preview" and result["videos"] == len(GOOD)
    assert [path.name for path in tmp_path.iterdir()] == ["x.demos.preview.png"]
    sheet = read_png(result["path"])
    assert ((sheet == (220, 0, 0)).all(axis=-1)).sum() > len(GOOD) * 4 * 100


@pytest.mark.parametrize("crop", ["30,0,48,48", "0,0,999999,9"])
def test_preview_shows_a_crop_that_reaches_beyond_the_picture(ifo, folder, crop):
    code, result, said = ifo(folder / "b-frames.mp4", "--preview", "--crop", crop)
    assert code == 0 and "extends beyond its image of 64x48" in said
    assert (read_png(result["path"]) == (220, 0, 0)).all(axis=-1).sum() > 100


def test_footage_is_never_written_over(ifo, folder, tmp_path):
    mine = tmp_path / "x.demos.mp4"
    mine.write_bytes((folder / "phone.mp4").read_bytes())
    code, _, said = ifo(mine)
    assert code == 2 and f"would replace {mine}" in said
    assert mine.read_bytes() == (folder / "phone.mp4").read_bytes()


def test_what_follows_works_on_imported_videos(ifo, folder, tmp_path, capfd):
    videos = [folder / name for name in list(GOOD)[:4]]
    code, result, said = ifo(*videos, "--preset", "toy")
    assert code == 0, said
    translator, out = tmp_path / "x.translator.h5", tmp_path / "x.translation.h5"
    training = ["--steps", "1", "--device", "cpu", "--workers", "1", "--out", str(translator), "--overwrite"]
    assert main(["train-translator", result["path"], *training]) == 0
    assert read_artifact(translator).config["preset"] == "toy"
    capfd.readouterr()
    assert main(["translate", str(translator)]) == 2
    said = capfd.readouterr().err
    assert said.count("\n") == 1 and "--context-image" in said and "--task" in said
    write_png(tmp_path / "robot.png", np.full((48, 48, 3), 90, np.uint8))
    assert main(["translate", str(translator), "--context-image", str(tmp_path / "robot.png"), "--out", str(out)]) == 0
    assert read_artifact(out)["images"].shape[1:] == (T, 48, 48, 3)
    ifo(*videos[:3])
    capfd.readouterr()
    assert main(["train-translator", result["path"], *training]) == 3
    assert "expected at least 4: import more videos" in capfd.readouterr().err


@pytest.mark.gl
def test_a_simulated_learners_context_has_the_task_and_the_presets_distribution(ifo, folder, tmp_path):
    run = RunOptions(preset="toy", progress=Progress(quiet=True))
    words = [folder / "phone.mp4", "--preset", "toy", "--task", "reach"]
    demos = read_artifact(ifo(*words, frames=25)[1]["path"])
    contexts, frame, expert = _simulate_context(TranslateConfig(), demos, run)
    assert frame.shape == (48, 48, 3) and expert is None
    same = learner_context(make_task("reach"), 0, distribution("narrow"))
    assert all(np.array_equal(contexts[name], same[name]) for name in same)
    with pytest.raises(UsageError, match=r"has videos of 7 frames of 48x48 .* 25 of 48x48 are needed for reach"):
        _simulate_context(TranslateConfig(), read_artifact(ifo(*words)[1]["path"]), run)
