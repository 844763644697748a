"""The commands that look at things."""

from __future__ import annotations

import json
import os

import pytest

from artifacts import PlatformError, write_checkpoint
from ifo_cli import doctor
from stages.simulation import gl
from tests.artifacts.forging import forge


@pytest.fixture
def family(make):
    demos = make("demos")
    translator = make("translator", parents=[demos])
    return demos, translator, make("translation", parents=[translator])


def test_inspect_shows_origin_data_and_lineage(run_ifo, family):
    demos, translator, translation = family
    code, out, err = run_ifo("inspect", translation)
    assert (code, err) == (0, "") and "\x1b" not in out
    for part in ("translation", "ifo translation", "target_features", "3x4", "float32", "seed", "toy"):
        assert part in out
    assert out.index(str(translator)) < out.index(str(demos))


def test_inspect_says_missing(run_ifo, family):
    family[0].unlink()
    code, out, _ = run_ifo("inspect", family[2])
    assert code == 0 and "missing" in out


def test_inspect_says_changed_and_tells_nothing_of_the_new_file(run_ifo, family, make):
    _, translator, translation = family
    make("translator", parents=[family[0]], seed=77)
    assert json.loads(run_ifo("inspect", translator, "--json")[1])["seed"] == 77
    report = json.loads(run_ifo("inspect", "--json", translation)[1])
    (changed,) = report["lineage"]
    assert changed["state"] == "changed" and "seed" not in changed
    assert run_ifo("inspect", translation)[1].rstrip().endswith("changed")


def test_inspect_json(run_ifo, family):
    code, out, _ = run_ifo("inspect", "--json", stdin=f"{family[2]}\n")
    report = json.loads(out)
    assert code == 0 and out.count("\n") == 1
    assert [(a["depth"], a["kind"]) for a in report["lineage"]] == [(1, "translator"), (2, "demos")]
    assert {"name": "target_features", "shape": [3, 4], "dtype": "float32", "bytes": 48} in report["datasets"]


def test_inspect_shows_key_figures(run_ifo, make):
    _, out, _ = run_ifo("inspect", make("evaluation"))
    assert "Key figures" in out and "0.25" in out and "0.1, 0.4" in out


def test_inspect_shows_only_part_of_a_huge_configuration(run_ifo, make, tmp_path):
    many = {f"key {number}": number for number in range(3000)}
    path = forge(make("policy"), tmp_path / "huge.policy.h5", config={"long": "x" * 10**6, "y" * 10**6: 1, **many})
    code, out, _ = run_ifo("inspect", path)
    assert code == 0 and "more (--json shows all)" in out and len(out) < 100_000
    assert len(json.loads(run_ifo("inspect", path, "--json")[1])["config"]) > 3000


def test_inspect_of_no_artifact(run_ifo, tmp_path):
    path = tmp_path / "x.demos.h5"
    path.write_text("no")
    code, out, err = run_ifo("inspect", path)
    assert (code, out) == (3, "") and err.count("\n") == 1


