"""What stands on the page, and what lies beside it."""

from __future__ import annotations

import csv
import html
import re

import numpy as np
import pytest

from artifacts import ArtifactError, UsageError, read_artifact, read_png, sibling, write_artifact, write_mp4
from stages.report import report
from stages.reporting import videos
from stages.reporting.rows import read_runs
from stages.runtime.progress import Progress
from stages.runtime.terminal import one_line
from tests.stages.reporting.markup import HOSTILE, Tags

MOVING = np.random.default_rng(0).integers(0, 255, (8, 24, 24, 3), dtype=np.uint8)


@pytest.fixture
def make_report(tmp_path):
    """A function that reports and returns the page's text."""

    def make(*inputs, title="Title", out=tmp_path / "out" / "page.html"):
        report(inputs, out, title, "ifo report x", Progress(quiet=True))
        return out.read_text(encoding="utf-8")

    return make


@pytest.fixture
def family(tmp_path, evaluation):
    """An evaluation with all that it was made from: paths by kind."""
    content = {
        "demos": {"frames": np.zeros((2, 3, 8, 8, 3), np.uint8), "final_distance": np.zeros(2)},
        "translator": {"weights/a": np.zeros(3)},
        "translation": {
            "context_frame": np.zeros((8, 8, 3), np.uint8),
            "target_features": np.zeros((3, 4)),
            "target_images": np.zeros((3, 8, 8, 3), np.uint8),
        },
        "policy": {"weights/a": np.zeros(3)},
    }
    made = {}
    for number, (kind, arrays) in enumerate(content.items()):
        path, parents = tmp_path / f"x.{kind}.h5", list(made.values())[-1:]
        command = f"ifo make {kind} <here>"
        made[kind] = write_artifact(path, kind, arrays, config={}, seed=40 + number, command=command, parents=parents)
    write_mp4(sibling(made["translation"], ".mp4"), MOVING)
    made["evaluation"] = evaluation("x", (0.25,), parents=[made["policy"]])
    write_mp4(sibling(made["evaluation"], ".mp4"), MOVING)
    return made


def test_page_and_what_lies_beside_it(evaluation, make_report, tmp_path):
    methods = ("translation", "translation without img")
    page = make_report(evaluation(left=(0.1, 0.9), methods=methods))
    out = tmp_path / "out"
    plots = {f"page-{name}.png" for name in ("success", "curves", "ablations")}
    assert {path.name for path in out.iterdir()} == {"page.html", "page.csv", "page.md"} | plots
    markdown = (out / "page.md").read_text()
    for name in plots:
        assert read_png(out / name).std() > 0
        assert f"(<{name}>)" in markdown
    assert len(list(csv.DictReader((out / "page.csv").open()))) == 2
    row = "1.00 [0.21, 1.00]", "0.85"
    assert "".join(f'<td class="figure">{cell}</td>' for cell in row) in page
    assert f"| reach | translation | 1 | {' | '.join(row)} |" in markdown
    assert not re.search(r'(src|href)=(?!"data:)|https?:', page)  # nothing comes from elsewhere


def test_texts_are_escaped(evaluation, make_report, tmp_path):
    nasty = "<script>alert(1)</script> & | $x$"
    task = nasty.replace("\ud800", "")[:999]  # A file whose task is longer, or no text, is refused.
    page = make_report(evaluation(left=(0.1,), task=task, methods=(nasty,), policy=nasty), title=nasty)
    assert "<script" not in page and html.escape(nasty) in page
    markdown = (tmp_path / "out" / "page.md").read_text()
    assert "<script" not in markdown and "# &lt;script&gt;alert(1)&lt;/script&gt; &amp; \\| $x$" in markdown


def test_nothing_unprintable_reaches_a_file(evaluation, make_report, tmp_path):
    nasty = "a\x1b[2J\u202e\0\r\ud800" + "x" * 20_000
    task = nasty.replace("\ud800", "")[:999]  # A file whose task is longer, or no text, is refused.
    page = make_report(evaluation(left=(0.1,), task=task, methods=(nasty,), policy=nasty, learner=nasty))
    for text in (page, *((tmp_path / "out" / f"page.{kind}").read_text() for kind in ("md", "csv"))):
        assert "\\u001b" in text and all(line.isprintable() for line in text.split("\n"))
    for plot in (tmp_path / "out").glob("*.png"):
        assert read_png(plot).shape[0] < 1000


