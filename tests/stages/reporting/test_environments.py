"""Runs in Gymnasium environments: success rates and returns on the page, in tables and as CSV."""

import csv
import dataclasses
import io
import math

import numpy as np
import pytest

from artifacts import ArtifactError, UsageError, read_artifact, write_artifact
from stages.environments.spec import EnvironmentSpec
from stages.environments.viewpoints import Viewpoint
from stages.report import report
from stages.reporting.counting import count_once
from stages.reporting.environment_runs import (
    Curve,
    environments_as_csv,
    read_environment_runs,
    summarise_environments,
)
from stages.reporting.plots import draw_environments, mean_curve
from stages.reporting.tables import environment_table
from stages.runtime.progress import Progress

NAME = "m:make task=slide (20 steps)"
CURVE = [[40.0, 80.0, math.nan]]


@pytest.fixture
def foreign(tmp_path):
    """A function that writes an evaluation of two runs in an environment; success rates per run, or none."""

    def write(name="slide", success=(1.0, 0.5), returns=(-2.0, -4.0), method="translation", env_seed=7, **fields):
        count = len(returns)

        def outcomes(values):
            return np.repeat(np.array(values, float)[:, None], 4, axis=1)

        arrays = {"env_return": outcomes(returns) + 1, "env_return_stochastic": outcomes(returns)}
        arrays |= {
            "curve/samples": np.repeat(CURVE, count, 0),
            "curve/env_return": np.repeat([[-9.0, -5.0, math.nan]], count, 0),
        }
        if success:
            arrays |= {"success": outcomes(success) / 2, "success_stochastic": outcomes(success)}
            arrays["curve/success"] = np.repeat([[0.25, 0.5, math.nan]], count, 0)
        run = {
            "reward": method,
            "translator": {"steps": 9, "minutes": 20.0},
            "own_context": False,
            "context_seed": -1,
            "environment": EnvironmentSpec("m:make", {"task": name}, env_seed, 20, 5).described(),
            "translation_metrics": {"psnr": 30.5},
            "samples": 80,
            "learning_minutes": 1.5,
        }
        runs = [{**run, "policy": f"{name}-{k}.policy.h5", "seed": k, **fields} for k in range(count)]
        config = {"task": None, "environment": run["environment"], "runs": runs}
        return write_artifact(
            tmp_path / f"{name}-{method}.evaluation.h5",
            "evaluation",
            arrays,
            config=config,
            seed=0,
            command="ifo evaluate",
        )

    return write


def runs_of(path):
    return read_environment_runs(read_artifact(path, "evaluation"))


def test_runs_have_their_own_success_rates_and_returns(foreign):
    first, second = runs_of(foreign())
    assert first.task == "m:make task=slide (20 steps)" and first.method == "translation" and first.seed_of_context == 7
    assert (first.success, second.success) == (1.0, 0.5)
    assert (first.success_deterministic, second.success_deterministic) == (0.5, 0.25)
    assert (first.env_return, second.env_return) == (-2.0, -4.0)
    assert (first.env_return_deterministic, second.env_return_deterministic) == (-1.0, -3.0)
    assert first.success_curve.curve.tolist() == [0.25, 0.5]
    assert first.success_curve.samples_curve.tolist() == first.samples_curve.tolist() == [40, 80]
    assert first.verdict == "100% of the episodes succeed, return -2.00"
    [unknown] = runs_of(foreign("other", success=None, returns=(-3.0,)))
    assert unknown.success is None and unknown.return_curve.curve.tolist() == [-9.0, -5.0]
    assert not any("success" in name for name in unknown.figures())


def test_a_row_per_run_and_a_summary_per_method(foreign):
    runs = [*runs_of(foreign()), *runs_of(foreign(method="oracle", success=(0.0,), returns=(-8.0,)))]
    first, *_ = csv.DictReader(io.StringIO(environments_as_csv(runs)))
    wanted = {
        "environment": "m:make task=slide (20 steps)",
        "env_seed": "7",
        "success": "1.0",
        "success_deterministic": "0.5",
    }
    wanted |= {
        "env_return": "-2.0",
        "env_return_deterministic": "-1.0",
        "episodes": "4",
        "samples": "80",
        "psnr": "30.5",
    }
    assert wanted.items() <= first.items()
    tracked, oracle = summarise_environments(runs)
    assert (tracked.success, tracked.deterministic, tracked.env_return) == (0.75, 0.375, -3.0)
    assert tracked.success_interval == (0.5, 1.0) and tracked.return_interval == (-4.0, -2.0)
    rows = environment_table([tracked, oracle]).rows
    assert rows[0] == (
        NAME, "translation", "2", "0.75 [0.50, 1.00]", "0.38", "-3 [-4, -2]", "80", "1.5", "20"
    )  # fmt: skip
    assert rows[1][1:6] == ("oracle", "1", "0.00", "0.00", "-8"), "one run has no spread"
    [without] = environment_table(summarise_environments(runs_of(foreign("other", success=None)))).rows
    assert without[3:6] == ("\N{EN DASH}", "\N{EN DASH}", "-3 [-4, -2]")


