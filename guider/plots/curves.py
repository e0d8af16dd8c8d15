"""How a run learned: its metrics and its success rate against its updates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from guider.plots import canvas

METRIC_LABELS = {
    "squared_error": "squared error per entry",
    "kl": "KL of posterior and prior (nats)",
    "value": "critic value",
    "td_error": "TD error",
    "divergence": "divergence",
    "conservative_gap": "conservative gap",
    "action_error": "squared error of actions in [-1, 1]",
    "weight": "advantage weight",
}
"""Metrics in the order of their importance; a stage shows its first four, others after these. A method may say more of
what its own are (`Method.metric_labels`)."""
LOGARITHMIC = ("squared_error", "td_error")
METRICS_SHOWN = 4


def learning_curves(lines: Sequence[dict[str, Any]], title: str, labels: dict[str, str] = METRIC_LABELS) -> Figure:
    """A row of panels per stage: its main metrics against its updates, thin per seed and bold in the mean.

    lines: of metrics.jsonl, at least one; labels: METRIC_LABELS, where other ones are.
    """
    labels = METRIC_LABELS | labels
    stages = list(dict.fromkeys(line["stage"] for line in lines))
    figure = canvas.new_figure(title, (3.2 * METRICS_SHOWN, 2.3 * len(stages) + 0.4))
    panels = figure.subplots(len(stages), METRICS_SHOWN, squeeze=False)
    for stage, row in zip(stages, panels, strict=True):
        chosen = [line for line in lines if line["stage"] == stage]
        names = _main_metrics(chosen[0]["metrics"])
        updates = [line["update"] for line in chosen]
        for axes, name in zip(row, names, strict=False):
            values = np.array([line["metrics"][name] for line in chosen])
            _seed_lines(axes, updates, values, "-" if len(updates) > 1 else "o")
            axes.set_title(labels.get(name, name.replace("_", " ")), fontsize=9)
            if name in LOGARITHMIC and (values > 0).all():
                axes.set_yscale("log")
        for axes in row[len(names) :]:
            axes.remove()
        row[0].set_ylabel(stage, fontweight="bold")
    figure.align_ylabels(panels[:, 0])
    figure.supxlabel("updates of the stage", fontsize=9)
    return figure


def score_curve(lines: Sequence[dict[str, Any]], title: str) -> Figure:
    """Scores during training; of several seeds, mean and standard deviation (Figures 5 and 6).

    lines: of evaluations.jsonl, at least one.
    """
    updates = [line["total_updates"] for line in lines]
    scores = np.array([line["score"] for line in lines])
    mean, deviation = scores.mean(axis=1), scores.std(axis=1)
    seeds, episodes = scores.shape[1], lines[-1]["episodes"]
    whose = (
        f"mean and standard deviation of {seeds} seeds, {episodes} episodes each"
        if seeds > 1
        else f"{episodes} episodes"
    )
    figure = canvas.new_figure(f"{title}\n{whose}", (6, 4))
    axes = figure.subplots()
    axes.fill_between(updates, mean - deviation, mean + deviation, color=canvas.BLUE, alpha=0.2, linewidth=0)
    _seed_lines(axes, updates, scores, "o-")
    axes.set(xlabel="updates of all stages", ylabel=lines[-1]["unit"], ylim=(0, None))
    return figure


def _main_metrics(metrics: dict[str, Any]) -> list[str]:
    order = list(METRIC_LABELS)
    ranked = sorted(metrics, key=lambda name: order.index(name) if name in order else len(order))
    return ranked[:METRICS_SHOWN]


def _seed_lines(axes: Axes, updates: Sequence[int], values: np.ndarray, style: str) -> None:
    """values: [points, seeds]."""
    if values.shape[1] > 1:
        axes.plot(updates, values, style, color=canvas.BLUE, linewidth=0.7, markersize=2, alpha=0.4)
    axes.plot(updates, values.mean(axis=1), style, color=canvas.BLUE, linewidth=1.8, markersize=4)
    axes.grid(color=canvas.GRID, linewidth=0.6)
    axes.tick_params(labelsize=8, which="both")
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
