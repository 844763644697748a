"""Runs, counted once and summed up."""

from __future__ import annotations

import csv
import dataclasses
import io

import numpy as np
import pytest

from artifacts import ArtifactError, read_artifact, write_artifact
from stages.reporting.counting import count_once
from stages.reporting.intervals import bootstrap_mean, wilson
from stages.reporting.plots import ablated, mean_curve
from stages.reporting.rows import COLUMNS, as_csv, row
from stages.reporting.summary import summarise
from stages.reporting.tables import summary_table


def policy(folder, name, weight=0.0):
    return write_artifact(
        folder / f"{name}.policy.h5", "policy", {"weights/a": np.array([weight])}, config={}, seed=0, command="ifo"
    )


def test_a_summary_has_rates_means_and_intervals(evaluation, runs_of):
    [found] = summarise(runs_of(evaluation(left=(0.1, 0.3, 0.8, 0.4))))
    assert (found.task, found.method, found.succeeded, found.success) == ("reach", "translation", 3, 0.75)
    assert found.success_interval == wilson(3, 4)
    assert found.deterministic == 0.75
    assert found.distance == pytest.approx(0.4)
    assert found.distance_interval == bootstrap_mean(np.array([0.1, 0.3, 0.8, 0.4]))
    assert (found.samples, found.learning_minutes, found.translator_minutes) == (300, 1.5, 20)
    assert found.paper == 0.85


def test_the_stochastic_policy_decides_the_success_of_a_run(evaluation, runs_of):
    near, far, edge = runs_of(evaluation(left=(0.25, 0.75, 0.5), deterministic=(0.8, 0.2, 0.4)))
    assert (near.success, far.success) == (True, False)
    assert (near.normalised_distance, far.normalised_distance) == (0.25, 0.75)
    assert (near.deterministic_distance, far.deterministic_distance) == (0.8, 0.2)
    assert (near.deterministic_success, far.deterministic_success) == (0.0, 1.0)
    assert (near.initial_distance, near.final_distance) == (2.0, 0.5)
    assert not edge.success, "to be at the threshold is not enough"
    table = list(csv.DictReader(io.StringIO(as_csv([near, far]))))
    assert [row["success_paper"] for row in table] == ["1", "0"]
    assert [row["normalised_distance"] for row in table] == ["0.25", "0.75"]
    assert [row["normalised_distance_deterministic"] for row in table] == ["0.8", "0.2"]
    assert [row["success_deterministic"] for row in table] == ["0.0", "1.0"]
    assert [(row["initial_distance"], row["final_distance"]) for row in table] == [("2.0", "0.5"), ("2.0", "1.5")]
    [found] = summarise([near, far])
    assert (found.succeeded, found.deterministic, found.distance) == (1, 0.5, 0.5)


def test_a_mean_over_episodes_is_judged_not_the_episodes(evaluation, runs_of, tmp_path):
    path = evaluation(left=(0.5,))
    artifact = read_artifact(path)
    arrays = {name: artifact[name] for name in artifact.names()}
    # Three of four episodes end near; the fourth spoils the mean.
    arrays["normalised_distance_stochastic"] = np.array([[0.1, 0.1, 0.1, 2.0]])
    arrays["normalised_distance"] = np.array([[0.5, 0.1, 0.1, 2.0]])
    write_artifact(path, "evaluation", arrays, config=dict(artifact.config), seed=0, command="ifo")
    [run] = runs_of(path)
    assert not run.success and run.normalised_distance == pytest.approx(0.575)
    assert run.deterministic_success == 0.5


def test_a_row_is_rounded_to_what_is_worth_reading(evaluation, runs_of):
    [run] = runs_of(evaluation(left=(0.123456,), learning_minutes=1.23456, translator={"minutes": 2.345}))
    found = row(dataclasses.replace(run, deterministic_success=2 / 3))
    assert found["normalised_distance"] == found["normalised_distance_deterministic"] == 0.1235
    assert (found["initial_distance"], found["final_distance"]) == (2.0, 0.2469)
    assert (found["success_deterministic"], found["psnr"]) == (0.667, 30.5)
    assert (found["learning_minutes"], found["translator_minutes"]) == (1.23, 2.3)


