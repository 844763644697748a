"""What stands on the page of one artifact."""

from __future__ import annotations

import base64
import re
import shutil
from pathlib import Path

import av
import numpy as np
import pytest

from artifacts import contact_sheet, read_artifact, sibling, write_artifact, write_mp4
from stages import view as module
from stages.reporting import media, videos
from stages.reporting.description import sentence, values_without_folders, without_folders
from stages.runtime.progress import Progress
from stages.view import view
from tests.stages.reporting.markup import HOSTILE, Tags

OLD = Path(__file__).parents[2] / "fixtures" / "v1"
MOVING = np.random.default_rng(0).integers(0, 255, (8, 24, 24, 3), dtype=np.uint8)
CONTENT = {
    "expert": {"weights/a": np.zeros(3), "curve/samples": np.arange(3.0), "curve/success": np.ones(3)},
    "demos": {"frames": np.stack([MOVING] * 5)},
    "translator": {"weights/a": np.zeros(3), "curve/step": np.arange(2.0), "curve/held_out/psnr": np.ones(2)},
    "translation": {
        "context_frame": MOVING[0],
        "target_features": np.zeros((8, 4)),
        "target_images": MOVING.astype(np.float32),
        "images": np.stack([MOVING] * 2),
        "demonstrations": np.array([4, 0]),
        "expert_frames": MOVING,
        "metrics/psnr": np.asarray(31.25),
        **{
            f"quality/{kind}/{name}": np.zeros((2, 8))
            for kind in ("expert", "noisy", "random")
            for name in ("feat", "img", "distance")
        },
    },
    "policy": {
        "weights/a": np.zeros(3),
        "curve/samples": np.array([100.0, 200.0]),
        "curve/normalised_distance": np.array([1.0, 0.5]),
    },
    "evaluation": {"env_return": np.zeros((1, 2)), "env_return_stochastic": np.zeros((1, 2))},
}


@pytest.fixture
def write(tmp_path):
    """A function that writes an artifact of a kind."""

    def written(kind, name="x", parents=(), config=None, command="ifo make", environment=None, **arrays):
        path = tmp_path / f"{name}.{kind}.h5"
        content = {**CONTENT[kind], **arrays}
        return write_artifact(
            path, kind, content, config=config or {}, seed=6, command=command, parents=parents, environment=environment
        )

    return written


@pytest.fixture
def page_of(tmp_path):
    """A function that views an artifact and returns the page's text."""

    def made(path):
        out = tmp_path / "out" / "page.html"
        view(path, out, Progress(quiet=True))
        return out.read_text(encoding="utf-8")

    return made


def embedded(page, kind):
    """The files of a media type that a page holds."""
    return [base64.b64decode(data) for data in re.findall(rf'src="data:{kind};base64,([^"]*)"', page)]


def frames_of(data, tmp_path):
    (tmp_path / "embedded.mp4").write_bytes(data)
    with av.open(str(tmp_path / "embedded.mp4")) as container:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])


@pytest.mark.parametrize(
    ("name", "words", "pictures", "films"),
    [
        ("small.expert", "An expert in TASK, a policy learned by trpo", 1, 0),
        ("small.demos", "6 demonstration videos of TASK, without actions: 5 frames of 16x16 pixels each.", 1, 1),
        ("small.translator", "A translator of videos into other contexts of TASK: network real, trained for 4", 1, 0),
        ("small-c0.translation", "The target that a policy tracks in TASK: the mean of 2 demonstrations", 1, 1),
        ("small-c0.policy", "A policy in TASK, learned by trpo with reward translation.", 1, 0),
        ("small-c0.evaluation", "An evaluation of 1 policy in TASK, with 4 episodes of the", 2, 0),
    ],
)
def test_files_of_older_versions_have_a_page(page_of, tmp_path, name, words, pictures, films):
    for path in OLD.glob("*.h5"):
        shutil.copy(path, tmp_path)
    page = page_of(tmp_path / f"{name}.h5")
    assert words.replace("TASK", "task tests.fixtures.small_reach:SmallReach") in page
    assert len(embedded(page, "image/png")) == pictures and len(embedded(page, "video/mp4")) == films
    assert not re.search(r'(src|href)=(?!"data:)|https?:|<script', page), "nothing comes from elsewhere"
    assert page.count('class="gone"') == 0 and str(tmp_path) not in page


