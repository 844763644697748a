"""Plots contain the numbers, labels, limits and colors that the report promises."""

from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_hex, to_rgba

from stages.reporting import plots
from stages.reporting.plots import ablated, draw, mean_curve, plot_learning_curves, plot_quality

EMPTY = np.empty(0)


def run(samples=EMPTY, distances=EMPTY, threshold=0.5):
    return SimpleNamespace(
        samples_curve=np.asarray(samples, float), curve=np.asarray(distances, float), threshold=threshold
    )


def summary(task="reach", method="translation", success=0.75, interval=(0.5, 0.9), paper=None, runs=(), succeeded=3):
    runs = runs or [run()] * 4
    return SimpleNamespace(
        task=task,
        method=method,
        success=success,
        success_interval=interval,
        paper=paper,
        runs=runs,
        label=f"{method} ({succeeded} of {len(runs)})",
        threshold=runs[0].threshold,
        curve_label="final distance / initial distance",
    )


@pytest.fixture
def figures(monkeypatch):
    """Plots as figures instead of PNGs."""
    import matplotlib.pyplot as pyplot

    monkeypatch.setattr(plots, "_png", lambda figure: figure)
    yield
    pyplot.close("all")


def color(index, palette="tab10"):
    return to_rgba(matplotlib.colormaps[palette](index))


def test_success_rates_are_bars_with_intervals_and_the_papers_rates(figures):
    items = [
        summary(method="oracle", success=1.0, interval=(0.7, 1.0), succeeded=4),
        summary(method="translation $x$", success=0.75, interval=(0.5, 0.9), paper=0.6),
        summary("push $", "translation $x$", success=0.0, interval=(0.1, 0.3), succeeded=0),
    ]
    figure = draw(items)["success"]
    np.testing.assert_allclose(figure.get_size_inches(), (7.6, 0.34 * 5 + 1.1))
    assert figure.dpi == 120
    first, second = figure.axes
    heights = [axes.get_gridspec().get_height_ratios() for axes in figure.axes]
    assert heights == [[3, 2], [3, 2]]
    assert first.get_shared_x_axes().joined(first, second)
    colors = {"oracle": color(0), "translation $x$": color(1)}
    for panel, group in ((first, items[:2]), (second, items[2:])):
        bars = [patch for patch in panel.patches]
        for place, (bar, item) in enumerate(zip(bars, group, strict=True)):
            assert (bar.get_x(), bar.get_width(), bar.get_height()) == (0, item.success, pytest.approx(0.7))
            assert bar.get_y() + bar.get_height() / 2 == pytest.approx(place)
            assert bar.get_facecolor() == colors[item.method]
        errors = [container for container in panel.containers if hasattr(container, "has_xerr")]
        assert all(each.has_xerr and not each.has_yerr for each in errors) and len(errors) == len(group)
        for place, (error, item) in enumerate(zip(errors, group, strict=True)):
            _, caps, (bar,) = error.lines
            low, high = item.success_interval
            (start, end), color_of = bar.get_segments()[0], bar.get_colors()[0]
            assert start == pytest.approx((min(low, item.success), place))
            assert end == pytest.approx((max(high, item.success), place))
            assert to_hex(color_of) == "#4c4c4c" and {cap.get_markersize() for cap in caps} == {6}
        assert (*panel.get_xlim(), *panel.get_ylim()) == pytest.approx((-0.02, 1.02, len(group) - 0.4, -0.6))
        assert panel.get_axisbelow() is True
        assert [panel.spines[side].get_visible() for side in ("top", "right", "bottom", "left")] == [False] * 2 + [
            True
        ] * 2
        lines = [(line.get_visible(), line.get_linewidth()) for line in panel.xaxis.get_gridlines()]
        assert set(lines) == {(True, 0.4)}
        assert not any(line.get_visible() for line in panel.yaxis.get_gridlines())
        assert {label.get_fontsize() for label in panel.get_yticklabels()} == {8}
        assert panel.title.get_text() == "" and panel.get_title(loc="center") == ""
    diamonds = [line for line in first.lines if line.get_marker() == "D"]
    (diamond,) = diamonds
    assert diamond.get_xdata() == [0.6] and diamond.get_ydata() == [1]
    assert (diamond.get_color(), diamond.get_markeredgecolor(), diamond.get_markersize(), diamond.get_zorder()) == (
        "white", "black", 6, 5
    )  # fmt: skip
    assert not [line for line in second.lines if line.get_marker() == "D"]
    assert [label.get_text() for label in first.get_yticklabels()] == ["oracle (4 of 4)", r"translation \$x\$ (3 of 4)"]
    assert first.get_title(loc="left") == "reach" and second.get_title(loc="left") == r"push \$"
    assert first._left_title.get_fontsize() == 9
    assert first.get_xlabel() == ""
    assert second.get_xlabel() == "success rate, with 95% intervals; diamonds: in the paper"
    assert second.xaxis.label.get_fontsize() == 9
    without = draw([summary()])["success"]
    assert without.axes[0].get_xlabel() == "success rate, with 95% intervals"


