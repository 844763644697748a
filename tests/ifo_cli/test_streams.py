"""Standard streams that are closed, full, endless or not UTF-8, and what may be printed on them."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from artifacts import ArtifactError, PlatformError
from ifo_cli.streams import _Errors, _Output, emit, emit_path, inputs_or_stdin

ROOT = Path(__file__).parents[2]
FULL = "/dev/full"


def shell(line: str, **more) -> subprocess.CompletedProcess:
    """Run a line of shell in which `ifo` is this one."""
    command = f'ifo() {{ "{sys.executable}" -m ifo_cli "$@"; }}; {line}'
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=60, env=env, **more)


@pytest.mark.parametrize("words", ["--help", "--version", "import-demos --show-config"])
def test_standard_output_on_a_full_disk_is_one_line(words):
    done = shell(f"ifo {words} > {FULL}")
    assert (done.returncode, done.stderr.count("\n")) == (4, 1)
    assert done.stderr.startswith("ifo: standard output cannot be written (No space left on device)")


def test_closed_streams_change_no_outcome_and_nothing_is_printed_into_a_file(make, tmp_path):
    path = make("demos")
    content = path.read_bytes()
    assert shell(f"ifo verify {path} 2>&-").returncode == 0
    assert shell(f"ifo verify {path} {tmp_path / 'none.demos.h5'} <&- >&- 2>&-").returncode == 3
    assert path.read_bytes() == content


def test_a_full_standard_error_changes_no_outcome(make):
    done = shell(f"ifo verify {make('demos')} none.demos.h5 2> {FULL}")
    assert done.returncode == 3 and done.stdout.startswith("ok ")


def test_a_reader_that_leaves_is_no_error():
    done = shell("set -o pipefail; ifo --help | true")
    assert (done.returncode, done.stderr) == (0, "")


def test_a_terminal_that_is_not_utf8(tmp_path):
    done = shell(f"PYTHONIOENCODING=ascii ifo verify {tmp_path}/scène.h5; PYTHONIOENCODING=ascii ifo --help")
    assert "sc\\xe8ne.h5: no such file" in done.stderr and "Traceback" not in done.stderr


def test_a_working_folder_that_is_gone_is_one_line(tmp_path):
    # Editable installs have a relative entry in sys.path.
    relative = "import sys; sys.path.append('relative'); from ifo_cli.main import main; sys.exit(main())"
    line = f'mkdir gone && cd gone && rmdir ../gone && "{sys.executable}" -c "{relative}" inspect x'
    done = shell(line, cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (4, 1) and "the working folder is gone" in done.stderr


def test_an_error_of_standard_output_is_raised_once(tmp_path):
    with _Output(FULL, "w") as stream:
        with pytest.raises(PlatformError, match="No space left on device"):
            stream.write(b"lost")
        assert stream.write(b"more") == 4


def test_standard_error_loses_what_it_cannot_write():
    with _Errors(FULL, "w") as stream:
        assert stream.write(b"lost") == 4


def test_a_stream_that_does_not_block_is_waited_for():
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with _Output(writing, "w") as stream:
        size = 1 << 20
        reader = subprocess.Popen(["wc", "-c"], stdin=reading, stdout=subprocess.PIPE)
        os.close(reading)
        left = memoryview(bytes(size))
        while left:
            left = left[stream.write(left) :]
    assert int(reader.communicate()[0]) == size


def test_what_is_printed_cannot_control_a_terminal(capsys):
    emit("a\x1b[2Jb\r\u202ec\x9b\nd\ud800\u2028\U000e0001é")
    assert capsys.readouterr().out == "a\\u001b[2Jb\\u000d\\u202ec\\u009b\nd\\ud800\\u2028\\U000e0001é\n"


@pytest.mark.parametrize("name", ["x", "é", " x ", "a\nb", "a\u2028b\x0c.h5", "\udcff", '{"path": "y"}', "{"])
def test_a_path_survives_the_pipe(name, capfdbinary, monkeypatch):
    emit_path(Path(name))
    line = capfdbinary.readouterr().out
    assert line.count(b"\n") == 1 and line.endswith(b"\n")
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(line)))
    assert inputs_or_stdin([], "x") == [Path(name)]


@pytest.mark.parametrize(
    "data",
    [
        b"a\0b",
        b"\x89PNG\r\n\x1a\n\0",
        b"x" * 5000,
        b"x\n" * (1 << 19),
        b'{"path": "\\u0000"}',
        b'{"path": "\\ud800"}',
        b'{"path": ""}',
        b'{"path": "' + b"x" * 5000 + b'"}',
        b'{"path": ' + b"[" * 100_000,
    ],
)
@pytest.mark.parametrize("several", [False, True])
def test_what_is_no_path_is_refused(data, several, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))
    with pytest.raises(ArtifactError, match="standard input is not an artifact path"):
        inputs_or_stdin([], "the artifact", several=several)


def test_a_standard_input_that_cannot_be_read_is_named(tmp_path):
    done = shell("ifo inspect 0> written-only", cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (3, 1) and "standard input cannot be read" in done.stderr


def test_one_error_is_one_line(run_ifo, tmp_path):
    name = "a\nifo: all is well\x1b[1A\u202e.demos.h5"
    for command in ("inspect", "verify", "train-translator", "report"):
        code, out, err = run_ifo(command, tmp_path / name)
        assert (code, out, err.count("\n")) == (3, "", 1)
        assert "\x1b" not in err and "\u202e" not in err and "a\\u000aifo: all is well\\u001b[1A" in err


def test_inspect_shows_no_terminal_sequences(run_ifo, make):
    path = make("demos", config={"note": "a\x1b]0;title\x07\r\nb", "\x1b[5m": "\u202e"})
    code, out, _ = run_ifo("inspect", path)
    assert code == 0 and "\\u001b]0;title\\u0007\\u000d\\u000ab" in out and "\\u202e" in out
    assert all(line.isprintable() for line in out.split("\n"))
    code, out, _ = run_ifo("inspect", path, "--json")
    assert json.loads(out)["config"]["note"] == "a\x1b]0;title\x07\r\nb" and out.rstrip("\n").isprintable()


@pytest.mark.parametrize("more", [[], ["--json"]])
def test_a_result_whose_path_cannot_be_printed_is_named(run_ifo, calls, make, monkeypatch, more):
    def full(_):
        raise PlatformError("standard output cannot be written")

    monkeypatch.setattr("ifo_cli.runner.emit", full)
    monkeypatch.setattr("ifo_cli.runner.emit_path", full)
    code, out, err = run_ifo("translate", make("translator"), *more)
    assert (code, out) == (4, "") and err.rstrip().endswith("result.h5 is complete")


@pytest.mark.parametrize("kind", ["pipe", "loop"])
def test_an_output_that_is_no_file_is_refused_before_any_work(run_ifo, calls, make, tmp_path, kind):
    os.mkfifo(tmp_path / "pipe.h5")
    (tmp_path / "loop.h5").symlink_to("loop.h5")
    code, out, err = run_ifo("translate", make("translator"), "--out", tmp_path / f"{kind}.h5")
    assert (code, out, calls) == (2, "", []) and "a link to itself" in err and err.count("\n") == 1