def drawn(monkeypatch, *groups):
    """What the curves of runs show: axis label and mean of the last point, by environment and method."""
    from stages.reporting import plots

    shown = {}

    def record(items, colours):
        for item in items:
            shown[item.task, item.method] = item.curve_label, mean_curve(item.runs)[1][-1]
        return b""

    monkeypatch.setattr(plots, "_curves", record)
    names = set(draw_environments(summarise_environments([run for runs in groups for run in runs])))
    return names, shown


def test_curves_are_of_one_quantity_per_environment(foreign, monkeypatch):
    label = "return of the environment's own reward"
    names, shown = drawn(monkeypatch, runs_of(foreign()), runs_of(foreign("z", success=None)))
    assert names == {"environments", "environment-curves"}
    assert shown["m:make task=slide (20 steps)", "translation"] == ("success rate", 0.5)
    assert shown["m:make task=z (20 steps)", "translation"] == (label, -5.0)
    names, shown = drawn(monkeypatch, runs_of(foreign("z", success=None)))
    assert names == {"environment-curves"}
    mixed = runs_of(foreign(method="oracle", success=None))
    _, shown = drawn(monkeypatch, runs_of(foreign()), mixed)
    assert {value for value in shown.values()} == {(label, -5.0)}, "not all runs have a success rate"


def test_success_that_was_unknown_while_learning_has_no_curve(foreign, monkeypatch):
    [run, *_] = runs_of(foreign())
    late = dataclasses.replace(run, success_curve=Curve(np.empty(0), np.empty(0)))
    names, shown = drawn(monkeypatch, [late])
    assert "environments" in names and [label for label, _ in shown.values()] == [
        "return of the environment's own reward"
    ]


def test_a_page_of_environments_and_of_both(foreign, evaluation, tmp_path):
    environments = foreign()
    result = report([environments], tmp_path / "one.html", "T", "ifo report", Progress(quiet=True))
    assert result.summary["environments"][0]["success"] == 0.75 and result.summary["methods"] == []
    page = (tmp_path / "one.html").read_text()
    assert "Success by environment and method" in page and "Success by task" not in page
    assert "slide-0.policy.h5: translation, context 7, seed 0: 100% of the episodes succeed" in page
    assert (tmp_path / "one-environments.csv").read_text().count("\n") == 3
    report([environments, evaluation()], tmp_path / "two.html", "T", "ifo report", Progress(quiet=True))
    page = (tmp_path / "two.html").read_text()
    assert page.index("Success by task and method") < page.index("Success by environment and method")
    text = (tmp_path / "two.md").read_text()
    assert "| reach | translation |" in text and "| m:make task=slide (20 steps) | translation |" in text
    assert (tmp_path / "two-environments.png").exists() and (tmp_path / "two-success.png").exists()


def test_an_evaluation_of_the_same_run_counts_once(foreign):
    first = runs_of(foreign())
    kept, duplicates = count_once([*first, *first])
    assert len(kept) == len(duplicates) == 2


@pytest.mark.parametrize(
    "change", [{"seed": 8}, {"viewpoint": Viewpoint(40, -30, 0.4)}, {"control_steps": 30}, {"success": "m:judge"}]
)
def test_another_context_length_or_judge_is_another_run(foreign, change):
    spec = dataclasses.replace(EnvironmentSpec("m:make", {"task": "slide"}, 7, 20, 5), **change)
    first, other = runs_of(foreign()), runs_of(foreign(environment=spec.described()))
    assert not count_once([*first, *other])[1]
    pooled = len(summarise_environments([*first, *other])) == 1
    assert pooled == (not {"control_steps", "success"} & set(change)), "only other contexts are runs of one row"


def test_files_of_a_users_are_not_replaced_and_old_ones_do_not_stay(foreign, evaluation, tmp_path):
    out, beside = tmp_path / "r.html", tmp_path / "r-environments.csv"
    quiet = Progress(quiet=True)
    report([evaluation()], out, "T", "ifo report", quiet)
    beside.write_text("mine\n")
    report([evaluation()], out, "T", "ifo report", quiet)
    with pytest.raises(UsageError, match=r"would replace .*r-environments\.csv"):
        report([foreign()], out, "T", "ifo report", quiet)
    assert beside.read_text() == "mine\n"
    beside.unlink()
    report([foreign()], out, "T", "ifo report", quiet)
    assert beside.exists()
    report([evaluation()], out, "T", "ifo report", quiet)
    assert not beside.exists()


def test_a_run_without_its_environment_is_refused(foreign):
    path = foreign(environment={"name": "m:make"})
    with pytest.raises(
        ArtifactError, match=r"slide-translation\.evaluation\.h5: runs\.0\.environment\.kwargs: field required"
    ):
        runs_of(path)
