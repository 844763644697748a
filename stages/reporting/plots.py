"""Plots of runs by task and method, as PNGs."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from artifacts import Artifact, stem_of
from stages.reporting.environment_runs import Curve, EnvironmentSummary
from stages.reporting.rows import Run
from stages.reporting.summary import Summary
from stages.runtime.terminal import one_line

PANEL = (4.6, 3.4)  # inches, size of a learning-curve panel
LEGEND_LINE = 0.15  # inches, height of a legend line
BAR = 0.34  # inches, height of a bar with its gap
WIDTH = 7.6  # inches, width of bar plots
LONGEST_LABEL = 80  # characters; a longer one would leave no room for the plot
MOST_PANELS = 12  # panels of training curves
# Learning curves, in the order in which they say most of how a policy acts, and the labels of their axes.
LABELS = {
    "normalised_distance": "final distance / initial distance",
    "success": "success rate",
    "env_return": "return of the environment's own reward",
}
ABLATED = "translation"  # prefix of the names of the method and of its ablations


def draw(summaries: Sequence[Summary]) -> dict[str, bytes]:
    """All plots that can be drawn from the runs, by name: `success`, `curves`, `ablations`."""
    colours = _colours(summaries)
    plots = {"success": _bars(summaries, colours)}
    if any(run.samples_curve.size for item in summaries for run in item.runs):
        plots["curves"] = _curves(summaries, colours)
    ablations = ablated(summaries)
    if ablations:
        plots["ablations"] = _bars(ablations, colours)
    return plots


def draw_environments(summaries: Sequence[EnvironmentSummary]) -> dict[str, bytes]:
    """The plots of runs in Gymnasium environments, by name: `environments`, `environment-curves`."""
    colours = _colours(summaries)
    plots = {}
    if known := [item for item in summaries if item.success is not None]:
        plots["environments"] = _bars(known, colours)
    shown = [curves for task in dict.fromkeys(item.task for item in summaries) for curves in _learned(summaries, task)]
    if shown:
        plots["environment-curves"] = _curves(shown, colours)
    return plots


@dataclass(frozen=True)
class _Learned:
    """The learning curves of one environment and method, as `_curves` draws them."""

    task: str
    method: str
    runs: tuple[Curve, ...]
    curve_label: str
    threshold: None = None


def _learned(summaries: Sequence[EnvironmentSummary], task: str) -> list[_Learned]:
    """Success rates, if all runs in an environment have them, or else returns; no curves if none has any."""
    group = [item for item in summaries if item.task == task]
    rated = all(run.success_curve.curve.size for item in group for run in item.runs)
    label = LABELS["success" if rated else "env_return"]
    found = [
        _Learned(task, item.method, tuple(run.success_curve if rated else run.return_curve for run in item.runs), label)
        for item in group
    ]
    return [item for item in found if any(curve.curve.size for curve in item.runs)]


def ablated(summaries: Sequence[Summary]) -> list[Summary]:
    """The method and its ablations, of tasks with more than one of them."""
    found = [item for item in summaries if item.method.startswith(ABLATED)]
    tasks = [item.task for item in found]
    return [item for item in found if tasks.count(item.task) > 1]


def mean_curve(runs: Sequence[Run | Curve]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean of learning curves, and its standard error.

    A run that ended early keeps its last value, so that the mean does not jump there.

    Returns:
        Samples (I,) at which any run was measured; mean (I,); standard error (I,), 0 for one run.
    """
    curves = [(run.samples_curve, run.curve) for run in runs if run.samples_curve.size]
    # Start where all runs have been measured.
    start = max(samples[0] for samples, _ in curves)
    grid = np.unique(np.concatenate([samples for samples, _ in curves]))
    grid = grid[grid >= start]
    values = np.array([np.interp(grid, samples, distances) for samples, distances in curves])
    spread = values.std(axis=0, ddof=1) if len(values) > 1 else np.zeros(len(grid))
    return grid, values.mean(axis=0), spread / math.sqrt(len(values))


