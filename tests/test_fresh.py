"""What `make fresh` hands on to the bare Debian, and that nothing of it stays, however it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

# Stands in for debootstrap. `hang` mounts something, as the real one does, and starts a process that would stay.
DEBOOTSTRAP = """#!/usr/bin/env bash
root=${@: -1}; [[ "$root" == */root ]] || root=${@: -2:1}
mkdir -p "$root/etc"
echo "W: of debootstrap"
if [ -n "${TMPDIR:-}" ]; then exit 1; fi  # The scripts of the packages would look for it in the bare Debian.
if [ "$FRESH" = fail ]; then exit 1; fi
mount -t tmpfs left-behind "$root/etc" && touch "$root/etc/mounted"
echo $$ > "$STARTED"
sleep 60
"""


def may_mount() -> bool:
    return os.geteuid() == 0 and subprocess.run(["unshare", "--mount", "--pid", "--fork", "true"]).returncode == 0


@pytest.fixture
def fresh(tmp_path, monkeypatch):
    """Starts .ci/fresh.sh with another debootstrap; its temporary folders go to tmp_path / "tmp"."""
    (tmp_path / "tmp").mkdir()
    (tmp_path / "bin").mkdir()
    debootstrap = tmp_path / "bin" / "debootstrap"
    debootstrap.write_text(DEBOOTSTRAP)
    debootstrap.chmod(0o755)
    monkeypatch.setenv("PATH", f"{debootstrap.parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    monkeypatch.setenv("STARTED", str(tmp_path / "started"))

    def start(what):
        return subprocess.Popen(
            ["bash", str(ROOT / ".ci" / "fresh.sh")],
            env=os.environ | {"FRESH": what},
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            # Under nohup, tests inherit an ignored SIGHUP.
            preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),
        )

    return start


def command_lines():
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):  # The process has ended since.
            yield path.read_bytes().decode(errors="replace")


def assert_nothing_is_left(tmp_path):
    assert list((tmp_path / "tmp").iterdir()) == []
    assert "left-behind" not in Path("/proc/self/mountinfo").read_text()
    deadline = time.monotonic() + 10
    while running := [line for line in command_lines() if str(tmp_path) in line]:
        assert time.monotonic() < deadline, running
        time.sleep(0.02)


@pytest.mark.skipif(not may_mount(), reason="only root may mount")
@pytest.mark.parametrize(("sent", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_an_interrupted_run_leaves_nothing(fresh, tmp_path, sent, status):
    process = fresh("hang")
    deadline = time.monotonic() + 30
    while not (tmp_path / "started").exists():
        assert process.poll() is None and time.monotonic() < deadline, process.stderr.read()
        time.sleep(0.02)
    assert "left-behind" not in Path("/proc/self/mountinfo").read_text()  # It is seen in its own namespace only.
    process.send_signal(sent)
    process.communicate(timeout=30)
    assert process.returncode == status
    assert_nothing_is_left(tmp_path)


@pytest.mark.skipif(not may_mount(), reason="only root may mount")
def test_a_failed_run_says_why_and_leaves_nothing(fresh, tmp_path):
    process = fresh("fail")
    _, err = process.communicate(timeout=60)
    assert process.returncode == 4
    assert err.splitlines()[-3:-1] == ["W: of debootstrap", "fresh: debootstrap failed (see its messages above)"]
    assert_nothing_is_left(tmp_path)


def test_it_says_that_it_needs_root(fresh, tmp_path):
    (tmp_path / "bin" / "id").write_text("#!/bin/sh\necho 1000\n")
    (tmp_path / "bin" / "id").chmod(0o755)
    process = fresh("fail")
    _, err = process.communicate(timeout=60)
    assert process.returncode == 4
    assert err == "fresh: this needs root, to install Debian in a folder: sudo make fresh\n"


def test_pip_settings_are_handed_on_with_the_paths_they_name(tmp_path):
    wheels, index = tmp_path / "wheels", tmp_path / "mirror" / "simple"
    constraint = tmp_path / "constraints.txt"
    (tmp_path / "etc").mkdir()
    wheels.mkdir()
    index.mkdir(parents=True)
    constraint.touch()
    listed = [
        f":env:.find-links='{wheels}'",
        ":env:.cache-dir='/var/cache/pip'",
        "global.find-links='/elsewhere'",
        f"global.extra-index-url='\\nhttps://packages.example/simple\\nfile://{index}'",
        f"install.constraint='{constraint}'",
        "global.index-url='https://index.example/100%25/simple'",
    ]
    done = subprocess.run(
        [sys.executable, str(ROOT / ".ci" / "pip_settings.py"), str(tmp_path)],
        input="\n".join(listed),
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines() == sorted(map(str, (wheels, index.parent, constraint)))
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PIP_")}
    environment |= {"PIP_CONFIG_FILE": str(tmp_path / "etc" / "pip.conf")}
    read = subprocess.run(
        [sys.executable, "-m", "pip", "config", "list"], capture_output=True, text=True, env=environment
    ).stdout
    assert f"global.find-links='{wheels}'" in read
    assert f"install.constraint='{constraint}'" in read
    assert f"https://packages.example/simple\\nfile://{index}" in read
    assert "global.index-url='https://index.example/100%25/simple'" in read
    assert "cache-dir" not in (tmp_path / "etc" / "pip.conf").read_text()
