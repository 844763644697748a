"""`ifo ls`: the artifacts in folders as a table, a tree and JSON."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from artifacts import write_checkpoint
from tests.artifacts.sketches import DAY, record, sketch

ROOT = Path(__file__).parents[2]
MANY = 200
SECONDS = 6.0  # of processor time, generous: about one is measured


@pytest.fixture
def family(make):
    demos = make("demos", config={"task": "reach"})
    translator = make("translator", parents=[demos], config={"task": "reach", "steps": 9})
    return demos, translator, make("translation", parents=[translator], config={"task": "reach"})


def test_a_table_on_standard_output(run_ifo, family, tmp_path):
    code, out, err = run_ifo("ls", tmp_path)
    lines = out.splitlines()
    assert (code, err) == (0, "") and "\x1b" not in out
    assert lines[0].split() == ["path", "kind", "task", "method", "key", "figures", "size", "age", "parents"]
    assert [line.split()[0] for line in lines[1:4]] == [str(path) for path in family]
    assert "2 videos of 3 frames, 8x8" in lines[1] and "KiB" in lines[1] and "reach" in lines[1]
    assert lines[2].endswith(" ok") and "translation" in lines[3] and lines[4].startswith("3 files, ")


def test_the_default_folder_is_runs(run_ifo, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = run_ifo("ls")
    assert (code, out) == (3, "") and err == "ifo: runs: no such folder: name the folders that hold artifacts\n"
    sketch(tmp_path / "runs" / "x.demos.h5")
    code, out, err = run_ifo("ls")
    assert (code, err) == (0, "") and out.splitlines()[1].startswith("runs/x.demos.h5")


def test_an_empty_folder(run_ifo, tmp_path):
    code, out, err = run_ifo("ls", tmp_path)
    assert (code, out, err) == (0, "", f"ifo: no artifacts in {tmp_path}\n")
    code, out, err = run_ifo("ls", tmp_path, "--json")
    assert (code, json.loads(out), err) == (0, {"artifacts": [], "problems": []}, "")


def test_parents_that_changed_or_are_missing(run_ifo, family, make, tmp_path):
    make("demos", seed=8)
    family[1].unlink()
    make("translator", name="y", parents=[family[0]])
    found = {one["path"]: one for one in json.loads(run_ifo("ls", tmp_path, "--json")[1])["artifacts"]}
    assert found[str(family[2])]["intact"] == "missing"
    assert found[str(family[2])]["parents"] == [{"kind": "translator", "path": str(family[1]), "state": "missing"}]
    assert found[str(tmp_path / "y.translator.h5")]["intact"] == "ok"
    sketch(tmp_path / "z.translator.h5", [record(tmp_path / "z", family[0], content="another")])
    table = run_ifo("ls", tmp_path, "--kind", "translator")[1].splitlines()
    assert [line.split()[-1] for line in table[1:-1]] == ["ok", "changed"]


def test_json_has_everything(run_ifo, tmp_path):
    figures = {"psnr": 25.0, "feature_ratio": float("nan"), "ssim": 0.5}
    path = sketch(tmp_path / "x.translator.h5", summary=figures, config={"task": "reach", "steps": 0}, seed=7)
    code, out, _ = run_ifo("ls", tmp_path, "--json")
    (found,) = json.loads(out)["artifacts"]
    assert code == 0 and out.count("\n") == 1
    assert found.pop("created").endswith("+00:00")
    assert found == {
        "path": str(path),
        "kind": "translator",
        "task": "reach",
        "method": "random (demonstrations unknown)",
        "key_figures": "PSNR 25.0 dB",
        "figures": {"psnr": 25.0, "feature_ratio": None, "ssim": 0.5},
        "bytes": path.stat().st_size,
        "seed": 7,
        "command": "ifo train-translator",
        "intact": "",
        "parents": [],
    }


def test_what_cannot_be_read_is_one_line_each(run_ifo, family, tmp_path):
    (tmp_path / "notes.h5").write_text("mine")
    family[2].write_bytes(family[2].read_bytes()[:-100])
    write_checkpoint(tmp_path / "x.policy.checkpoint.h5", {}, stage="learn-policy", config={}, seed=0, command="ifo")
    code, out, err = run_ifo("ls", tmp_path)
    assert (code, err) == (0, "") and "unfinished" in out and "3 files" in out
    assert f"{tmp_path / 'notes.h5'}: not an artifact" in out.splitlines()
    (line,) = (line for line in out.splitlines() if str(family[2]) in line)
    assert "truncated or damaged" in line
    problems = json.loads(run_ifo("ls", tmp_path, "--json")[1])["problems"]
    assert [one["foreign"] for one in problems] == [True, False]


def test_names_cannot_fake_lines(run_ifo, tmp_path):
    sketch(tmp_path / "x.policy.h5", config={"task": "reach\nfake\x1b[31m", "reward": "[red]oracle"})
    code, out, _ = run_ifo("ls", tmp_path)
    assert code == 0 and out.count("\n") == 3 and "\x1b" not in out and "[red]oracle" in out


def test_the_tree(run_ifo, family, tmp_path):
    _, out, _ = run_ifo("ls", tmp_path, "--tree")
    indents = [len(line) - len(line.lstrip()) for line in out.splitlines()[1:4]]
    assert indents == [0, 2, 4]
    code, out, err = run_ifo("ls", tmp_path, "--tree", "--json")
    assert (code, out) == (2, "") and "--tree has no effect with --json" in err


def test_sorting_and_kinds(run_ifo, family, tmp_path):
    def names(*words):
        return [Path(one["path"]).name for one in json.loads(run_ifo("ls", tmp_path, "--json", *words)[1])["artifacts"]]

    sketch(tmp_path / "a.demos.h5", age=DAY)
    assert names("--kind", "demos", "--kind", "translation") == ["a.demos.h5", "x.demos.h5", "x.translation.h5"]
    assert names("--sort", "age")[-1] == "a.demos.h5" and names("--sort", "path")[0] == "a.demos.h5"
    code, out, err = run_ifo("ls", tmp_path, "--kind", "nonsense")
    assert (code, out) == (2, "") and err.count("\n") == 1


def test_many_artifacts_are_listed_at_once(tmp_path):
    config = {f"option_{number}": number / 3 for number in range(40)} | {"task": "reach", "steps": 9}
    summary = {f"figure_{number}": number / 7 for number in range(20)} | {"psnr": 20.0}
    previous = None
    for number in range(MANY):
        kind = ("demos", "translator", "translation", "policy", "evaluation")[number % 5]
        more = {"reward": "translation"} if kind == "policy" else {}
        more |= {"runs": [{"reward": "translation", "translator": {}}]} if kind == "evaluation" else {}
        path = tmp_path / f"n{number // 5}.{kind}.h5"
        parents = [previous] if number % 5 else []
        previous = sketch(path, parents, config=config | more, summary=summary, environment={"torch": "2.13"})
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "ifo_cli.main", "ls", str(tmp_path)]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert len(done.stdout.splitlines()) == MANY + 2 and done.stdout.count(" ok") == MANY * 4 // 5
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < SECONDS


def test_listing_loads_no_torch(tmp_path):
    sketch(tmp_path / "x.demos.h5")
    code = (
        "import sys; from ifo_cli.main import main; main(['ls', sys.argv[1]]); main(['gc', sys.argv[1]]);"
        "print([m for m in ('torch', 'mujoco', 'scipy', 'matplotlib', 'av') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.splitlines()[-1] == "[]"
