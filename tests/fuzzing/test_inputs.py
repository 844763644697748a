"""Targets: text that users write, and what stands on standard input."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from hypothesis import assume
from hypothesis import strategies as st

from artifacts import IfoError
from ifo_cli.streams import emit_path, inputs_or_stdin
from stages.config.commands import COMMANDS
from stages.config.demonstrations import Crop, parse_crop, parse_size
from stages.config.toml import STAGES_WITH_TABLES, Table, as_toml, read_table
from stages.footage.crops import check_crop, read_crops, reduced
from stages.footage.moments import Segment, choose_frames
from stages.footage.sources import Source
from tests.fuzzing.places import place
from tests.fuzzing.targets import handled, numbers, run_ifo, standard_input, target, texts, values

OPTIONS = sorted({name for command in COMMANDS.values() for name in command.names})
cells = st.one_of(
    texts, st.integers(-5, 300).map(str), st.sampled_from(("a.mp4", "b.mp4", "video", "x", "y", "w", "h"))
)
lines = st.lists(cells, max_size=7).map(",".join)
crop_files = st.one_of(
    st.lists(lines, max_size=5).map(lambda rows: "\n".join(["video,x,y,w,h", *rows])),
    st.lists(lines, max_size=5).map("\r\n".join),
    st.text(max_size=60),
)


@target("crop files", text=crop_files, raw=st.none() | st.binary(max_size=60), sources=st.integers(1, 3))
def test_crop_files(text: str, raw: bytes | None, sources: int) -> None:
    path = place("crops") / "crops.csv"
    path.write_bytes(text.encode("utf-8", "surrogatepass") if raw is None else raw)
    videos = [Source(path.parent / name) for name in ("a.mp4", "b.mp4", "c\n.mp4")[:sources]]
    found = handled(read_crops, path, videos)
    if not isinstance(found, IfoError):
        crops, _ = found
        assert len(crops) == sources
        for crop in crops:
            if handled(check_crop, crop, (48, 64), "a.mp4") is None:
                assert reduced(np.zeros((48, 64, 3), np.uint8), crop, (8, 12)).shape == (8, 12, 3)


@target("--crop and --size", words=st.lists(cells, max_size=5), joint=st.sampled_from((",", "x", "X", " ")))
def test_crop_and_size(words: list[str], joint: str) -> None:
    text = joint.join(words)
    crop, size = handled(parse_crop, text), handled(parse_size, text)
    assert isinstance(crop, Crop | IfoError) and isinstance(size, tuple | IfoError)


class Times:
    """Footage with these times."""

    label, rotation, damage = "a.mp4", 0, ""
    notes: list[str] = []  # noqa: RUF012

    def __init__(self, times: np.ndarray, last: float, cut: str) -> None:
        self.times, self.duration, self.cut = times, float(times[-1] + last) if len(times) else 0.0, cut


@target(
    "moments",
    gaps=st.lists(st.floats(1e-4, 1e6), max_size=12),
    last=st.floats(1e-4, 100),
    frames=st.integers(2, 60),
    start=st.floats(0, 1e7),
    end=st.just(0.0) | st.floats(0, 1e7),
    fps=st.just(0.0) | st.floats(1e-3, 1e4),
    cut=st.sampled_from(("", "is truncated")),
)
def test_moments(gaps: list[float], last: float, frames: int, start: float, end: float, fps: float, cut: str) -> None:
    assume(not (end and (fps or end <= start)))  # refused earlier, as options
    times = np.concatenate([[0.0], np.cumsum(gaps)])
    found = handled(choose_frames, Times(times, last, cut), Segment(frames, start, end, fps))
    if isinstance(found, IfoError):
        return
    indices, behind = found
    assert indices.shape == (frames,) and 0 <= behind <= frames
    assert (np.diff(indices) >= 0).all() and 0 <= indices[0] < indices[-1] < len(times)
    wanted = start + np.arange(frames) / fps if fps else np.linspace(start, end or max(times[-1], start), frames)
    assert (times[indices] <= np.maximum(wanted, 0) + 1e-3).all()
    later = np.minimum(indices + 1, len(times) - 1)
    assert ((times[later] > wanted) | (indices == len(times) - 1)).all()


@target(
    "standard input",
    data=st.one_of(
        st.binary(max_size=80),
        st.lists(texts, max_size=3).map(lambda rows: "\n".join(rows).encode("utf-8", "surrogatepass")),
        st.builds(
            lambda path: ('{"path": ' + repr(path)[:200].replace("'", '"') + "}").encode("utf-8", "replace"), values
        ),
    ),
    several=st.booleans(),
)
def test_standard_input(data: bytes, several: bool) -> None:
    with standard_input(data):
        found = handled(lambda: inputs_or_stdin([], "a file", several=several))
    if not isinstance(found, IfoError):
        assert found and (several or len(found) == 1)
        assert all("\0" not in str(path) and os.fsencode(path) for path in found)
    with standard_input(data):
        named = handled(lambda: inputs_or_stdin([], "a file", several=True))
    # `verify /` would check every artifact of the machine.
    assume(isinstance(named, IfoError) or not any(map(os.path.isdir, named)))
    # A file that does not exist is told by every command in one line.
    code, printed, _ = run_ifo("verify", stdin=data)
    assert code in (2, 3) or printed


@target("paths, printed and read again", name=st.binary(min_size=1, max_size=40))
def test_paths_printed_and_read_again(name: bytes) -> None:
    assume(b"\0" not in name)
    path = Path(os.fsdecode(name))
    import io
    import sys

    usual, sys.stdout = sys.stdout, io.TextIOWrapper(io.BytesIO())
    try:
        emit_path(path)
        printed = sys.stdout.buffer.getvalue()  # type: ignore[attr-defined]
    finally:
        sys.stdout = usual
    assert printed.count(b"\n") == 1
    with standard_input(printed):
        assert inputs_or_stdin([], "a file") == [path]


def toml(value: Any) -> str:
    """Return a value in TOML's syntax, or nearly so."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml(str(key))} = {toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, str):
        return '"' + "".join(c if c.isalnum() else f"\\u{ord(c) & 0xFFFF:04x}" for c in value) + '"'
    return str(value).lower()


