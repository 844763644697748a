"""What `ifo view` prints, replaces and refuses."""

from __future__ import annotations

import json
import os
import webbrowser

import pytest

KINDS = ("expert", "demos", "translator", "translation", "policy", "evaluation")


@pytest.mark.parametrize("kind", KINDS)
def test_the_page_is_next_to_the_artifact_and_its_path_is_printed(run_ifo, make, tmp_path, kind):
    path = make(kind, name="a b")
    assert run_ifo("view", path, "--quiet") == (0, f"{tmp_path / f'a b.{kind}.html'}\n", "")
    page = (tmp_path / f"a b.{kind}.html").read_text()
    assert page.startswith("<!doctype html>") and f"<h1>a b.{kind}.h5</h1>" in page
    assert sorted(os.listdir(tmp_path)) == [f"a b.{kind}.h5", f"a b.{kind}.html"]


def test_json_and_the_path_on_standard_input(run_ifo, make, tmp_path):
    out = tmp_path / "new" / "page.html"
    code, printed, _ = run_ifo("view", "--out", out, "--json", stdin=f"{make('demos')}\n")
    assert code == 0 and printed.count("\n") == 1
    assert json.loads(printed) == {
        "path": str(out),
        "kind": "page",
        "of": "demos",
        "videos": 1,
        "bytes": out.stat().st_size,
    }


def test_an_own_page_is_replaced_and_no_other_file(run_ifo, make, tmp_path):
    path = make("policy")
    out = tmp_path / "x.policy.html"
    assert run_ifo("view", path)[0] == 0
    out.write_text(out.read_text() + "<!-- old -->")
    assert run_ifo("view", path)[0] == 0 and "<!-- old -->" not in out.read_text()
    generator = '<meta name="generator" content="ifo view">'
    for text in (
        "mine",
        "",
        f"{generator}",
        f"<!doctype html>\n<body>{generator}",
        "<!doctype html>\n" * 99 + generator,
    ):
        out.write_text(text)
        code, printed, err = run_ifo("view", path)
        assert (code, printed) == (2, "") and err.count("\n") == 1 and str(out) in err and "--out" in err
        assert out.read_text() == text
    out.unlink()
    os.mkfifo(out)
    assert run_ifo("view", path)[0] == 2


@pytest.mark.parametrize("fault", ["missing", "text", "truncated", "corrupt", "checkpoint"])
def test_a_damaged_or_foreign_file_is_one_line(run_ifo, make, tmp_path, fault):
    path = make("translation")
    data = path.read_bytes()
    if fault == "missing":
        path.unlink()
    elif fault == "text":
        path.write_text("hello")
    elif fault == "truncated":
        path.write_bytes(data[:-100])
    elif fault == "corrupt":
        flipped = bytearray(data)
        flipped[len(data) // 2] ^= 0xFF
        path.write_bytes(flipped)
    else:
        from artifacts import write_checkpoint

        write_checkpoint(path, {"done": 1}, stage="learn-policy", config={}, seed=0, command="ifo")
    code, out, err = run_ifo("view", path)
    assert (code, out) == (3, "") and err.count("\n") == 1 and str(path) in err
    assert not list(tmp_path.glob("*.html"))


def test_damage_where_nothing_is_shown_is_found(run_ifo, make):
    path = make("policy")
    data = path.read_bytes()
    place = data.index(b"\x00\x00\x80\x3f\x00\x00\x00\x40")  # weights 1.0, 2.0
    path.write_bytes(data[:place] + b"\1" + data[place + 1 :])
    code, _, err = run_ifo("view", path)
    assert code == 3 and "weights/a is damaged" in err


@pytest.mark.parametrize("out", ["x.pdf", "folder.html"])
def test_bad_out(run_ifo, make, tmp_path, monkeypatch, out):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.html").mkdir()
    code, printed, err = run_ifo("view", make("demos"), "--out", out)
    assert (code, printed) == (2, "") and err.count("\n") == 1 and "--out" in err


def test_open_starts_a_browser_whose_output_is_not_ours(run_ifo, make, tmp_path, monkeypatch):
    opened = []

    def browser(address):
        print("a browser that prints")
        opened.append(address)
        return len(opened) == 1

    monkeypatch.setattr(webbrowser, "open", browser)
    path = make("demos", name="ä b")
    page = tmp_path / "ä b.demos.html"
    assert run_ifo("view", path, "--quiet")[0] == 0 and opened == []
    code, out, err = run_ifo("view", path, "--open", "--quiet")
    assert (code, out) == (0, f"{page}\n") and opened == [page.as_uri()]
    code, out, err = run_ifo("view", path, "--open", "--quiet")
    assert (code, out) == (0, f"{page}\n") and f"open {page} yourself" in err
