"""The documentation's Python runs as it stands, and its commands at toy size, on the toy pipeline's files."""

from __future__ import annotations

import os
import re
import runpy
import shutil

import gymnasium
import numpy as np
import pytest
from PIL import Image

import ifo as api
from artifacts import KINDS, read_artifact, write_mp4, write_png
from ifo import suite
from tests.docs.pages import DOCS, PAGES, ROOT, blocks, commands, lines, name

pytestmark = pytest.mark.gl
SNIPPETS = [
    pytest.param(code, id=f"{name(page)}-{at}") for page in PAGES for at, code in enumerate(blocks(page, "python"))
]
# What these pages say is run, and these lines of other pages; the options of all other lines are resolved. The first
# page is that of the toy pipeline, whose finished files are kept.
RUN = (KEPT := "docs/tutorials/reach.md", "docs/tutorials/gymnasium.md")
RUN_LINES = ("import-demos kitchen/", "import-demos so101_pick/", "translate runs/kitchen", "export-demos")
RUN_LINES_OF = ("docs/tutorials/own-videos.md", "docs/how-to/data-sets.md")
QUICK = ("gc", "inspect", "ls", "verify", "view")  # have no options to resolve, and are run
TESTED = ("doctor", "check-task")  # have none, and tests of their own
OTHER_PROGRAMS = ("make", "pip", "python", "accelerate", "torchrun")
FILE = re.compile(rf"(?:runs/)?[\w-]+\.({'|'.join(KINDS)})\.h5")
SMALL = {
    "collect-demos": {"-n": "8"},
    "train-translator": {"--steps": "2", "--held-out": "2"},
    "translate": {"-n": "2"},
    "learn-policy": {"--iterations": "1", "--episodes": "4"},
    "evaluate": {"--episodes": "2"},
}


def test_there_are_snippets():
    assert len(SNIPPETS) >= 6


@pytest.mark.parametrize("snippet", SNIPPETS)
def test_a_snippet_runs(snippet, toy, monkeypatch):
    monkeypatch.chdir(toy.folder)
    code = re.sub(r'"runs/[^"]*\.(\w+)\.h5"', lambda found: repr(str(toy.artifact(found[1]))), snippet)
    names: dict = {}
    exec(code.replace("env).learn(total_timesteps=300_000)", "env, n_steps=8, batch_size=8).learn(8)"), names)
    assert "stages" not in snippet and "artifacts" not in snippet
    if "frames" in names:
        assert names["frames"].shape == (10, 25, 48, 48, 3)
    if isinstance(names.get("env"), gymnasium.Env):
        names["env"].close()


@pytest.fixture(scope="module")
def prepared(toy, ifo, tmp_path_factory):
    """A folder with everything that the pages take for granted: the toy pipeline's files, videos and data sets."""
    folder = tmp_path_factory.mktemp("pages") / "work"
    shutil.copytree(toy.folder, folder)
    demos = read_artifact(toy.artifact("demos"))["frames"]
    for at in range(5):
        write_mp4(
            folder / f"kitchen/take{at}.mp4", np.pad(demos[at], ((0, 0), (0, 0), (8, 8), (0, 0))), fps=25, min_height=1
        )
    write_png(folder / "robot.png", demos[9, 0])
    done = ifo(
        folder, "export-demos", toy.artifact("demos"), "--format", "lerobot", "--camera", "front", "--out", "so101_pick"
    )
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture
def prepared_folder(prepared, tmp_path):
    """A folder for one page, like that of a user who begins with it."""
    return shutil.copytree(prepared, tmp_path / "work", copy_function=os.link)


def smaller(words, folder, toy, kept):
    """A command of the documentation, with the toy pipeline's files in place of those that no command made.

    Args:
        words: The command.
        folder: Where it runs.
        toy: The toy pipeline.
        kept: Whether the command is one of the toy pipeline's.
    """
    stage, words = words[0], list(words)
    small = {} if kept or stage not in SMALL else dict(SMALL[stage])
    for at, word in enumerate(words):
        if words[at - 1] in small:
            words[at] = small.pop(words[at - 1])
        elif words[at - 1] == "--crop":
            words[at] = "7,0,36,36"
        elif (found := FILE.fullmatch(word)) and words[at - 1] != "--out" and not (folder / word).exists():
            words[at] = f"runs/{toy.artifact(found[1]).name}"
    words += [word for pair in small.items() for word in pair]
    if stage == "collect-demos" and kept:
        words += ["--seed", "5"]
    if (stage == "collect-demos" and "--preset" not in words) or (stage == "import-demos" and "--preview" not in words):
        words += ["--preset", "toy"]
    return [*words, "--workers", "1"] if stage in SMALL else words


