"""What is written down of results agrees: README, the paper's rates, and tables with the evaluations behind them."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

from artifacts import read_artifact
from stages.config.stages import HOUSEHOLD, TASKS
from stages.reporting.counting import count_once
from stages.reporting.paper import ROBOT, SUCCESS
from stages.reporting.rows import COLUMNS, as_csv, csv_text, read_runs, row
from stages.reproduction.plan import METHODS, Grid
from tests.stages.footage.catalog import MEDIA

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results"


@pytest.fixture
def script(monkeypatch):
    """A function that imports a script of results/ as it runs there."""
    before = set(sys.modules)
    monkeypatch.chdir(ROOT)
    monkeypatch.syspath_prepend(str(RESULTS))
    yield importlib.import_module
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(RESULTS)):
            del sys.modules[name]


def markdown_table(path: Path, head: str) -> list[list[str]]:
    """The cells of the rows below a table's head."""
    lines = iter(path.read_text(encoding="utf-8").splitlines())
    assert any(line.startswith(head) for line in lines), head
    next(lines)
    rows = []
    for line in lines:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return rows


def test_the_rates_of_the_paper_are_those_of_the_code():
    rows = markdown_table(ROOT / "docs/results.md", "| task | runs that succeed |")
    assert [cells[0] for cells in rows] == list(TASKS)
    assert markdown_table(ROOT / "README.md", "| task | runs that succeed |") == [cells[:3] for cells in rows]
    for cells in rows:
        rates = [float(rate) for rate in cells[-1].split(",")]
        assert rates == [SUCCESS[cells[0], "translation"], SUCCESS[cells[0], "oracle"]], cells[0]


def test_the_grid_is_what_the_paper_reports():
    grid = Grid()
    assert {(task, METHODS[name].label) for task in grid.tasks for name in grid.methods_of(task)} == set(SUCCESS)
    assert {task for task, _ in ROBOT} == set(HOUSEHOLD)


def test_the_files_of_a_grid_are_named_as_what_is_in_them():
    runs = {
        path.name.rpartition("-")[0]: run
        for path in sorted((RESULTS / "comparison").glob("*-c0.evaluation.h5"))
        for run in read_runs(read_artifact(path))
    }
    assert len(runs) == 21
    for name, run in runs.items():
        assert name == f"{run.task}-{METHODS[name.removeprefix(f'{run.task}-')].name}"
        assert run.method == METHODS[name.removeprefix(f"{run.task}-")].label


@pytest.mark.parametrize(("folder", "tables"), [("comparison", ("comparison", "ablation")), ("gps", ("gps",))])
def test_a_committed_csv_is_what_its_evaluations_come_to(folder, tables):
    paths = sorted((RESULTS / folder).glob("*.evaluation.h5"))
    runs, duplicates = count_once([run for path in paths for run in read_runs(read_artifact(path))])
    committed = {line for name in tables for line in (RESULTS / f"{name}.csv").read_bytes().decode().splitlines()}
    assert not duplicates and set(as_csv(runs).splitlines()) == committed


def test_the_household_tables_are_what_their_evaluations_come_to(script):
    real = script("real")
    cells: dict[tuple[str, str], list] = {}
    for task in HOUSEHOLD:
        for method, options in real.METHODS.items():
            for path in sorted(real.EVALUATIONS.glob(f"{task}-{method}-c*.evaluation.h5")):
                cells.setdefault((task, method), []).extend(script("commands").runs_of(path, options))
    assert real.markdown(cells) == (RESULTS / "real.md").read_text(encoding="utf-8")


def test_rows_of_the_papers_table_are_the_reports(script):
    paper = script("paper")
    evaluation = RESULTS / "paper-strike.evaluation.h5"
    found = paper.rows("strike", evaluation)
    assert found == [row(run) for run in read_runs(read_artifact(evaluation))] and len(found) == 10
    committed = (RESULTS / "paper.csv").read_bytes().decode()
    assert set(csv_text(COLUMNS, found).splitlines()) <= set(committed.splitlines())


def test_a_file_under_another_methods_name_is_refused(script):
    evaluation = RESULTS / "real" / "push-real-translation-c0.evaluation.h5"
    runs_of = script("commands").runs_of
    assert len(runs_of(evaluation)) == 1
    with pytest.raises(SystemExit, match="learned with starts None, expected 3"):
        runs_of(evaluation, ("--starts", 3))


def test_the_table_of_media_files_is_of_all_of_them():
    rows = markdown_table(RESULTS / "footage.md", "| file | what it is |")
    assert [cells[0] for cells in rows] == list(MEDIA)
    assert [cells[1] for cells in rows] == [media.what for media in MEDIA.values()]
    assert {cells[-1] for cells in rows} == {"agrees", "agrees, and says so", "told", "refused"}