def _colours(summaries: Sequence[Summary | EnvironmentSummary]) -> dict[str, Any]:
    pyplot = _pyplot()
    methods = list(dict.fromkeys(item.method for item in summaries))
    palette = pyplot.get_cmap("tab10" if len(methods) <= 10 else "tab20")
    return {method: palette(index % palette.N) for index, method in enumerate(methods)}


def _bars(summaries: Sequence[Summary | EnvironmentSummary], colours: dict[str, Any]) -> bytes:
    """Success rates as bars with their intervals and the paper's rates, one panel per task."""
    pyplot = _pyplot()
    tasks = list(dict.fromkeys(item.task for item in summaries))
    groups = [[item for item in summaries if item.task == task] for task in tasks]
    sizes = [len(group) + 1 for group in groups]
    figure, panels = pyplot.subplots(
        len(tasks), figsize=(WIDTH, BAR * sum(sizes) + 1.1), dpi=120, sharex=True, squeeze=False, height_ratios=sizes
    )
    for panel, task, group in zip(panels[:, 0], tasks, groups, strict=True):
        for place, item in enumerate(group):
            rate, (low, high) = item.success or 0.0, item.success_interval or (0.0, 0.0)
            error = [[max(0.0, rate - low)], [max(0.0, high - rate)]]
            panel.barh(place, rate, 0.7, xerr=error, color=colours[item.method], ecolor="0.3", capsize=3)
            if item.paper is not None:
                panel.plot(item.paper, place, "D", color="white", markeredgecolor="black", markersize=6, zorder=5)
        labels = [_plain(item.label) for item in group]
        panel.set_yticks(range(len(group)), labels, fontsize=8)
        panel.set(xlim=(-0.02, 1.02), ylim=(len(group) - 0.4, -0.6))
        panel.set_title(_plain(task), fontsize=9, loc="left")
        panel.grid(axis="x", linewidth=0.4)
        panel.set_axisbelow(True)
        panel.spines[["top", "right"]].set_visible(False)
    paper = "; diamonds: in the paper" if any(item.paper is not None for item in summaries) else ""
    panels[-1, 0].set_xlabel(f"success rate, with 95% intervals{paper}", fontsize=9)
    return _png(figure)


def _curves(summaries: Sequence[Summary | _Learned], colours: dict[str, Any]) -> bytes:
    """Learning curves, one panel per task: mean over runs, standard error as a band."""
    pyplot = _pyplot()
    known = [item for item in summaries if any(run.samples_curve.size for run in item.runs)]
    tasks = list(dict.fromkeys(item.task for item in known))
    columns = min(2, len(tasks))
    rows = math.ceil(len(tasks) / columns)
    lines = max(sum(item.task == task for item in known) for task in tasks) // 2 + 1  # the legend has two columns
    size = (PANEL[0] * max(columns, 1.4), (PANEL[1] + LEGEND_LINE * lines) * rows)
    figure, panels = pyplot.subplots(rows, columns, figsize=size, dpi=120, squeeze=False)
    for panel in panels.flat[len(tasks) :]:
        panel.set_visible(False)
    for panel, task in zip(panels.flat, tasks, strict=False):
        group = [item for item in known if item.task == task]
        for item in group:
            samples, mean, error = mean_curve(item.runs)
            count = sum(bool(run.samples_curve.size) for run in item.runs)
            panel.plot(samples, mean, color=colours[item.method], label=_plain(f"{item.method} ({count})"))
            panel.fill_between(samples, mean - error, mean + error, color=colours[item.method], alpha=0.25, linewidth=0)
        threshold = group[0].threshold
        if threshold is not None:
            panel.axhline(threshold, color="grey", linestyle="--", linewidth=1, label=f"success below {threshold:g}")
        panel.set_title(_plain(task), fontsize=9, loc="left")
        panel.set_xlabel("samples", fontsize=8)
        panel.set_ylabel(group[0].curve_label, fontsize=8)
        if "return" not in group[0].curve_label:
            panel.set_ylim(0, None)
        panel.tick_params(labelsize=8)
        panel.legend(fontsize=7, ncols=2, loc="upper left", bbox_to_anchor=(0, -0.16), frameon=False)
        panel.spines[["top", "right"]].set_visible(False)
    return _png(figure)