def test_more_than_ten_methods_have_colors_of_a_larger_palette(figures):
    items = [summary(method=f"m{k}") for k in range(11)]
    bars = draw(items)["success"].axes[0].patches
    assert [bar.get_facecolor() for bar in bars] == [color(k, "tab20") for k in range(11)]
    bars = draw(items[:10])["success"].axes[0].patches
    assert [bar.get_facecolor() for bar in bars] == [color(k) for k in range(10)]
    many = [summary(method=f"m{k}") for k in range(21)]
    bars = draw(many)["success"].axes[0].patches
    assert bars[20].get_facecolor() == bars[0].get_facecolor()


def test_ablations_are_the_methods_of_tasks_that_have_several(figures):
    items = [
        summary(method="oracle"),
        summary(method="translation"),
        summary(method="translation without img"),
        summary("push", "translation"),
        summary("push", "gail"),
    ]
    assert ablated(items) == items[1:3]
    drawn = draw(items)
    assert set(drawn) == {"success", "ablations"}, "there are no learning curves"
    bars = drawn["ablations"].axes[0].patches
    assert [bar.get_facecolor() for bar in bars] == [color(1), color(2)], "as in the other plots"
    assert set(draw(items[3:])) == {"success"}


def test_a_mean_curve_starts_where_all_have_begun_and_keeps_the_end_of_those_that_stopped():
    runs = [run([100, 200, 300], [1.0, 0.8, 0.6]), run([200, 250], [0.4, 0.3]), run()]
    grid, mean, error = mean_curve(runs)
    np.testing.assert_array_equal(grid, [200, 250, 300])
    np.testing.assert_allclose(mean, [0.6, 0.5, 0.45])
    each = np.array([[0.8, 0.7, 0.6], [0.4, 0.3, 0.3]])
    np.testing.assert_allclose(error, each.std(axis=0, ddof=1) / np.sqrt(2))
    grid, mean, error = mean_curve(runs[:1])
    np.testing.assert_array_equal((grid, mean, error), ([100, 200, 300], [1.0, 0.8, 0.6], [0, 0, 0]))


def test_learning_curves_are_means_with_bands_and_a_threshold(figures):
    several = [run([100, 200], [1.0, 0.8], 0.55), run([100, 200], [0.6, 0.2]), run()]
    items = [
        summary(method="oracle"),
        summary(method="translation $", runs=several),
        summary("push", "gail", runs=[run([10, 20, 30], [1, 2, 3])]),
        summary("sweep", "gail", runs=[run([10, 20, 30], [1, 2, 3])]),
    ]
    figure = draw(items)["curves"]
    assert figure.dpi == 120
    np.testing.assert_allclose(figure.get_size_inches(), (4.6 * 2, (3.4 + 0.15) * 2))
    assert [panel.get_visible() for panel in figure.axes] == [True, True, True, False]
    panel = figure.axes[0]
    mean, threshold = panel.lines
    np.testing.assert_allclose(mean.get_xydata(), [[100, 0.8], [200, 0.5]])
    assert to_rgba(mean.get_color()) == color(1) and mean.get_label() == r"translation \$ (2)"
    (band,) = panel.collections
    error = np.array([0.4, 0.6]) / np.sqrt(2) / np.sqrt(2)
    path = band.get_paths()[0].vertices
    assert {tuple(np.round(at, 9)) for at in path} >= {
        (100.0, round(0.8 - error[0], 9)), (100.0, round(0.8 + error[0], 9)), (200.0, round(0.5 + error[1], 9))
    }  # fmt: skip
    assert tuple(band.get_facecolor()[0]) == pytest.approx((*color(1)[:3], 0.25)) and band.get_linewidth()[0] == 0
    assert threshold.get_ydata() == [0.55, 0.55] and threshold.get_label() == "success below 0.55"
    assert (threshold.get_color(), threshold.get_linestyle(), threshold.get_linewidth()) == ("grey", "--", 1)
    assert (panel.get_title(loc="left"), panel._left_title.get_fontsize()) == ("reach", 9)
    assert (panel.get_xlabel(), panel.xaxis.label.get_fontsize()) == ("samples", 8)
    assert (panel.get_ylabel(), panel.yaxis.label.get_fontsize()) == ("final distance / initial distance", 8)
    assert panel.get_ylim()[0] == 0 and panel.get_ylim()[1] > 1
    assert {label.get_fontsize() for label in panel.get_xticklabels() + panel.get_yticklabels()} == {8}
    assert not panel.spines["top"].get_visible() and not panel.spines["right"].get_visible()
    legend = panel.get_legend()
    assert [text.get_text() for text in legend.get_texts()] == [mean.get_label(), threshold.get_label()]
    assert {text.get_fontsize() for text in legend.get_texts()} == {7}
    assert legend._ncols == 2 and not legend.get_frame_on() and legend._loc == 2
    assert legend.get_bbox_to_anchor().transformed(panel.transAxes.inverted()).p0 == pytest.approx((0, -0.16))
    assert [panel.get_title(loc="left") for panel in figure.axes[:3]] == ["reach", "push", "sweep"]
    assert to_rgba(figure.axes[1].lines[0].get_color()) == color(2)