def test_a_summary_is_of_means_over_its_runs(evaluation, runs_of):
    first = evaluation(
        "first",
        (0.1,),
        deterministic=(0.9,),
        samples=100,
        learning_minutes=1.0,
        translator={"steps": 9, "minutes": 0.0},
    )
    second = evaluation(
        "second", (0.8,), samples=300, learning_minutes=4.0, translator={"steps": 9, "minutes": 20.0}, first_seed=1
    )
    third = evaluation("third", (0.9,), samples=500, learning_minutes=1.0, translator={"steps": 9}, first_seed=2)
    [found] = summarise(runs_of(first, second, third))
    assert (found.samples, found.learning_minutes, found.translator_minutes) == (300, 2.0, 10.0)
    assert found.success == pytest.approx(1 / 3)
    [row] = summary_table([found]).rows
    low, high = wilson(1, 3)
    near, far = bootstrap_mean(np.array([0.1, 0.8, 0.9]))
    assert row == (
        *("reach", "translation", "3", f"0.33 [{low:.2f}, {high:.2f}]", "0.85", "0.00"),
        *(f"0.600 [{near:.3f}, {far:.3f}]", "300", "2.0", "10"),
    )
    [alone] = summary_table(summarise(runs_of(second))).rows
    assert alone[6] == "0.800", "the distance of one run has no interval"
    [both] = summary_table(summarise(runs_of(first, second))).rows
    assert both[6].startswith("0.450 [0.100, ")


def test_curves_of_runs_are_their_own_without_what_fills_the_shorter_one(evaluation, runs_of):
    path = evaluation(left=(0.2, 0.4))
    artifact = read_artifact(path)
    arrays = {name: artifact[name] for name in artifact.names()}
    arrays["curve/samples"] = np.array([[100.0, 200.0, 300.0], [50.0, 150.0, np.nan]])
    arrays["curve/normalised_distance"] = np.array([[1.0, 0.6, 0.2], [0.9, 0.4, np.nan]])
    write_artifact(path, "evaluation", arrays, config=dict(artifact.config), seed=0, command="ifo")
    long, short = runs_of(path)
    assert (long.samples_curve.tolist(), long.distance_curve.tolist()) == ([100, 200, 300], [1.0, 0.6, 0.2])
    assert (short.samples_curve.tolist(), short.distance_curve.tolist()) == ([50, 150], [0.9, 0.4])


def test_a_run_without_a_policys_name_has_a_number(evaluation, runs_of):
    runs = runs_of(evaluation(left=(0.1, 0.2), policy=""))
    assert [run.name for run in runs] == ["run 1", "run 2"]


def test_success_is_judged_by_the_evaluations_own_threshold(evaluation, runs_of):
    path = evaluation(left=(0.52, 0.58), task="sweep", threshold=0.55)
    assert [run.success for run in runs_of(path)] == [True, False]


def test_older_evaluations_leave_threshold_and_method_to_others(evaluation, runs_of):
    runs = runs_of(evaluation(left=(0.52, 0.58), task="sweep", old=True))
    assert [run.success for run in runs] == [True, False]
    assert {run.method for run in runs} == {"translation (translator unknown)"}
    assert {run.unknown for run in runs} == {"translator"} and not any(run.samples_curve.size for run in runs)


def test_tasks_and_methods_have_one_order(evaluation, runs_of):
    methods = ("gail", "translation without img", "oracle", "translation")
    left = (0.1,) * 4
    runs = runs_of(evaluation("a", left, task="glide:Glide", methods=methods), evaluation("b", left, methods=methods))
    order = [(item.task, item.method) for item in summarise(runs)]
    assert order == [
        (task, method)
        for task in ("reach", "glide:Glide")
        for method in ("oracle", "translation", "translation without img", "gail")
    ]


def test_csv_has_a_row_a_run_and_knows_only_what_concerns_it(evaluation, runs_of):
    text = as_csv(runs_of(evaluation(left=(0.25, 0.75), methods=("translation", "oracle"))))
    table = list(csv.DictReader(io.StringIO(text)))
    assert tuple(table[0]) == COLUMNS and len(table) == 2
    translation, oracle = table
    assert (translation["normalised_distance"], translation["success_paper"]) == ("0.25", "1")
    assert (translation["final_distance"], translation["translator_minutes"]) == ("0.5", "20.0")
    assert (translation["psnr"], translation["tau_way"]) == ("30.5", "")
    # The oracle has a translation for a parent and learns nothing from it.
    assert (oracle["translator_minutes"], oracle["psnr"], oracle["success_paper"]) == ("", "", "0")