def _plain(text: str) -> str:
    """A text of one short line, escaped so that matplotlib reads no formula in it."""
    shown = text if len(text) <= LONGEST_LABEL else f"{text[:LONGEST_LABEL]}..."
    return one_line(shown).replace("$", r"\$")


def _pyplot() -> Any:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def _png(figure: Any) -> bytes:
    drawn = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # about letters that the font does not have
        figure.tight_layout()
        figure.savefig(drawn, format="png", metadata={"Software": None})
    _pyplot().close(figure)
    return drawn.getvalue()


def plot_learning_curves(
    policies: Sequence[Artifact],
    threshold: float | None,
    curve: str = "normalised_distance",
    label: str = LABELS["normalised_distance"],
) -> bytes:
    """A PNG of policies' learning curves over samples, one line per policy.

    Args:
        policies: The policies, or experts.
        threshold: Value below which a run succeeds; None: there is none.
        curve: Name of the curve.
        label: Label of its axis.
    """
    pyplot = _pyplot()
    figure, axes = pyplot.subplots(figsize=(7, 4.5), dpi=120)
    for policy in policies:
        reward = policy.config.get("reward")
        shown = _plain(stem_of(policy.path) + (f" ({reward})" if reward else ""))
        axes.plot(policy["curve/samples"], policy[f"curve/{curve}"], label=shown)
    if threshold is not None:
        axes.axhline(threshold, color="grey", linestyle="--", linewidth=1, label=f"success below {threshold}")
    axes.set(xlabel="samples", ylabel=label, **({} if threshold is None else {"ylim": (0, None)}))
    axes.legend(fontsize=7)
    return _png(figure)


def plot_curves(steps: np.ndarray, curves: Mapping[str, np.ndarray]) -> bytes:
    """A PNG of training curves over steps (I,), one panel per measure.

    Args:
        steps: Steps (I,) at which the curves were measured.
        curves: Values (I,) by name: `held_out/psnr` and `held_out/copy_psnr` share the panel `psnr`.
    """
    panels: dict[str, list[str]] = {}
    for name in curves:
        panels.setdefault(name.rpartition("/")[2].removeprefix("copy_"), []).append(name)
    shown = list(panels.items())[:MOST_PANELS]
    columns = min(3, len(shown))
    rows = math.ceil(len(shown) / columns)
    figure, axes = _pyplot().subplots(rows, columns, figsize=(3.7 * columns, 2.7 * rows), dpi=110, squeeze=False)
    for panel in axes.flat[len(shown) :]:
        panel.set_visible(False)
    for panel, (measure, names) in zip(axes.flat, shown, strict=False):
        for name in names:
            panel.plot(steps, curves[name], marker="." if len(steps) < 30 else "", label=_plain(name))
        panel.set_title(_plain(measure), fontsize=9, loc="left")
        panel.set_xlabel("steps", fontsize=8)
        panel.tick_params(labelsize=8)
        panel.legend(fontsize=7)
    return _png(figure)


def plot_quality(curves: Mapping[str, np.ndarray]) -> bytes:
    """A PNG of `Quality.curves`: both terms of the reward, and the true distance, over time."""
    pyplot = _pyplot()
    figure, axes = pyplot.subplots(1, 3, figsize=(11, 3.4), dpi=110)
    titles = {"feat": "R_feat", "img": "R_img", "distance": "distance / initial distance"}
    for panel, (name, title) in zip(axes, titles.items(), strict=True):
        for kind, colour in (("expert", "tab:green"), ("noisy", "tab:orange"), ("random", "tab:red")):
            values = curves[f"{kind}/{name}"]
            panel.plot(values.T, color=colour, alpha=0.25, linewidth=0.8)
            panel.plot(values.mean(axis=0), color=colour, label=kind)
        panel.set(title=title, xlabel="frame")
    axes[0].legend(fontsize=8)
    return _png(figure)