@pytest.mark.parametrize(
    ("tasks", "methods", "size"),
    [
        (1, 1, (4.6 * 1.4, 3.55)),
        (1, 2, (4.6 * 1.4, 3.7)),
        (2, 3, (9.2, 3.7)),
        (2, 4, (9.2, 3.85)),
        (5, 1, (9.2, 3 * 3.55)),
    ],
)
def test_panels_of_curves_grow_with_tasks_and_methods(figures, tasks, methods, size):
    items = [summary(f"t{k}", f"m{m}", runs=[run([1, 2], [1, 1])]) for k in range(tasks) for m in range(methods)]
    np.testing.assert_allclose(draw(items)["curves"].get_size_inches(), size)


class Policy(dict):
    """A policy artifact as plots see it."""

    def __init__(self, path, reward, samples, distances):
        super().__init__({"curve/samples": np.array(samples), "curve/normalised_distance": np.array(distances)})
        self.path, self.config = path, {"reward": reward}


def test_policies_have_a_line_each(figures, tmp_path):
    policies = [
        Policy(tmp_path / "a$.policy.h5", "oracle", [1, 2], [0.9, 0.4]),
        Policy(tmp_path / "b.policy.h5", "video", [1, 3], [0.8, 0.3]),
    ]
    figure = plot_learning_curves(policies, 0.55)
    assert figure.dpi == 120 and tuple(figure.get_size_inches()) == (7, 4.5)
    (axes,) = figure.axes
    first, second, threshold = axes.lines
    np.testing.assert_array_equal(first.get_xydata(), [[1, 0.9], [2, 0.4]])
    np.testing.assert_array_equal(second.get_xydata(), [[1, 0.8], [3, 0.3]])
    labels = [r"a\$ (oracle)", "b (video)", "success below 0.55"]
    assert [line.get_label() for line in axes.lines] == labels
    assert [text.get_text() for text in axes.get_legend().get_texts()] == labels
    assert {text.get_fontsize() for text in axes.get_legend().get_texts()} == {7}
    assert (threshold.get_color(), threshold.get_linestyle(), threshold.get_linewidth()) == ("grey", "--", 1)
    assert threshold.get_ydata() == [0.55, 0.55]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("samples", "final distance / initial distance")
    assert axes.get_ylim()[0] == 0


def test_quality_shows_every_episode_and_the_mean(figures):
    rng = np.random.default_rng(0)
    kinds = {"expert": "tab:green", "noisy": "tab:orange", "random": "tab:red"}
    curves = {f"{kind}/{name}": rng.normal(size=(3, 5)) for kind in kinds for name in ("feat", "img", "distance")}
    figure = plot_quality(curves)
    assert figure.dpi == 110 and tuple(figure.get_size_inches()) == (11, 3.4)
    titles = ["R_feat", "R_img", "distance / initial distance"]
    for panel, name, title in zip(figure.axes, ("feat", "img", "distance"), titles, strict=True):
        assert (panel.get_title(), panel.get_xlabel()) == (title, "frame")
        lines = list(panel.lines)
        for kind, shade in kinds.items():
            values = curves[f"{kind}/{name}"]
            for row in values:
                line = lines.pop(0)
                np.testing.assert_array_equal(line.get_ydata(), row)
                assert (line.get_color(), line.get_alpha(), line.get_linewidth()) == (shade, 0.25, 0.8)
            mean = lines.pop(0)
            np.testing.assert_allclose(mean.get_ydata(), values.mean(axis=0))
            assert (mean.get_color(), mean.get_label(), mean.get_alpha()) == (shade, kind, None)
    legend = figure.axes[0].get_legend()
    assert [text.get_text() for text in legend.get_texts()] == list(kinds)
    assert {text.get_fontsize() for text in legend.get_texts()} == {8}
    assert figure.axes[1].get_legend() is None


def test_a_figure_becomes_a_png_without_the_version_of_matplotlib_and_is_closed():
    import matplotlib.pyplot as pyplot

    before = set(pyplot.get_fignums())
    drawn = draw([summary()])["success"]
    assert drawn.startswith(b"\x89PNG") and drawn.endswith(b"IEND\xaeB`\x82")
    assert b"atplotlib" not in drawn, "the same numbers give the same file with any version that renders them alike"
    assert set(pyplot.get_fignums()) == before
    assert draw([summary()])["success"] == drawn
    figure = pyplot.figure()
    laid_out = []
    figure.tight_layout = lambda: laid_out.append(True)
    plots._png(figure)
    assert laid_out == [True]
