"""Other people's files: damaged videos, images and data sets, hostile crop files and configurations."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from tests.faults.case import Case, Verdict, kind
from tests.faults.injections.forged import TEXTS, value
from tests.faults.originals import STAGES
from tests.faults.server import CHANGED, command, complaint, run

RESIDENT = 400 << 20
DIFFERENT = 6.0  # mean absolute difference of a frame, of 255, that an eye notices


def change_bytes(case: Case, path: Path) -> str:
    """Damage a file in one of the ways of disks and transfers; return a description."""
    data = bytearray(path.read_bytes())
    way = case.choose(("bits", "zeros", "random", "truncated", "inserted", "removed"))
    at = int(case.rng.integers(len(data)))
    length = int(case.rng.integers(1, 2_000))
    if way == "bits":
        for bit in case.rng.integers(0, 8 * len(data), 4):
            data[bit // 8] ^= 1 << (bit % 8)
    elif way == "zeros":
        data[at : at + length] = bytes(len(data[at : at + length]))
    elif way == "random":
        data[at : at + length] = case.rng.bytes(len(data[at : at + length]))
    elif way == "truncated":
        del data[at:]
    elif way == "inserted":
        data[at:at] = case.rng.bytes(length)
    else:
        del data[at : at + length]
    path.write_bytes(data)
    return f"{path.name}: {way} at {at}"


def import_words(*words: object) -> tuple[object, ...]:
    return ("import-demos", *words, "--frames", 5, "--size", "32x24", "--out", "i.demos.h5")


def imported_as_before(case: Case, original: Path) -> int:
    """Import the folder `videos` in a child, and compare the frames with those of the undamaged videos."""
    import sys

    from artifacts import read_artifact

    said = case.folder / "said"
    saved = os.dup(2)
    os.dup2(os.open(said, os.O_WRONLY | os.O_CREAT), 2)
    code = command(*import_words("videos"))()
    sys.stderr.flush()
    os.dup2(saved, 2)
    text = said.read_text(errors="backslashreplace")
    sys.stderr.write(text)
    if code:
        return code
    found = read_artifact(case.folder / "i.demos.h5")["frames"].astype(int)
    truth = read_artifact(original)["frames"].astype(int)
    usual = ("import-demos: ", "imported 4 videos", "train-translator needs")
    told = any(not line.startswith(usual) for line in text.splitlines())
    if told:
        return 0
    if found.shape != truth.shape:
        print(f"{len(found)} videos without a word", file=sys.stderr)
        return CHANGED
    worst = np.abs(found - truth).mean(axis=(2, 3, 4)).max()
    if worst > DIFFERENT and any(map(decoder_complains, sorted((case.folder / "videos").iterdir()))):
        print(f"a frame differs by {worst:.0f} of 255 on average, without a word", file=sys.stderr)
        return CHANGED
    return 0


def decoder_complains(path: Path) -> bool:
    """Return whether FFmpeg notices damage when it decodes a whole video.

    Changed bits that decode to another valid video cannot be noticed: the formats have no checksums.
    """
    import av

    av.logging.set_level(av.logging.INFO)
    try:
        with av.logging.Capture(local=False) as lines, av.open(str(path)) as container:
            opening = len(lines)
            stream = container.streams.video[0]
            stream.thread_type = "NONE"
            corrupt = any(frame.is_corrupt for frame in container.decode(stream))
    except (av.error.FFmpegError, IndexError):
        return True
    serious = [text for level, _, text in lines[opening:] if level <= av.logging.ERROR or "concealing" in text]
    return corrupt or any(not text.lower().startswith("sei ") for text in serious)


@kind("damaged video", 40)
def damaged_video(case: Case) -> Verdict:
    case.originals.copy(case.folder, ("videos",))
    what = change_bytes(case, case.choose(sorted((case.folder / "videos").iterdir())))
    original = case.originals.folder / "i.demos.h5"
    outcome = run(case.folder, lambda: imported_as_before(case, original))
    return Verdict("import-demos", what, complaint(outcome, (0, 3), RESIDENT) or case.judge_leftovers())


@kind("hostile crop file", 15)
def hostile_crops(case: Case) -> Verdict:
    """A CSV file with random fields, or with random bytes."""
    case.originals.copy(case.folder, ("videos",))
    names = sorted(path.name for path in (case.folder / "videos").iterdir())
    rows: list[list[str]] = [["video", "x", "y", "w", "h"]]
    rows += [[f"videos/{name}", "0", "0", "32", "24"] for name in names]
    for _ in range(int(case.rng.integers(1, 4))):
        row = case.choose(rows)
        row[int(case.rng.integers(5))] = str(
            case.choose((*TEXTS, "-1", "1.5", "1e9", "9" * 400, "NaN", "0", "99999999"))
        )
    text = "\n".join(",".join(row) for row in rows).encode("utf-8", "surrogatepass")
    if case.rng.random() < 0.2:
        text = case.rng.bytes(300) if case.rng.random() < 0.5 else text[: int(case.rng.integers(len(text)))]
    (case.folder / "crops.csv").write_bytes(text)
    outcome = run(case.folder, command(*import_words("videos", "--crop-file", "crops.csv")))
    return Verdict("import-demos", f"crops {text[:200]!r}", complaint(outcome, (0, 2, 3), RESIDENT))


@kind("hostile --config file", 25)
def hostile_toml(case: Case) -> Verdict:
    """Options of wrong types and sizes in the file that --config names."""
    name = case.choose(n for n in case.originals.outcomes if "--format" not in STAGES[n].words and n != "report")
    stage = STAGES[name]
    case.originals.copy(case.folder, stage.inputs)
    shown = run(case.folder, command(*stage.words, "--show-config"))
    lines = shown.stdout.splitlines()
    for _ in range(int(case.rng.integers(1, 3))):
        at = int(case.rng.integers(1, len(lines)))
        item = value(case)
        text = json.dumps(item) if isinstance(item, str) else str(item)
        key = lines[at].partition(" = ")[0]
        lines[at] = case.choose((f"{key} = {text}", f"{key} = ", text, f"{text} = 1", "[" * 5_000))
    data = "\n".join(lines).encode("utf-8", "surrogatepass")
    (case.folder / "c.toml").write_bytes(data)
    changed = [line for line in lines if line not in shown.stdout.splitlines()]
    words = (*stage.words, "--out", stage.out, "--config", "c.toml", "--show-config")
    outcome = run(case.folder, command(*words))
    problem = complaint(outcome, (0, 2), RESIDENT)
    return Verdict(stage.command, f"configuration {[line[:80] for line in changed]}", problem)


@kind("damaged data set", 40)
def damaged_dataset(case: Case) -> Verdict:
    """An exported data set with damaged files or hostile metadata is imported again."""
    which = case.choose(("lerobot", "r.hdf5"))
    case.originals.copy(case.folder, (which,))
    root = case.folder / which
    if which == "r.hdf5":
        what = change_bytes(case, root)
    else:
        files = sorted(path for path in root.rglob("*") if path.is_file())
        victim = case.choose(files)
        what = hostile_json(case, victim) if victim.suffix == ".json" and case.rng.random() < 0.8 else ""
        what = what or change_bytes(case, victim)
    outcome = run(case.folder, command(*import_words(which)))
    problem = complaint(outcome, (0, 2, 3), RESIDENT) or case.judge_leftovers()
    return Verdict("import-demos", f"{which}: {what}", problem)


def hostile_json(case: Case, path: Path) -> str:
    """Replace a random value of a JSON file."""
    content = json.loads(path.read_text())
    where: Any = content
    key = case.choose(where)
    while isinstance(where[key], dict) and where[key] and case.rng.random() < 0.7:
        where, key = where[key], case.choose(where[key])
    where[key] = value(case)
    path.write_bytes(json.dumps(content).encode("utf-8", "surrogatepass"))
    return f"{path.name}: {key} = {str(where[key])[:60]!r}"


@kind("odd file as input", 25)
def odd_input(case: Case) -> Verdict:
    """A pipe, device, folder, link or name that no file can have, in place of an input."""
    name = case.choose(n for n in case.originals.outcomes if STAGES[n].inputs and n != "report")
    stage = STAGES[name]
    case.originals.copy(case.folder, stage.inputs[1:])
    way = case.choose(("fifo", "folder", "zero", "full", "circle", "long", "nul", "dangling", "empty", "text", "none"))
    target = case.folder / stage.inputs[0]
    given = stage.inputs[0]
    if way == "fifo":
        os.mkfifo(target)
    elif way == "folder":
        target.mkdir()
    elif way in ("zero", "full"):
        target.symlink_to(f"/dev/{way}")
    elif way == "circle":
        target.symlink_to(target.name)
    elif way == "dangling":
        target.symlink_to("nothing.h5")
    elif way == "long":
        given = "x" * int(case.rng.integers(200, 5_000)) + ".h5"
    elif way == "nul":
        given = "a\0b.h5"
    elif way == "empty":
        target.write_bytes(b"")
    elif way == "text":
        target.write_bytes(case.rng.bytes(2_000))
    words = [given if word == stage.inputs[0] else word for word in stage.words]
    outcome = run(case.folder, command(*words, "--out", stage.out))
    problem = complaint(outcome, (2, 3, 4), RESIDENT) or case.judge_leftovers()
    if not problem and (case.folder / stage.out).exists() and stage.out != stage.inputs[0]:
        problem = f"leaves {stage.out}"
    return Verdict(name, f"input is {way}", problem)