def test_a_policy_that_was_evaluated_twice_counts_once(evaluation, runs_of, tmp_path):
    one, two = policy(tmp_path, "one", 1), policy(tmp_path, "two", 2)
    both = evaluation("both", (0.1, 0.2), parents=[one, two])
    # The same file under another seed: the digest tells.
    again = evaluation("again", (0.3,), parents=[two], first_seed=5)
    kept, duplicates = count_once(runs_of(both, again))
    assert len(kept) == 2 and len(duplicates) == 1
    assert {item.run.evaluation.path for item in duplicates} < {both, again}


@pytest.mark.parametrize("newest", [0, 1, 2])
@pytest.mark.parametrize("by", ["seeds", "policy"])
def test_the_newest_evaluation_of_a_run_counts(evaluation, runs_of, tmp_path, newest, by):
    same = policy(tmp_path, "same")
    runs = []
    for number in range(3):
        parent = same if by == "policy" else policy(tmp_path, f"policy{number}", number)
        seed = number if by == "policy" else 0
        path = evaluation(f"evaluation{number}", (0.1 * (number + 1),), parents=[parent], first_seed=seed)
        [run] = runs_of(path)
        day = 9 if number == newest else number + 1
        run.evaluation.manifest = run.evaluation.manifest.model_copy(update={"created": f"2026-01-0{day}T00:00:00"})
        runs.append(run)
    [kept], duplicates = count_once(runs)
    assert kept.evaluation is runs[newest].evaluation
    assert [item.run.evaluation for item in duplicates] != [] and len(duplicates) == 2
    assert all(item.kept is kept for item in duplicates)


def test_the_same_method_and_seeds_count_once(evaluation, runs_of, tmp_path):
    first = evaluation("first", (0.1,), parents=[policy(tmp_path, "first", 1)])
    second = evaluation("second", (0.2,), parents=[policy(tmp_path, "second", 2)])
    other = evaluation("other", (0.3,), parents=[policy(tmp_path, "other", 3)], first_seed=1)
    kept, duplicates = count_once(runs_of(first, second, other))
    assert len(kept) == 2 and len(duplicates) == 1


def test_runs_of_other_settings_are_not_mixed(evaluation, runs_of, tmp_path):
    usual = evaluation("usual", (0.1, 0.1, 0.1), blur=4.0, iterations=60)
    other = evaluation("other", (0.9, 0.9), blur=0.0, iterations=60)
    # One that does not record the option, and what the oracle has no use for.
    silent = evaluation("silent", (0.2,), first_seed=1)
    oracle = evaluation("oracle", (0.1, 0.1), methods=("oracle",), blur=0.0)
    kept, duplicates = count_once(runs_of(usual, other, silent, oracle))
    assert not duplicates
    assert [run.method for run in kept] == [
        *["translation"] * 3,
        *["translation, blur 0"] * 2,
        "translation",
        *["oracle"] * 2,
    ]
    assert [item.paper for item in summarise(kept)] == [0.9, 0.85, None]


@pytest.mark.parametrize(
    ("reward", "matters"),
    [
        ("pretrained", {"ramp", "layer", "weights"}),
        ("gail", {"discriminator_steps"}),
        ("tpil", {"discriminator_steps"}),
        ("joints", {"ramp"}),
        ("video", {"ramp", "blur"}),
        ("oracle", set()),
    ],
)
def test_runs_are_told_apart_by_the_options_that_matter_to_their_reward(evaluation, runs_of, reward, matters):
    same = {"ramp": "none", "layer": "a", "weights": "x", "discriminator_steps": 40, "blur": 4.0}
    other = {"ramp": "linear", "layer": "b", "weights": "y", "discriminator_steps": 10, "blur": 8.0}
    runs = runs_of(evaluation("same", (0.1, 0.1), methods=(reward,), **same))
    for number, name in enumerate(same, 1):
        changed = {**same, name: other[name]}
        runs += runs_of(evaluation(name, (0.1,), methods=(reward,), first_seed=number, **changed))
    kept, _ = count_once(runs)
    assert kept[0].method == kept[1].method == reward
    found = {name for name, run in zip(same, kept[2:], strict=True) if run.method != reward}
    assert found == matters
    for name, run in zip(same, kept[2:], strict=True):
        value = f"{other[name]:g}" if isinstance(other[name], float) else other[name]
        assert run.method in (reward, f"{reward}, {name} {value}")


def test_what_most_do_not_record_tells_nobody_apart(evaluation, runs_of):
    silent = evaluation("silent", (0.1, 0.1))
    one = evaluation("one", (0.1,), blur=4.0, first_seed=1)
    kept, _ = count_once(runs_of(silent, one))
    assert [run.method for run in kept] == ["translation"] * 3