def run_line(line, folder, toy, ifo, monkeypatch, kept=False):
    """Run a command line of the documentation in `folder`, command by command."""
    printed = ""
    for at, (program, *words) in enumerate(commands(line)):
        if program == "export":
            for variable, _, value in (word.partition("=") for word in words):
                monkeypatch.setenv(variable, value)
                if variable == "PYTHONPATH":
                    monkeypatch.syspath_prepend(ROOT / value)
            continue
        if program in OTHER_PROGRAMS or words[0].startswith("--"):
            return
        words = smaller(words, folder, toy, kept and "--learner" not in words)
        if at:
            words.insert(1, printed.strip())
        done = ifo(folder, *words)
        assert done.returncode == 0, f"{words}: {done.stderr}"
        printed = done.stdout


def settle_line(line, folder, toy, ifo):
    """Resolve the options of a command line of the documentation, which refuses what has no effect."""
    for program, *words in commands(line):
        if program != "ifo" or words[0].startswith("--") or words[0] in TESTED:
            continue
        words = smaller(words, folder, toy, kept=False)
        done = ifo(folder, *words, *(() if words[0] in QUICK or "--show-config" in words else ("--show-config",)))
        assert done.returncode == 0, f"{words}: {done.stderr}"


@pytest.mark.parametrize("page", [page for page in PAGES if list(lines(page))], ids=name)
def test_the_commands_of_a_page_do_what_they_say(page, prepared_folder, toy, ifo, monkeypatch):
    for line in lines(page):
        is_run = name(page) in RUN_LINES_OF and any(f"ifo {start}" in line for start in RUN_LINES)
        if (name(page) in RUN or is_run or line.startswith("export")) and "push-real" not in line:
            run_line(line, prepared_folder, toy, ifo, monkeypatch, kept=name(page) == KEPT)
        else:
            settle_line(line, prepared_folder, toy, ifo)


def test_the_picture_shows_what_the_artifacts_hold(toy, tmp_path, capsys):
    script = runpy.run_path(str(DOCS / "make_images.py"))
    policy = read_artifact(toy.artifact("policy"))
    demonstration, context, translation, learned = shown = script["panels"](policy, 3)
    assert demonstration.shape == context.shape == translation.shape == (25, 48, 48, 3)
    assert learned.shape == (25, 240, 240, 3)
    assert (context == read_artifact(toy.artifact("translation"))["context_frame"]).all()
    assert (translated(toy, demonstration) == translation).mean() > 0.99, "of this demonstration"
    path = script["main"]([str(policy.path), "--demonstration", "3", "--out", str(tmp_path / "a.webp")])
    (tmp_path / "a.gif").write_bytes(script["encoded"](script["composed"](shown, Image.Resampling.NEAREST), ".gif"))
    for written in (path, tmp_path / "a.gif"):
        with Image.open(written) as picture:
            assert picture.n_frames > 20 and picture.info["loop"] == 0
            assert picture.size == (4 * 160 + 3 * 8, 160 + 24)
        assert written.stat().st_size < 1_000_000
    with pytest.raises(SystemExit, match="--demonstration 99"):
        script["main"]([str(policy.path), "--demonstration", "99", "--out", str(tmp_path / "b.webp")])


def translated(toy, frames):
    """Frames (T, H, W, 3) translated into the context of the toy pipeline's translation."""
    import torch

    from stages.translation.networks import load_translator, to_frames, to_images

    model = load_translator(read_artifact(toy.artifact("translator")), "cpu")
    context = read_artifact(toy.artifact("translation"))["context_frame"]
    with torch.no_grad():
        seen = model.encode_context(to_images(torch.from_numpy(context[None].copy())))
        features = model.translate(model.encode(to_images(torch.from_numpy(frames))), seen)
        return to_frames(model.decode(features, seen)).numpy()


def test_a_loaded_policy_does_what_evaluate_measured(toy):
    """In a dm_control environment it ends where a rollout in the batch ends."""
    from stages.simulation.batch import rollout

    policy, source = api.load_policy(toy.artifact("policy")), api.read_artifact(toy.artifact("policy"))
    contexts = source.group("contexts")
    env = suite.load("reach", contexts=lambda rng, n: contexts, seed=3)
    task, time_step = env.task.task, env.reset()
    start = env.physics.task_state()
    while not time_step.last():
        time_step = env.step(policy.act(task.observe(env.physics.task_state()))[0])
    episode = rollout(task, contexts, start.qpos, start.qvel, lambda state, _: policy.act(task.observe(state)))
    assert env.task.distance(env.physics) == pytest.approx(episode.final_distance[0], rel=1e-4)
    assert np.isfinite(episode.final_distance).all()
    env.close()
