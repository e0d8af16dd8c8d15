"""Learning curves and scores over updates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from test_plots import EVALUATIONS, METRICS, TITLE, drawn, points, small_config, title_of

from guider import plots
from guider.methods import guider


def test_learning_curves_show_seeds_and_mean_of_the_main_metrics():
    figure = drawn(plots.learning_curves(METRICS, TITLE))
    names = [axes.get_title() for axes in figure.axes]
    assert names[:3] == ["squared error per entry", "KL of posterior and prior (nats)", "loss"]
    assert names[3:] == ["critic value", "TD error", "advantage weight", "a"]
    lines = [points(line)[:, 1] for line in figure.axes[1].lines]
    np.testing.assert_allclose(lines, [[1, 0], [3, 1], [2, 0.5]])
    assert figure.axes[0].get_yscale() == "log" and figure.axes[4].get_yscale() == "linear"
    assert title_of(figure) == TITLE


def test_curves_have_the_units_of_their_settings():
    config = small_config()
    labels = guider.metric_labels(config)
    assert labels["squared_error"] == "squared error per entry (goal units²)"
    assert labels["divergence"] == "KL of policy and prior (nats per entry)"
    spreads = replace(config, latent=replace(config.latent, error_in_spreads=True))
    assert "goal units" in guider.metric_labels(spreads)["squared_error"]  # spreads are 1 where inputs are raw
    spreads = replace(spreads, view=replace(spreads.view, normalise=True), high=replace(config.high, prior=False))
    labels = guider.metric_labels(spreads)
    assert labels["squared_error"] == "squared error per entry (c-step spreads²)"
    assert labels["divergence"] == "log density of policy"
    names = [axes.get_title() for axes in plots.learning_curves(METRICS, TITLE, labels).axes]
    assert names[0] == labels["squared_error"]


def test_a_single_point_is_seen():
    for line in plots.learning_curves(METRICS[:1], TITLE).axes[0].lines:
        assert line.get_marker() == "o" and len(points(line)) == 1


def test_one_seed_has_no_deviation():
    lines = [line | {"score": line["score"][:1]} for line in EVALUATIONS]
    assert title_of(plots.score_curve(lines, TITLE)) == f"{TITLE}\n5 episodes"


def test_score_curve_is_the_mean_in_percent():
    figure = drawn(plots.score_curve(EVALUATIONS, TITLE))
    mean = figure.axes[0].lines[-1]
    np.testing.assert_allclose(points(mean), [(30, 30), (40, 80)])
    assert "2 seeds, 5 episodes each" in title_of(figure)
