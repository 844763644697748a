"""`ifo gc`: what could be removed, and its removal."""

from __future__ import annotations

import json
import os
import time

import pytest

from tests.artifacts.sketches import DAY, sketch

MP4 = b"\0\0\0\x20ftypisom and so on"


@pytest.fixture
def folder(tmp_path):
    """A folder with one file of each category, and an evaluation with its policy."""
    runs = tmp_path / "runs"
    policy = sketch(runs / "kept.policy.h5")
    sketch(runs / "kept.evaluation.h5", [policy])
    demos = sketch(runs / "x.demos.h5", recipe={"stage": "collect-demos", "config": {}})
    sketch(runs / "x.translator.h5", [demos])
    (runs / ".x.demos.h5.tmp-abcdefgh").mkdir()
    (runs / ".x.demos.h5.tmp-abcdefgh" / "new").write_bytes(bytes(2048))
    config = {"stage": "learn-policy"}
    sketch(runs / "kept.policy.checkpoint.h5", config=config, age=2 * DAY)
    (runs / "gone.policy.mp4").write_bytes(MP4)
    os.utime(runs / "gone.policy.mp4", (time.time() - DAY,) * 2)
    return runs


def names(folder):
    return sorted(os.listdir(folder))


def test_nothing_is_removed_without_delete(run_ifo, folder, monkeypatch):
    monkeypatch.chdir(folder.parent)
    before = names(folder)
    code, out, err = run_ifo("gc")
    assert (code, err) == (0, "") and names(folder) == before
    lines = out.splitlines()
    assert lines[0].split() == ["path", "category", "size", "reason"]
    assert "2.0 KiB" in lines[1] and lines[1].endswith("left by a killed command")
    assert lines[2].endswith("kept.policy.h5 is finished")
    assert lines[3].startswith("2 items, ") and lines[3].endswith("to remove them: ifo gc runs --delete")
    assert lines[4].startswith("with --include orphans: 1 item")
    assert lines[5].startswith("with --include unused: 2 items")
    assert lines[6].startswith("kept: 2 artifacts")


def test_delete_removes_what_was_listed(run_ifo, folder):
    listed = [item["path"] for item in json.loads(run_ifo("gc", folder, "--json")[1])["items"]]
    code, out, err = run_ifo("gc", folder, "--delete")
    assert (code, err) == (0, "")
    assert [line.split()[1] for line in out.splitlines()[:-1]] == listed and out.splitlines()[-1].startswith(
        "removed 2"
    )
    assert names(folder) == [
        "gone.policy.mp4",
        "kept.evaluation.h5",
        "kept.policy.h5",
        "x.demos.h5",
        "x.translator.h5",
    ]
    assert run_ifo("gc", folder, "--delete")[:2] == (0, "removed 0 items, 0 B\n")


def test_all_categories(run_ifo, folder):
    include = [word for name in ("orphans", "superseded", "unused") for word in ("--include", name)]
    code, out, _ = run_ifo("gc", folder, *include, "--delete", "--json")
    report = json.loads(out)
    assert code == 0 and out.count("\n") == 1 and all(item["removed"] for item in report["items"])
    assert names(folder) == ["kept.evaluation.h5", "kept.policy.h5"]
    assert {item["reason"] for item in report["kept"]} == {"evaluation", f"needed by {folder / 'kept.evaluation.h5'}"}
    order = [os.path.basename(item["path"]) for item in report["items"]]
    assert order.index("x.translator.h5") < order.index("x.demos.h5")


def test_what_cannot_be_removed_is_one_line(run_ifo, folder, monkeypatch):
    def unlink(path, **_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "unlink", unlink)
    code, out, err = run_ifo("gc", folder, "--include", "orphans", "--delete")
    assert code == 4 and (folder / "gone.policy.mp4").exists()
    lines = [line for line in err.splitlines() if "gone.policy.mp4" in line]
    assert lines == [f"ifo: {folder / 'gone.policy.mp4'}: kept: cannot be removed (Permission denied)"]
    assert "gone" not in out


def test_damaged_files_are_named(run_ifo, folder):
    (folder / "y.evaluation.h5").write_text("")
    code, out, err = run_ifo("gc", folder, "--include", "unused", "--delete")
    assert code == 0 and err.count("\n") == 1 and "y.evaluation.h5" in err and "no artifact is removed" in err
    assert {"x.demos.h5", "x.translator.h5", "y.evaluation.h5"} <= set(names(folder)) and out.count("removed") == 3


def test_an_empty_folder(run_ifo, tmp_path):
    assert run_ifo("gc", tmp_path) == (0, "nothing to remove\n", "")


@pytest.mark.parametrize("words", [("none",), ("x.demos.h5",)])
def test_not_a_folder(run_ifo, folder, words):
    code, out, err = run_ifo("gc", *(folder / word for word in words))
    assert (code, out) == (3, "") and err.count("\n") == 1 and "folder" in err


def test_an_unknown_category(run_ifo, folder):
    code, out, err = run_ifo("gc", folder, "--include", "evaluations")
    assert (code, out) == (2, "") and err.count("\n") == 1


def test_an_interrupt_leaves_nothing_without_its_parents(run_ifo, folder, monkeypatch):
    usual = os.unlink

    def unlink(path, **options):
        usual(path, **options)
        if str(path).endswith("x.translator.h5"):
            raise KeyboardInterrupt

    monkeypatch.setattr(os, "unlink", unlink)
    code, _, err = run_ifo("gc", folder, "--include", "unused", "--delete")
    assert code == 130 and "interrupted" in err
    assert (folder / "x.demos.h5").exists() and not (folder / "x.translator.h5").exists()