def leaves(value, path=()):
    """Paths of all strings, numbers, truth values and None in nested dictionaries and lists."""
    if isinstance(value, dict):
        return [leaf for key, item in value.items() for leaf in leaves(item, (*path, key))]
    if isinstance(value, list):
        return [leaf for key, item in enumerate(value) for leaf in leaves(item, (*path, key))]
    return [path]


def replaced(value, path):
    """A copy in which the leaf at `path` is hostile."""
    if not path:
        return HOSTILE
    copied = value.copy()
    copied[path[0]] = replaced(value[path[0]], path[1:])
    return copied


def test_no_field_of_an_evaluation_reaches_the_page_as_html(evaluation, make_report, tmp_path):
    options = {"without": ["img"], "vary": "", "blur": 4.0, "starts": None, "learner": "trpo"}
    artifact = read_artifact(evaluation("it's <b>", (0.1,), curves=False, **options), "evaluation")
    whole = {**artifact.config, "episodes": 4, "preset": "toy"}
    names = artifact.names()

    def write(config):
        arrays = {name: read_artifact(artifact.path)[name] for name in names}
        environment = {HOSTILE: HOSTILE}
        write_artifact(
            artifact.path, "evaluation", arrays, config=config, seed=0, command=HOSTILE, environment=environment
        )
        return artifact.path

    config, refused = whole, set()
    found = leaves(whole)
    assert ("runs", 0, "context_seed") in found and ("runs", 0, "translator", "minutes") in found and len(found) > 20
    for path in found:
        hostile = replaced(config, path)
        try:
            read_runs(read_artifact(write(hostile)))
        except ArtifactError as error:
            assert "\n" not in str(error) and ".".join(map(str, path)) in str(error)
            refused.add(path[-1])
        else:
            config = hostile
    # What tables and plots compute with must be numbers; all the rest may be any text.
    numbers = {"seed", "context_seed", "samples", "learning_minutes", "minutes", "steps", "psnr", "tau_expert"}
    assert refused == numbers | {"success_threshold", "own_context"}
    config["runs"][0][HOSTILE] = config["runs"][0]["translation_metrics"][HOSTILE] = 0.5
    page = make_report(write(config), title=HOSTILE)
    tags = Tags(page)
    allowed = "html head meta title style body h1 h2 h4 p div table thead tbody tr th td figure img figcaption ul li"
    assert tags.tags == {*allowed.split(), "details", "summary", "b", "dl", "dt", "dd", "code"}
    for text in (f"{HOSTILE}: {HOSTILE}", f"learner {HOSTILE}", f"{HOSTILE} 0.5"):
        assert any(text in found for found in tags.texts), text
    assert "<script" not in (tmp_path / "out" / "page.md").read_text()


@pytest.mark.parametrize("start", ["=", "+", "-", "@", "\t=", "\r=", "\n=", " =", "\uff1d"])
def test_no_cell_of_the_csv_is_a_formula(evaluation, make_report, tmp_path, start):
    nasty = f"{start}cmd|' /C calc'!A0"
    make_report(evaluation(left=(0.1,), task=nasty, methods=(nasty,)))
    [row] = csv.DictReader((tmp_path / "out" / "page.csv").open(newline=""))
    assert row["task"] == row["method"] == one_line(f"'{nasty}")


def test_negative_numbers_of_the_csv_stay_numbers(evaluation, make_report, tmp_path):
    make_report(evaluation(left=(0.1,), translation_metrics={"tau_random": -0.5}))
    [row] = csv.DictReader((tmp_path / "out" / "page.csv").open(newline=""))
    assert row["tau_random"] == "-0.5" and row["task"] == "reach"


def test_lineage_goes_down_to_command_and_seed(family, make_report):
    page = make_report(family["evaluation"])
    for number, kind in enumerate(("policy", "translation", "translator", "demos")):
        assert f"<b>{kind}</b> <code>{family[kind]}</code>" in page
        assert f"<dd><code>ifo make {kind} &lt;here&gt;</code></dd><dt>seed</dt><dd>{43 - number}</dd>" in page
    assert 'class="gone"' not in page