def test_demonstrations_are_shown_from_the_file_itself(write, page_of, tmp_path):
    rng = np.random.default_rng(1)
    frames = rng.integers(0, 255, (30, 4, 16, 16, 3), dtype=np.uint8)
    page = page_of(write("demos", frames=frames))
    [sheet], [film] = embedded(page, "image/png"), embedded(page, "video/mp4")
    import cv2

    seen = cv2.imdecode(np.frombuffer(sheet, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    np.testing.assert_array_equal(seen, contact_sheet(frames, n=20))
    shown = frames_of(film, tmp_path)
    assert shown.shape == (4, 4 * 192 + 3 * 2, 6 * 192 + 5 * 2, 3)
    means = shown[:, 96::194, 96::194].shape[1:3]
    assert means == (4, 6)
    assert np.abs(shown[0, :192, :192].mean() - frames[0, 0].mean()) < 8


def test_a_translation_shows_source_translation_and_target(write, page_of, tmp_path, monkeypatch):
    asked = {}
    real = media.translation_grid

    def grid(sources, arrays, count, untranslated, scale):
        asked.update(sources=sources, count=count, untranslated=untranslated, scale=scale, arrays=arrays)
        return real(sources, arrays, count, untranslated, scale)

    monkeypatch.setattr(media, "translation_grid", grid)
    demos = write("demos", frames=np.stack([MOVING + k for k in range(5)]))
    translator = write("translator", parents=[demos])
    path = write("translation", parents=[translator], config={"untranslated": True})
    page = page_of(path)
    assert len(embedded(page, "video/mp4")) == 1 and len(embedded(page, "image/png")) == 1
    np.testing.assert_array_equal(asked["sources"], [MOVING + 4, MOVING])
    assert (asked["count"], asked["untranslated"], asked["scale"]) == (2, True, 8)
    assert "expert_frames" in asked["arrays"] and "31.25" in page
    # Not those of a file that took its place, nor those that do not exist, nor of a damaged one.
    for change in ("other", "number", "damaged", "missing"):
        if change == "other":
            write("demos", frames=np.stack([MOVING] * 6))
        elif change == "number":
            demos = write("demos", frames=np.stack([MOVING] * 5))
            translator = write("translator", parents=[demos])
            path = write("translation", parents=[translator], demonstrations=np.array([4, -1]))
        elif change == "damaged":
            path = write("translation", parents=[translator])
            demos.write_bytes(demos.read_bytes()[:-10])
        else:
            demos.unlink()
        page = page_of(path)
        assert asked["sources"] == ["not available"] * 2, change
        assert "<li>Source videos are not shown: " in page and str(tmp_path) not in page
        assert len(embedded(page, "video/mp4")) == 1


def test_videos_of_policies_are_the_mp4s_beside_them(write, page_of, tmp_path):
    for kind in ("policy", "evaluation"):
        path = write(kind)
        page = page_of(path)
        assert f"Missing videos: x.{kind}.mp4." in page and embedded(page, "video/mp4") == []
        film = write_mp4(sibling(path, ".mp4"), MOVING).read_bytes()
        page = page_of(path)
        assert embedded(page, "video/mp4") == [film] and f"<code>x.{kind}.mp4</code>" in page


def test_a_page_holds_a_limited_number_of_bytes(write, page_of, monkeypatch):
    path = write("policy")
    film = write_mp4(sibling(path, ".mp4"), MOVING).read_bytes()
    plot = len(embedded(page_of(path), "image/png")[0])
    monkeypatch.setattr(videos, "MOST_BYTES", len(film) + plot)
    assert len(embedded(page_of(path), "video/mp4")) == 1
    monkeypatch.setattr(videos, "MOST_BYTES", len(film) + plot - 1)
    page = page_of(path)
    assert embedded(page, "video/mp4") == [] and "Videos left out" in page
    for small, kept in ((10**6, (1, 1)), (3000, (0, 1)), (0, (0, 0))):
        monkeypatch.setattr(videos, "MOST_BYTES", small)
        page = page_of(write("demos", frames=np.zeros((5, 8, 24, 24, 3), np.uint8)))
        assert (len(embedded(page, "image/png")), len(embedded(page, "video/mp4"))) == kept
        assert page.count("<li>Left out because a page holds at most") == 2 - sum(kept)
    monkeypatch.undo()
    size = 8 * 24 * 24 * 3
    monkeypatch.setattr(media, "MOST_READ", 2 * size)
    page = page_of(write("demos"))
    assert len(embedded(page, "video/mp4")) == 1
    monkeypatch.setattr(media, "MOST_READ", size - 1)
    page = page_of(write("demos"))
    assert embedded(page, "video/mp4") == [] and "too large to be shown" in page
    monkeypatch.setattr(media, "MOST_DRAWN", 5 * 4 * size * 64 - 1)
    page = page_of(write("translation"))
    assert embedded(page, "video/mp4") == [] and "too large to be shown" in page


def test_lineage_says_what_each_file_is_and_whether_it_is_unchanged(write, page_of, tmp_path):
    demos = write("demos", command="ifo collect <b>")
    translator = write("translator", parents=[demos])
    path = write("translation", parents=[translator])
    page = page_of(path)
    for parent, command in ((translator, "ifo make"), (demos, "ifo collect &lt;b&gt;")):
        digest = read_artifact(parent).content
        assert (
            f"<code>{parent.name}</code><dl><dt>status</dt><dd>present, with the content that was recorded</dd>"
            f"<dt>digest</dt><dd><code>{digest}</code></dd><dt>command</dt><dd><code>{command}</code></dd>"
            "<dt>seed</dt><dd>6</dd>"
        ) in page
    assert f"<dt>digest</dt><dd><code>{read_artifact(path).content}</code></dd>" in page
    assert f"<dd>intact: datasets {len(CONTENT['translation'])}, each with the digest" in page
    write("translator", parents=[demos], **{"weights/a": np.ones(3)})
    page = page_of(path)
    assert "replaced by another file; recorded when it was used:" in page and "demos" not in page.split("Made from")[1]


def test_large_files_are_not_read_whole_and_long_lineages_are_cut(write, page_of, monkeypatch):
    demos = write("demos")
    path = write("translator", parents=[demos, write("demos", "y")])
    monkeypatch.setattr(module, "MOST_READ", path.stat().st_size - 1)
    monkeypatch.setattr(module, "SHOWN_ANCESTORS", 1)
    page = page_of(path)
    assert "not checked, because the file is larger than" in page and "ifo verify" in page
    assert page.count("<li><b>demos</b>") == 1 and "Only the first 1 files of the lineage" in page


@pytest.mark.parametrize("kind", CONTENT)
def test_no_text_of_a_strangers_file_reaches_the_page_as_html(write, page_of, kind):
    words = ("task", "learner", "reward", "arch", "align", "stage", "preset", "untranslated")
    config = {**dict.fromkeys(words, HOSTILE), HOSTILE: {HOSTILE: [HOSTILE]}, "summary": {HOSTILE: HOSTILE}}
    arrays = {f"metrics/{HOSTILE.replace('/', '')}": np.asarray(1.5)} if kind == "translation" else {}
    path = write(kind, "it's <i>", config=config, command=HOSTILE, environment={HOSTILE: HOSTILE}, **arrays)
    if kind in ("policy", "evaluation"):
        write_mp4(sibling(path, ".mp4"), MOVING)
    tags = Tags(page_of(path))
    allowed = (
        "html head meta title style body h1 h2 h4 p div figure img video figcaption ul li details summary dl dt dd"
    )
    assert tags.tags <= {*allowed.split(), "code"}
    assert {HOSTILE, f"it's <i>.{kind}.h5", sentence(read_artifact(path))} <= set(tags.texts)


def test_no_folder_of_this_machine_is_on_the_page(write, page_of, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "My Files").mkdir()
    secret = "/home/someone/secret"
    demos = write("demos", "My Files/d", command=f"ifo x {secret}/a.toml --out={secret}/b '{secret}/My Files/c d.h5'")
    config = {"weights": f"{secret}/My Files/w.npz", "env_kwargs": [f"file={secret}/e.xml"], "z": {f"{secret}/k": 1}}
    path = write("translator", parents=[demos], config=config, command=f"ifo train {tmp_path}/My Files/d.demos.h5")
    page = page_of(path)
    assert "secret" not in page and "someone" not in page and str(tmp_path) not in page
    for kept in ("My Files/d.demos.h5", "…/a.toml --out=…/b &#39;…/c d.h5&#39;", "…/w.npz", "file=…/e.xml", "…/k"):
        assert kept in page, kept


def test_very_many_values_are_cut(write, page_of):
    page = page_of(write("policy", config={f"key {k}": k for k in range(2000)}))
    assert "<dt>key 299</dt>" in page and "<dt>key 300</dt>" not in page and "1700 more" in page


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("runs/a.h5 ../b", "runs/a.h5 ../b"),
        ("see https://a.b/c/d", "see https://a.b/c/d"),
        ("5 / 3, 1/2", "5 / 3, 1/2"),
        ("~me/x/y (/a/b/c): no", "…/y (…/c): no"),
        ("/a", "…/a"),
    ],
)
def test_only_absolute_paths_lose_their_folders(text, shown):
    assert without_folders(text) == shown
    assert values_without_folders({"x": [1, None, "/a b/c"]}) == {"x": [1, None, "…/c"]}


def test_sentences_name_environments_and_do_not_need_any_value(write):
    environment = {
        "name": "Reacher-v5", "kwargs": {}, "seed": 0, "control_steps": 9, "frames": 8, "size": [24, 24],
        "crop": None, "viewpoint": None, "success": "",
    }  # fmt: skip
    for kind in CONTENT:
        named = sentence(read_artifact(write(kind, config={"environment": environment})))
        unnamed = sentence(read_artifact(write(kind)))
        assert "environment Reacher-v5" in named and "environment" not in unnamed and unnamed.endswith(".")
    assert sentence(read_artifact(write("demos", frames=MOVING[None, :1]))).startswith("1 demonstration video, without")