def test_translators_of_other_settings_are_told_apart(evaluation, runs_of):
    usual = evaluation("usual", (0.1, 0.1))
    other = evaluation("other", (0.1,), translator={"steps": 99, "minutes": 20.0}, first_seed=1)
    kept, _ = count_once(runs_of(usual, other))
    assert [run.method for run in kept] == [*["translation"] * 2, "translation, translator steps 99"]


def test_runs_from_before_an_option_had_what_was_then_the_only_way(evaluation, runs_of):
    before = evaluation("before", (0.4, 0.4), methods=("oracle",))
    nothing = evaluation("nothing", (0.4,), methods=("oracle",), starts=None, first_seed=1)
    three = evaluation("three", (0.1,), methods=("oracle",), starts=3)
    kept, duplicates = count_once(runs_of(before, nothing, three))
    assert [run.method for run in kept] == [*["oracle"] * 3, "oracle, starts 3"] and not duplicates


def test_older_evaluations_that_differ_in_their_policies_alone_are_told_apart(evaluation, runs_of, tmp_path):
    whole = evaluation("whole", (0.1,), old=True, parents=[policy(tmp_path, "whole", 1)])
    random = evaluation("random", (0.9,), old=True, parents=[policy(tmp_path, "random", 2)])
    kept, duplicates = count_once(runs_of(whole, random))
    unknown = "translation (translator unknown)"
    assert [run.method for run in kept] == [f"{unknown} (whole)", f"{unknown} (random)"] and not duplicates
    assert [item.paper for item in summarise(kept)] == [None, None]


def test_only_what_is_unknown_is_told_apart_by_file(evaluation, runs_of, tmp_path):
    parents = [policy(tmp_path, "one", 1), policy(tmp_path, "two", 2)]
    mixed = evaluation("mixed", (0.1, 0.1), old=True, methods=("translation", "oracle"), parents=parents)
    other = evaluation("other", (0.9,), old=True, parents=[policy(tmp_path, "three", 3)])
    alone = evaluation("alone", (0.9,), old=True, first_seed=5, parents=[policy(tmp_path, "four", 4)])
    kept, _ = count_once(runs_of(mixed, other, alone))
    unknown = "translation (translator unknown)"
    assert [run.method for run in kept] == [f"{unknown} (mixed)", "oracle", f"{unknown} (other)", unknown]


def test_runs_that_are_not_described_are_refused(evaluation, runs_of):
    path = evaluation("x", (0.1,), seed=0)
    runs_of(path)
    config = {"task": "reach", "success_threshold": 0.5, "runs": []}
    arrays = dict.fromkeys(
        ("initial_distance", "final_distance", "final_distance_stochastic", "normalised_distance_stochastic"),
        np.zeros((1, 2)),
    )
    arrays["normalised_distance"] = np.zeros((1, 2))
    write_artifact(path, "evaluation", arrays, config=config, seed=0, command="ifo")
    with pytest.raises(ArtifactError, match="describes 0 runs and holds 1"):
        runs_of(path)


def test_a_mean_curve_carries_on_runs_that_ended_early(evaluation, runs_of):
    path = evaluation(left=(0.2, 0.4))
    long, short = runs_of(path)
    samples, mean, error = mean_curve([long, short])
    assert samples.tolist() == [100, 200, 300]
    assert mean == pytest.approx([1, 0.65, 0.3])
    assert error == pytest.approx([0, 0.05, 0.1])
    short = type(short)(**{**vars(short), "samples_curve": np.array([100.0]), "distance_curve": np.array([0.6])})
    assert mean_curve([long, short])[1] == pytest.approx([0.8, 0.6, 0.4])
    late = type(short)(**{**vars(short), "samples_curve": np.array([200.0]), "distance_curve": np.array([0.6])})
    assert mean_curve([long, late])[0].tolist() == [200, 300], "a mean is of all runs, or there is none"
    samples, mean, error = mean_curve([long])
    assert mean == pytest.approx([1, 0.6, 0.2]) and error.tolist() == [0, 0, 0]


def test_ablations_are_shown_where_there_are_some(evaluation, runs_of):
    methods = ("translation", "translation without img", "oracle")
    runs = runs_of(evaluation("a", (0.1,) * 3, methods=methods), evaluation("b", (0.1,), task="push"))
    assert [(item.task, item.method) for item in ablated(summarise(runs))] == [
        ("reach", "translation"),
        ("reach", "translation without img"),
    ]