def test_verify_checks_every_file(run_ifo, family):
    demos, translator, translation = family
    code, out, err = run_ifo("verify", *family)
    assert (code, err) == (0, "")
    assert out.splitlines()[1] == f"ok {translator} (translator, 1 dataset, 1 parent)"
    data = bytearray(demos.read_bytes())
    data[len(data) // 2] ^= 0xFF
    demos.write_bytes(data)
    code, out, err = run_ifo("verify", *family)
    assert code == 3 and err.count("\n") == 1 and f"{demos}: dataset frames is damaged" in err
    whole = [f"ok {translator} (translator, 1 dataset, 1 parent)"]
    assert out.splitlines() == [*whole, f"ok {translation} (translation, 3 datasets, 1 parent)"]
    demos.unlink()
    code, out, err = run_ifo("verify", translator)
    assert (code, out) == (3, "") and str(translator) in err and str(demos) in err


def test_verify_checks_every_artifact_below_a_folder(run_ifo, family, make, tmp_path):
    demos, translator, translation = family
    (tmp_path / "deep" / "er").mkdir(parents=True)
    policy = make("policy").rename(tmp_path / "deep" / "er" / "x.policy.h5")
    checkpoint = tmp_path / "x.policy.checkpoint.h5"
    write_checkpoint(checkpoint, {"done": 1}, stage="learn-policy", config={}, seed=0, command="ifo")
    (tmp_path / "lift.h5").write_bytes(b"somebody else's")
    code, out, err = run_ifo("verify", tmp_path, demos)
    found = [line.split(" (")[0] for line in out.splitlines()]
    assert code == 0 and sorted(found) == sorted(
        f"ok {path}" for path in (demos, translator, translation, policy, checkpoint)
    )
    assert err == f"ifo: {tmp_path}: 1 more .h5 file skipped (not named NAME.KIND.h5)\n"
    for path in (policy, checkpoint):
        path.write_bytes(path.read_bytes()[:-100])
    code, out, err = run_ifo("verify", tmp_path)
    assert code == 3 and len(out.splitlines()) == 3
    assert len(err.splitlines()) == 3 and all(str(path) in err for path in (policy, checkpoint))


def test_verify_of_a_folder_without_artifacts(run_ifo, tmp_path):
    (tmp_path / "demos.h5").write_text("x")  # no name before the kind
    code, out, err = run_ifo("verify", tmp_path)
    assert (code, out) == (3, "") and err.count("\n") == 1 and "contains no artifacts" in err and str(tmp_path) in err


def test_doctor_says_what_to_do(run_ifo, monkeypatch):
    def fine():
        return "1.0"

    def ill():
        raise PlatformError("nothing draws")

    def broken():
        raise ImportError("libEGL.so.1")

    checks = {"torch": (fine, "x"), "gl backend": (ill, doctor.GL_REMEDY), "video": (broken, "reinstall av")}
    monkeypatch.setattr(doctor, "CHECKS", checks)
    code, out, _ = run_ifo("doctor")
    assert code == 4
    assert out.splitlines() == [
        "ok   torch: 1.0",
        f"fail gl backend: nothing draws; {doctor.GL_REMEDY}",
        "fail video: ImportError: libEGL.so.1; reinstall av",
    ]
    code, out, _ = run_ifo("doctor", "--json")
    assert code == 4 and [check["ok"] for check in json.loads(out)["checks"]] == [True, False, False]


def test_doctor_gives_the_reason_for_missing_gl_once(run_ifo, monkeypatch):
    def choose_backend(required=True):
        if required:
            raise PlatformError(f"no OpenGL backend works here (EGL: no driver found); on Debian run `{gl.INSTALL}`")
        return ""

    monkeypatch.setattr(gl, "choose_backend", choose_backend)
    monkeypatch.setattr(gl, "forget_backend", lambda: None)
    code, out, _ = run_ifo("doctor")
    failed = [line for line in out.splitlines() if not line.startswith("ok ")]
    assert code == 4
    assert failed == [
        f"fail gl backend: no OpenGL backend works here (EGL: no driver found); on Debian run `{gl.INSTALL}`",
        "fail rendered frame: rendering needs a GL backend; see gl backend",
    ]


@pytest.mark.gl
@pytest.mark.cuda
def test_doctor_names_the_gpu(run_ifo):
    import torch

    _, out, _ = run_ifo("doctor")
    assert torch.cuda.get_device_name(0) in out


def test_doctor_is_content_here(run_ifo):
    code, out, err = run_ifo("doctor")
    assert code == 0, out + err
    assert [line.split()[0] for line in out.splitlines()] == ["ok"] * len(doctor.CHECKS)


def test_verify_looks_at_all_that_is_named_like_an_artifact(run_ifo, make, tmp_path):
    make("demos")
    os.mkfifo(tmp_path / "a.demos.h5")
    (tmp_path / "b.demos.h5").symlink_to("nowhere")
    code, out, err = run_ifo("verify", tmp_path)
    assert code == 3 and out.count("ok ") == 1
    assert "a.demos.h5: cannot be read (not a regular file" in err and "b.demos.h5: no such file" in err


@pytest.mark.parametrize("command", ["inspect", "verify", "report", "export-demos", "translate"])
def test_a_name_that_cannot_be_is_one_line(run_ifo, tmp_path, command):
    (tmp_path / "loop.h5").symlink_to("loop.h5")
    for path in (tmp_path / ("x" * 300), tmp_path / "loop.h5"):
        words = ("--format", "robomimic") if command == "export-demos" else ()
        code, out, err = run_ifo(command, path, *words)
        assert (code, out) == (3, "") and err.count("\n") == 1