def test_lineage_says_what_a_run_came_to(evaluation, make_report):
    path = evaluation(left=(0.25, 0.75), deterministic=(0.5, 0.125), translator={}, methods=("video",))
    page = make_report(path)
    assert re.search(r"<b>reach\.evaluation\.h5</b>: reach: video.*: 2 runs</summary>", page)
    for number, facts in enumerate(
        (
            ("0.250", "succeeds", "yes (below 0.5)", "0.2500", "0.5000", "0.000", "2.0000, 0.5000"),
            ("0.750", "fails", "no (below 0.5)", "0.7500", "0.1250", "1.000", "2.0000, 1.5000"),
        )
    ):
        left, verdict, success, stochastic, deterministic, episodes, distances = facts
        start = page.index(f"context {number}, seed 0: {left} of the initial distance, {verdict}</summary>")
        section = page[start : page.index("</details>", start)]
        for name, value in (
            ("success, paper&#39;s criterion", success),
            ("normalized final distance, stochastic policy", stochastic),
            ("normalized final distance, deterministic policy", deterministic),
            ("success rate of deterministic episodes", episodes),
            ("initial and final distance", distances),
            ("samples", "300"),
            ("learning minutes", "1.50"),
        ):
            assert f"<dt>{name}</dt><dd>{value}</dd>" in section, name
        assert "translator unknown, " in section and "translator {}" not in section


def test_lineage_says_where_a_run_counts_that_is_there_twice(evaluation, make_report, tmp_path):
    first = evaluation("first", (0.1, 0.2))
    second = evaluation("second", (0.3,))
    page = make_report(first, second)
    [(name, kept)] = re.findall(r"<p>(\S+) counts once, as a run of (\S+)\.</p>", page)
    [left_out] = {first, second} - {type(first)(kept)}
    assert name == f"{left_out.name.partition('.')[0]}-c0.policy.h5"
    [section] = [text for text in page.split('<details id="evaluation-') if "counts once, as" in text]
    assert f"<b>{left_out.name}</b>" in section


def test_a_translation_is_shown_once_and_of_each_task_only_some(family, evaluation, make_report, monkeypatch, tmp_path):
    monkeypatch.setattr(videos, "MOST_TRANSLATIONS", 2)
    second = tmp_path / "second.policy.h5"
    parents = [family["translation"]]
    write_artifact(second, "policy", {"weights/a": np.ones(3)}, config={}, seed=1, command="ifo", parents=parents)
    twice = evaluation("twice", (0.25,), parents=[second], first_seed=1)
    titles = re.compile(r"Translation that (\S+) learned from")
    assert titles.findall(make_report(family["evaluation"], twice)) == ["x-c0.policy.h5"]
    more = []
    for number in range(3):
        name = f"y{number}"
        source = read_artifact(family["translation"])
        arrays = {name: source[name] for name in source.names()}
        translation = tmp_path / f"{name}.translation.h5"
        write_artifact(translation, "translation", arrays, config={}, seed=number, command="ifo")
        write_mp4(sibling(translation, ".mp4"), MOVING)
        policy = tmp_path / f"{name}.policy.h5"
        write_artifact(
            policy, "policy", {"weights/a": np.zeros(3)}, config={}, seed=1, command=name, parents=[translation]
        )
        more.append(evaluation(name, (0.25,), parents=[policy], first_seed=number))
    assert titles.findall(make_report(*more)) == ["y0-c0.policy.h5", "y1-c0.policy.h5"]


def test_lineage_says_what_is_gone(family, make_report):
    family["translation"].unlink()
    page = make_report(family["evaluation"])
    assert f"<code>{family['translation']}</code> <span" in page and "missing; recorded when it was used:" in page
    assert "ifo make policy" in page and "ifo make translator" not in page


def test_lineage_does_not_tell_of_a_file_that_took_anothers_place(family, make_report):
    write_artifact(family["policy"], "policy", {"weights/a": np.ones(3)}, config={}, seed=9, command="ifo else")
    page = make_report(family["evaluation"])
    assert "replaced by another file; recorded when it was used:" in page and "ifo else" not in page
    assert page.count("<video") == 1  # the translation's would be another policy's


