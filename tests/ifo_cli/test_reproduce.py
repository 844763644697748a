"""`ifo reproduce` as a user types it."""

import pytest


def test_a_dry_run_prints_commands_and_makes_nothing(run_ifo, tmp_path):
    out = tmp_path / "grid"
    words = ("reproduce", "--only", "reach", "--methods", "oracle", "--contexts", "1", "--dry-run", "--out", out)
    code, printed, said = run_ifo(*words)
    assert code == 0 and not out.exists()
    lines = printed.splitlines()
    assert len(lines) == 6 and all(" ifo " in line and float(line.split()[0]) > 0 for line in lines)
    assert "6 jobs" in said and "minutes" in said


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--only", "reach,pull"), "--only 'pull'"),
        (("--methods", "magic"), "--methods 'magic': expected a comma-separated choice of oracle"),
    ],
)
def test_unknown_names_are_refused(run_ifo, words, message, tmp_path):
    code, printed, said = run_ifo("reproduce", *words, "--out", tmp_path / "grid")
    assert (code, printed) == (2, "") and message in said
    assert not (tmp_path / "grid").exists()