assignments = st.tuples(st.sampled_from(OPTIONS) | texts, values).map(lambda pair: f"{pair[0]} = {toml(pair[1])}")
toml_files = st.one_of(
    st.builds(
        lambda stage, rows: "\n".join([f"[{stage}]", *rows]),
        st.sampled_from(STAGES_WITH_TABLES),
        st.lists(assignments, max_size=4),
    ),
    st.text(max_size=60),
)


@target(
    "--config files", text=toml_files, stage=st.sampled_from(STAGES_WITH_TABLES), raw=st.none() | st.binary(max_size=60)
)
def test_config_files(text: str, stage: str, raw: bytes | None) -> None:
    path = place("config") / "x.toml"
    path.write_bytes(text.encode("utf-8", "surrogatepass") if raw is None else raw)
    found = handled(read_table, path, stage)
    if isinstance(found, Table) and (found.config or found.settings):
        given = {**found.settings, **found.config}
        path.write_text(as_toml(stage, given, dict.fromkeys(given, "x"), "note"), errors="surrogatepass")
        again = read_table(path, stage)
        assert repr(again) == repr(
            Table(*({k: v for k, v in part.items() if v is not None} for part in vars(found).values()))
        )


option_words = st.tuples(st.sampled_from(OPTIONS), st.one_of(texts, numbers.map(str), st.integers(0, 9).map(str)))


@target(
    "options",
    stage=st.sampled_from(STAGES_WITH_TABLES),
    options=st.lists(option_words, min_size=1, max_size=4),
    task=st.sampled_from(("reach", "push", "")) | texts,
)
def test_options(stage: str, options: list[tuple[str, str]], task: str) -> None:
    words = [word for name, value in options for word in (f"--{name.replace('_', '-')}", value)]
    tasks = [task] if task and stage in ("train-expert", "collect-demos") else []
    with mock.patch.dict(os.environ, {"IFO_TASKS": ""}):
        code, printed, _ = run_ifo(stage, *tasks, *words, "--show-config")
    if code == 0 and not {"--help", "--version"} & set(words):
        path = place("options") / "shown.toml"
        path.write_text(printed, errors="surrogateescape")
        read_table(path, stage)