def test_videos_of_evaluations_and_translations_are_on_the_page(family, make_report):
    page = make_report(family["evaluation"])
    assert page.count('<video controls loop muted autoplay playsinline src="data:video/mp4;base64,') == 2


def test_missing_videos_and_curves_are_said_to_be_missing(evaluation, make_report):
    page = make_report(evaluation("older", (0.1,), old=True))
    assert "<video" not in page and "Learning curves</h2>" not in page
    assert re.search(r"Missing videos: \S*older.evaluation.mp4", page)
    assert re.search(r"without learning curves: \S*older.evaluation.h5", page)
    assert re.search(r"Translator unknown, because files were missing .*older.evaluation.h5", page)


def test_what_is_unknown_is_shown_as_unknown(evaluation, make_report, tmp_path):
    evaluation("known", (0.1,), first_seed=1)
    unknown = {"translator": None, "own_context": None}
    evaluation("lost", (0.1,), **unknown)
    evaluation("demos", (0.1,), own_context=None)
    page = make_report(tmp_path)
    markdown, rows = (tmp_path / "out" / "page.md").read_text(), (tmp_path / "out" / "page.csv").read_text()
    for name in ("translation (translator unknown)", "translation (demonstrations unknown)"):
        assert f"<td>{name}</td>" in page and f"| reach | {name} | 1 |" in markdown and f"reach,{name},0," in rows
    # Nothing is compared with the paper's rate but what is known to be the paper's method.
    assert markdown.count("| 0.85 |") == 1
    minutes = {row["method"]: row["translator_minutes"] for row in csv.DictReader(rows.splitlines())}
    assert minutes["translation"] == "20.0" and minutes["translation (translator unknown)"] == ""
    assert "translator unknown, own_context unknown" in page and "False" not in page and "{}" not in page
    [line] = re.findall(r"Demonstrations unknown, because files .*", page)
    assert "demos.evaluation.h5" in line and "lost.evaluation.h5" not in line
    [line] = re.findall(r"Translator unknown, because files .*", page)
    assert "lost.evaluation.h5" in line and "demos.evaluation.h5" not in line


def test_a_full_page_leaves_videos_out(family, make_report, monkeypatch):
    monkeypatch.setattr(videos, "MOST_BYTES", sibling(family["evaluation"], ".mp4").stat().st_size)
    page = make_report(family["evaluation"])
    assert page.count("<video") == 1
    assert re.search(r"Videos left out because .*x.translation.mp4", page)


def test_an_earlier_report_is_replaced_and_nobody_elses_file(evaluation, make_report, tmp_path):
    path = evaluation()
    make_report(path)
    assert "<h1>Second</h1>" in make_report(path, title="Second")
    (tmp_path / "README.md").write_text("mine")
    with pytest.raises(UsageError, match=r"README\.md"):
        make_report(path, out=tmp_path / "README.html")
    assert (tmp_path / "README.md").read_text() == "mine" and not (tmp_path / "README.html").exists()


def test_videos_play_and_plots_show_in_a_browser(family, make_report, browser, tmp_path):
    make_report(family["evaluation"])
    browser.open(tmp_path / "out" / "page.html")
    # A browser starts a silent video by itself once it is in sight.
    seen = browser.evaluate(
        """(async () => {
            await new Promise(done => document.readyState == 'complete' ? done() : addEventListener('load', done));
            const videos = [];
            for (const video of document.querySelectorAll('video')) {
                video.scrollIntoView({block: 'center'});
                for (let k = 0; k < 100 && !video.currentTime; k++) await new Promise(done => setTimeout(done, 50));
                videos.push({played: video.currentTime > 0, size: [video.videoWidth, video.videoHeight]});
            }
            const plots = [...document.images].map(image => image.complete && image.naturalWidth > 300);
            const wide = document.documentElement.scrollWidth > innerWidth;
            return {videos, plots, wide, title: document.querySelector('h1').innerText};
        })()"""
    )
    assert seen["videos"] == [{"played": True, "size": [192, 192]}] * 2
    assert seen["plots"] == [True, True]
    assert seen["title"] == "Title" and not seen["wide"]
