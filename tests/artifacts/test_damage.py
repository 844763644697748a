"""Artifacts under damage: killed writers, truncation, flipped bytes, full disks."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from artifacts import ArtifactError, PlatformError, hdf5, read_artifact, verify_artifact, write_artifact
from artifacts.atomic import atomic_path
from tests.artifacts.samples import PROVENANCE, demos_arrays

ROOT = Path(__file__).parents[2]


def everything(path):
    artifact = read_artifact(path)
    arrays = {name: artifact[name] for name in artifact.names()}
    return artifact.manifest, {name: (a.dtype, a.shape, a.tobytes()) for name, a in arrays.items()}


def small_artifact(path):
    arrays = {
        "frames": np.random.default_rng(0).integers(0, 256, (2, 2, 4, 4, 3), dtype=np.uint8),
        "final_distance": np.array([0.25, 0.5]),
        "contexts/name": np.array(["left", "right"]),
        "contexts/scalar": np.array(3),
    }
    return write_artifact(path, "demos", arrays, **PROVENANCE)


def test_a_killed_writer_leaves_the_old_artifact_or_the_new(tmp_path):
    target = tmp_path / "x.demos.h5"
    writer = textwrap.dedent(
        """
        import sys, numpy as np
        from artifacts import write_artifact
        print("ready", flush=True)
        for i in range(1_000_000):
            frames = np.full((40, 20, 16, 16, 3), i % 256, np.uint8)
            write_artifact(sys.argv[1], "demos", {"frames": frames, "final_distance": np.full(40, float(i))},
                           config={"i": i}, seed=i, command="loop")
        """
    )
    rng = random.Random(0)
    for _ in range(6):
        process = subprocess.Popen([sys.executable, "-c", writer, str(target)], stdout=subprocess.PIPE, cwd=ROOT)
        assert process.stdout.readline()
        # The first write takes longest: imports. From then on any moment is the middle of a write.
        deadline = time.monotonic() + 10
        before = target.stat().st_ino if target.exists() else None
        while time.monotonic() < deadline and (not target.exists() or target.stat().st_ino == before):
            time.sleep(0.002)
        time.sleep(rng.uniform(0, 0.05))
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        process.stdout.close()
        verify_artifact(target)
        artifact = read_artifact(target)
        i = artifact.config["i"]
        assert artifact.manifest.seed == i
        assert (artifact["frames"] == i % 256).all() and (artifact["final_distance"] == i).all()


@pytest.mark.parametrize("exception", [RuntimeError, KeyboardInterrupt])
def test_an_exception_leaves_the_old_file_and_nothing_else(demos, leftovers, monkeypatch, exception):
    before = demos.read_bytes()
    write = hdf5.write_dataset

    def interrupted(file, name, array):
        if name == "final_distance":
            raise exception("in the middle")
        write(file, name, array)

    monkeypatch.setattr(hdf5, "write_dataset", interrupted)
    with pytest.raises(exception):
        write_artifact(demos, "demos", demos_arrays(1), **PROVENANCE)
    assert demos.read_bytes() == before and leftovers() == []


def test_a_file_that_cannot_be_written_is_one_line(tmp_path, leftovers):
    (tmp_path / "file").write_text("")
    (tmp_path / "x.demos.h5").mkdir()
    for path in (tmp_path / "x.demos.h5", tmp_path / "file" / "x.demos.h5"):
        with pytest.raises(PlatformError, match="cannot be written") as caught:
            small_artifact(path)
        assert str(path) in str(caught.value) and "\n" not in str(caught.value)
    assert leftovers() == []


def test_a_full_disk_is_one_line_and_leaves_the_old_file(tmp_path, demos, leftovers):
    before = demos.read_bytes()
    writer = textwrap.dedent(
        """
        import resource, sys, numpy as np
        from artifacts import PlatformError, write_artifact
        resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))
        try:
            write_artifact(sys.argv[1], "demos", {"frames": np.ones((40, 20, 16, 16, 3), np.uint8),
                           "final_distance": np.zeros(40)}, config={}, seed=0, command="")
        except PlatformError as error:
            print(error)
            sys.exit(error.exit_code)
        """
    )
    run = subprocess.run([sys.executable, "-c", writer, str(demos)], capture_output=True, text=True, cwd=ROOT)
    assert run.returncode == 4, run.stderr
    assert run.stdout.count("\n") == 1 and "cannot be written" in run.stdout and run.stderr == ""
    assert demos.read_bytes() == before and leftovers() == []


def test_an_atomic_file_is_seen_only_when_done(tmp_path):
    path = tmp_path / "folder" / "a.txt"
    with atomic_path(path) as temporary:
        temporary.write_text("new")
        assert not path.exists() and temporary.parent.parent == path.parent
    assert path.read_text() == "new" and len(list(path.parent.iterdir())) == 1


def test_truncation_at_any_length_is_noticed(tmp_path):
    whole = small_artifact(tmp_path / "whole.h5").read_bytes()
    path = tmp_path / "cut.h5"
    for length in [*range(0, len(whole), max(1, len(whole) // 150)), len(whole) - 1]:
        path.write_bytes(whole[:length])
        with pytest.raises(ArtifactError, match=r"cut\.h5") as caught:
            verify_artifact(path)
        assert "\n" not in str(caught.value)


def test_a_flipped_byte_never_gives_other_data(tmp_path):
    source = small_artifact(tmp_path / "whole.h5")
    whole, expected = source.read_bytes(), everything(source)
    path = tmp_path / "flipped.h5"
    rng = random.Random(0)
    noticed = 0
    for position in rng.sample(range(len(whole)), 250):
        damaged = bytearray(whole)
        damaged[position] ^= rng.choice([0xFF, 1 << rng.randrange(8)])
        path.write_bytes(damaged)
        try:
            assert everything(path) == expected
        except ArtifactError as error:
            noticed += 1
            assert "flipped.h5" in str(error) and "\n" not in str(error)
    assert noticed > 25


def test_damaged_data_names_the_dataset(demos):
    frames = demos_arrays()["frames"].tobytes()
    raw = bytearray(demos.read_bytes())
    raw[raw.index(frames[:64]) + 20] ^= 1
    demos.write_bytes(raw)
    artifact = read_artifact(demos)
    np.testing.assert_array_equal(artifact["final_distance"], demos_arrays()["final_distance"])
    for function in (lambda: artifact["frames"], lambda: verify_artifact(demos)):
        with pytest.raises(ArtifactError, match=r"x\.demos\.h5: dataset frames is damaged"):
            function()


def test_no_handle_is_kept(demos):
    artifact = read_artifact(demos)
    artifact["frames"]
    assert str(demos) not in {os.readlink(f"/proc/self/fd/{fd}") for fd in open_descriptors()}
    assert h5py.h5f.get_obj_count(h5py.h5f.OBJ_ALL, h5py.h5f.OBJ_FILE) == 0


def open_descriptors():
    return [fd for fd in os.listdir("/proc/self/fd") if os.path.islink(f"/proc/self/fd/{fd}")]
