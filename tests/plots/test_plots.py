import json
from dataclasses import replace
from functools import cache
from io import BytesIO
from types import SimpleNamespace
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.quiver import Quiver

from guider import plots
from guider.data import AS_FOUND
from guider.data.episodes import Episodes, make_episodes
from guider.evaluation.rollouts import Rollouts, Trace
from guider.learning.networks import twin_values
from guider.learning.problem import Problem
from guider.methods import METHODS, guider, subgoal_policy
from guider.methods.goal_policy import GoalPolicyConfig
from guider.methods.latent_subgoals import LatentSubgoalsConfig
from guider.methods.policy import Policy
from guider.methods.subgoal_policy import SubgoalPolicyConfig
from guider.methods.view import unit_scale
from guider.plots import canvas
from guider.plots.gaps import fixed_period, subgoal_gaps, subgoal_outcomes
from guider.plots.mazes import in_wall, legible_subgoals, maze_positions, spread_positions
from guider.plots.subgoals import data_outcomes, proposals, states_at
from guider.runs import Run, RunSpec
from guider.support.config import override
from guider.tasks import find_task

PERIOD = 5
TASK = replace(find_task("pointmaze-umaze"), period_steps=PERIOD)
assert TASK.maze is not None
MAZE = TASK.maze
TITLE = "a-task, guider, preset fast, seed 3"


def small_config() -> guider.GuiderConfig:
    return guider.GuiderConfig(
        problem=Problem(period_steps=PERIOD),
        replan="reached",
        final_goal_substitution=True,
        latent=LatentSubgoalsConfig(hidden=(8,)),
        high=SubgoalPolicyConfig(hidden=(8,)),
        low=GoalPolicyConfig(hidden=(8,)),
    )


def logs(goal_dim: int) -> Episodes:
    """Six walks of 21 states from the start of the umaze along its first corridor."""
    rng = np.random.default_rng(0)
    steps = rng.uniform(-0.02, 0.12, (6, 21, 4))
    observations = np.clip(np.cumsum(steps, axis=1), -0.4, 2.4).reshape(-1, 4)
    return make_episodes(observations, rng.uniform(-1, 1, (126, 2)), [21] * 6, tuple(range(goal_dim)))


@cache
def make_policy(goal_dim: int) -> Policy:
    """`policy_for` logs(goal_dim)."""
    return policy_for(logs(goal_dim))


def policy_for(episodes: Episodes, method: str = "guider", config: Any = None) -> Policy:
    """A policy of random numbers, so that nothing is compiled, with the goal space of the episodes."""
    config, spaces, rng = config or small_config(), episodes.spaces, np.random.default_rng(0)
    scale = unit_scale(config.view, spaces)
    shapes = jax.eval_shape(lambda: METHODS[method].init(config, spaces, scale, jax.random.key(0)))
    state = jax.tree.map(lambda leaf: jnp.asarray(0.4 * rng.standard_normal(leaf.shape), jnp.float32), shapes)
    bounds = jnp.asarray([-1.0, -1.0]), jnp.asarray([1.0, 1.0])
    return Policy(state._replace(scale=scale), *bounds, method, config, spaces.goal_indices, 4)


def trace(subgoals: list[tuple[float, float]], success: bool = False) -> Trace:
    """A walk of 0.1 m a step along x, from the origin, with a subgoal every PERIOD steps."""
    count = PERIOD * len(subgoals)
    achieved = np.stack([0.1 * np.arange(count), np.zeros(count)], axis=1)
    renewed = np.arange(count) % PERIOD == 0
    pursued = np.repeat(np.array(subgoals, float), PERIOD, axis=0)
    return Trace(achieved, pursued, renewed, np.array([0.0, 2.0]), success, achieved[-1])


TRACES = (trace([(0.5, 0.0), (1.0, 1.2), (2.0, 0.0)]), trace([(0.5, 0.3), (1.1, 0.0)], success=True))


def drawn(figure: Figure) -> Figure:
    figure.savefig(BytesIO(), format="png", dpi=40)
    return figure


def title_of(figure: Figure) -> str:
    return figure.get_suptitle()


def points(line: Line2D) -> np.ndarray:
    """[points, 2] what a line or its markers go through."""
    return np.asarray(line.get_xydata())


def stars(axes: Axes) -> np.ndarray:
    """[stars, 2] where the subgoals of a panel are drawn."""
    [line] = [line for line in axes.lines if line.get_marker() == "*"]
    return points(line)


def test_gaps_are_distances_to_where_the_robot_was_a_period_later():
    # The robot is at (0.5, 0) and (1, 0) after two periods of the first trace, whose third is cut short, and
    # at (0.5, 0) after one of the second.
    gaps = subgoal_gaps(TRACES, PERIOD)
    np.testing.assert_allclose(gaps, [0.0, 1.2, 0.3], atol=1e-12)


def test_outcomes_pair_every_whole_period():
    subgoals, outcomes = subgoal_outcomes(TRACES, PERIOD)
    np.testing.assert_allclose(subgoals, [(0.5, 0), (1, 1.2), (0.5, 0.3)])
    np.testing.assert_allclose(outcomes, [(0.5, 0), (1, 0), (0.5, 0)])


def test_fixed_period_changes_only_when_and_what_is_asked():
    policy = make_policy(2)
    config = fixed_period(policy).config
    assert (config.replan, config.final_goal_substitution) == ("period", False)
    assert replace(config, replan="reached", final_goal_substitution=True) == policy.config


def test_spaced_keeps_the_first_of_every_crowd():
    points = np.array([[0.0], [0.4], [1.1], [0.9], [2.2], [1.0]])
    np.testing.assert_array_equal(canvas.spaced(points, 1.0), [0, 2, 4])
    assert canvas.spaced(np.zeros((0, 2)), 1.0).shape == (0,)


def test_stars_are_thinned_subgoals_at_the_moments_they_were_chosen():
    crowded = trace([(0.5, 0.0), (0.55, 0.0), (1.5, 0.0)])
    np.testing.assert_array_equal(legible_subgoals(crowded, 0.5), [0, 2 * PERIOD])


def test_episodes_show_stars_flags_and_outcomes():
    figure = drawn(plots.episodes_in_maze(TASK, MAZE, logs(2), TRACES, 40, TITLE))
    assert TITLE in title_of(figure) and "episode seeds 40 to 41: 1 of 2 goals reached" in title_of(figure)
    first, second = figure.axes[:2]
    assert first.get_title() == "seed 40: NOT reached in 15 steps"
    assert second.get_title() == "seed 41: reached after 10 steps"
    np.testing.assert_allclose(stars(first), [(0.5, 0), (1, 1.2), (2, 0)])
    assert [text.get_text() for text in first.texts] == ["1", "2", "3"]
    [path] = [c for c in first.collections if isinstance(c, LineCollection)]
    assert len(path.get_segments()) == 14
    flags = [line for line in first.lines if line.get_marker() is canvas.FLAG]
    np.testing.assert_allclose([points(line) for line in flags], [[(0, 2)]])


def test_arrows_leave_every_free_position_and_say_how_many_end_in_walls():
    episodes = logs(2)
    policy = make_policy(2)
    goal = np.array([0.0, 2.0])
    figure = drawn(plots.subgoal_arrows(TASK, MAZE, episodes, policy, goal, TITLE))
    arrows, walled = [c for c in figure.axes[0].collections if isinstance(c, Quiver)]
    starts = maze_positions(MAZE, 3)
    inside = in_wall(MAZE, proposals(policy, states_at(episodes, starts), goal)[0])
    assert (arrows.N, walled.N) == (len(starts), inside.sum())
    assert len(starts) == 9 * 7 and not in_wall(MAZE, starts).any()
    assert TITLE in title_of(figure) and f"{inside.mean():.0%} inside a wall" in title_of(figure)


def test_maze_positions_divide_a_cell_evenly():
    positions = maze_positions(MAZE, 2)
    np.testing.assert_allclose(positions[:4], [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)])


def test_proposals_are_the_policys_own_with_the_smaller_critics_value():
    policy = make_policy(2)
    here = np.array([[0.0, 0.0, 9.0, 9.0], [1.0, 0.5, 9.0, 9.0]], np.float32)
    goal = np.array([2.0, 2.0], np.float32)
    subgoals, worth = proposals(policy, here, goal)
    at = jnp.asarray(here[1:, :2])
    expected, latent = guider.propose_subgoal(policy.config, policy.state, at, jnp.asarray(goal)[None])
    np.testing.assert_allclose(subgoals[1:], expected, rtol=1e-5, atol=1e-6)
    seen = subgoal_policy.inputs(policy.state.scale, at, jnp.asarray(goal)[None])
    both = twin_values(policy.state.high.params.critic, seen, latent)
    np.testing.assert_allclose(worth[1:], both.min(axis=0), rtol=1e-4)


def test_states_at_places_are_the_nearest_logged_ones_moved_there():
    episodes = logs(2)
    (state,) = states_at(episodes, np.array([[50.0, 60.0]]))
    nearest = np.argmin(np.linalg.norm(episodes.achieved - [50, 60], axis=1))
    np.testing.assert_array_equal(state[:2], [50, 60])
    np.testing.assert_array_equal(state[2:], episodes.observations[nearest, 2:])


def test_in_wall():
    np.testing.assert_array_equal(in_wall(MAZE, np.array([[0, 0], [0, 1], [-1, 0]])), [False, True, True])


def test_reachable_shows_prior_and_the_outcomes_of_nearby_windows():
    episodes = logs(2)
    policy = make_policy(2)
    figure = drawn(plots.reachable_in_maze(MAZE, episodes, policy, np.array([[0.0, 0.0]]), TITLE))
    axes = figure.axes[0]
    drawn_at = {line.get_color(): points(line) for line in axes.lines}
    starts, later = data_outcomes(episodes, policy.config)
    near = np.linalg.norm(starts, axis=1) <= 1 / 8
    np.testing.assert_allclose(drawn_at[canvas.BLUE], later[near])
    assert near.any() and len(drawn_at[canvas.ORANGE]) == 150
    assert axes.get_title().startswith("(0, 0): prior ")
    assert TITLE in title_of(figure) and "c = 5 steps" in title_of(figure)


def test_data_outcomes_are_a_period_apart_or_at_the_episodes_end():
    episodes = logs(2)
    starts, later = data_outcomes(episodes, small_config())
    achieved = episodes.achieved
    assert len(starts) == 6 * 20
    np.testing.assert_array_equal((starts[0], later[0]), (achieved[0], achieved[5]))
    np.testing.assert_array_equal((starts[19], later[19]), (achieved[19], achieved[20]))


def test_spread_positions_start_at_the_start_and_go_far():
    corners = np.repeat([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 2.0]], 2, axis=0)
    episodes = make_episodes(corners, np.zeros((8, 1)) + 0.1, [8], (0, 1), action_low=-1, action_high=1)
    np.testing.assert_allclose(spread_positions(MAZE, episodes, 3), [(0, 0), (2, 2), (2, 0)])
    assert len(spread_positions(MAZE, episodes, 9)) == 4


def test_figure_7_gives_its_numbers():
    problem = Problem(reach_radius=0.5, period_steps=PERIOD)
    figure = drawn(plots.subgoals_met(problem, MAZE, logs(2), TRACES, 40, TITLE))
    title = title_of(figure)
    assert TITLE in title and "episode seeds 40 to 41, 3 subgoals" in title
    assert "median distance is 0.30 m" in title and "67% are within 0.5 m" in title
    assert len(stars(figure.axes[0])) == 3


@pytest.mark.parametrize("goal_dim", [1, 2, 3])
def test_logs_without_a_maze_can_be_drawn_whatever_their_goal_space(goal_dim):
    logged, held_out = logs(goal_dim).split(0.4)
    figure = drawn(plots.subgoals_on_logs(logged, held_out, "held-out", make_policy(goal_dim), TITLE))
    assert TITLE in title_of(figure) and "every c = 5 steps along held-out episodes" in title_of(figure)
    assert len([axes for axes in figure.axes if axes.get_title().startswith("held-out episode")]) == 2
    if goal_dim != 2:
        assert stars(figure.axes[0]).shape == (5, 2)
        np.testing.assert_array_equal(stars(figure.axes[0])[:, 0], [5, 10, 15, 20, 25])


def labels_below(figure: Figure) -> list[str]:
    [legend] = figure.legends
    return [text.get_text() for text in legend.get_texts()]


def test_legends_name_what_is_drawn_alone():
    alone = [replace(walk, subgoals=np.broadcast_to(walk.goal, walk.subgoals.shape)) for walk in TRACES]
    figure = drawn(plots.episodes_in_maze(TASK, MAZE, logs(2), alone, 40, TITLE))
    assert labels_below(figure) == ["logged positions", "final goal"]
    assert not any(line.get_marker() == "*" for axes in figure.axes for line in axes.lines)
    problem = Problem(reach_radius=2.0, period_steps=PERIOD)
    figure = drawn(plots.subgoals_met(problem, MAZE, logs(2), TRACES, 40, TITLE))
    assert labels_below(figure)[2:] == ["reached"]


def test_a_goal_space_too_wide_to_show_says_so():
    figure = drawn(plots.subgoals_on_logs(logs(4), logs(4), "training", make_policy(4), TITLE))
    assert "goal entries" not in title_of(figure)
    wide = make_episodes(np.random.default_rng(0).normal(size=(42, 5)), np.zeros((42, 2)), [21, 21], tuple(range(5)))
    figure = drawn(plots.subgoals_on_logs(wide, wide, "training", policy_for(wide), TITLE))
    assert "along training episodes" in title_of(figure) and "; the 4 most varied of 5 goal entries" in title_of(figure)
    assert figure.axes[0].get_title() == "training episode 0"


def test_goal_entries_that_never_change_are_drawn():
    still = logs(2).observations.copy()
    still[:, 1] = 3.0
    episodes = make_episodes(still, np.zeros((126, 2)), [21] * 6, (0, 1))
    figure = drawn(plots.subgoals_on_logs(episodes, episodes, "training", make_policy(2), TITLE))
    assert 1 < len(stars(figure.axes[0])) <= 5


def metrics_line(stage: str, update: int, metrics: dict[str, list[float]]) -> dict[str, Any]:
    return {"stage": stage, "update": update, "total_updates": update, "seconds": 1.0, "metrics": metrics}


METRICS = [
    metrics_line("first", 10, {"kl": [1.0, 3.0], "loss": [1.0, 1.0], "squared_error": [4.0, 1.0]}),
    metrics_line("first", 20, {"kl": [0.0, 1.0], "loss": [1.0, 1.0], "squared_error": [2.0, 1.0]}),
    metrics_line("second", 10, {name: [-1.0, 0.0] for name in ("a", "value", "b", "td_error", "weight")}),
]
EVALUATIONS = [
    {"stage": "second", "update": 10, "total_updates": 30, "score": [20, 40], "unit": "success (%)", "episodes": 5},
    {"stage": "second", "update": 20, "total_updates": 40, "score": [60, 100], "unit": "success (%)", "episodes": 5},
]


@pytest.mark.parametrize("name", ["\udcff.npz", "日本.npz", "$x$_{.npz", "x\ny"])
def test_data_of_any_name_has_a_picture(tmp_path, name):
    canvas.save(canvas.new_figure(name, (2, 2)), tmp_path / "picture.png")


def make_run(directory, episodes: Episodes, task: str | None, policy: Policy) -> Run:
    """Looks like a finished run; its policies need no checkpoint."""
    spec = RunSpec(
        task=task,
        data="logs/robot.npz",
        reading=AS_FOUND,
        fingerprint="",
        held_out=0.4,
        method=policy.method,
        preset="fast",
        seeds=(3, 4),
        config=policy.config,
        spaces=episodes.spaces,
    )
    for name, lines in (("metrics", METRICS), ("evaluations", EVALUATIONS)):
        text = "".join(json.dumps(line) + "\n" for line in lines)
        (directory / f"{name}.jsonl").write_text(text)
    return cast(Run, SimpleNamespace(directory=directory, spec=spec, policies=lambda: [policy, policy]))


def test_caption_names_what_is_drawn(tmp_path):
    episodes = logs(2)
    spec = make_run(tmp_path, episodes, None, make_policy(2)).spec
    assert plots.caption(spec, (3,)) == "robot.npz, guider, preset fast, seed 3"
    assert plots.caption(replace(spec, task="t"), (3, 4)) == "t, guider, preset fast, seeds 3, 4"


def test_a_run_in_a_maze_is_drawn_whole(tmp_path, monkeypatch):
    asked = []

    def fake_rollout(policy, task, episodes, first_seed):
        asked.append((policy.config.replan, episodes, first_seed))
        return Rollouts(np.zeros(2), np.zeros(2, bool), np.zeros(2, int), TRACES)

    monkeypatch.setattr(plots, "rollout", fake_rollout)
    episodes = logs(2)
    run = make_run(tmp_path, episodes, TASK.name, make_policy(2))
    paths = plots.draw_run(run, TASK, episodes, 4, 1000, episodes_shown=2)
    names = ["learning", "scores", *(f"{n}-seed4" for n in ("episodes", "arrows", "reachable", "met"))]
    assert paths == [tmp_path / "plots" / f"{name}.png" for name in names]
    assert sorted(paths) == sorted((tmp_path / "plots").iterdir())
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)
    assert asked == [("reached", 2, 1000), ("period", 20, 1000)]


@pytest.mark.parametrize("task", [TASK, None])
def test_a_method_that_names_places_is_drawn_without_what_it_does_not_learn(tmp_path, monkeypatch, task):
    """HIQL on places has no prior, and a new subgoal at every step."""
    monkeypatch.setattr(
        plots, "rollout", lambda *rest: Rollouts(np.zeros(2), np.zeros(2, bool), np.zeros(2, int), TRACES)
    )
    config = METHODS["hiql-places"].config("paper", Problem(period_steps=PERIOD))
    config = override(config, {f"{part}.hidden": (8,) for part in ("value", "high", "low")})
    policy = policy_for(logs(2), "hiql-places", config)
    run = make_run(tmp_path, logs(2), task and task.name, policy)
    paths = plots.draw_run(run, task, logs(2), 3, 1000, episodes_shown=2)
    seen = ["episodes", "arrows"] if task else ["subgoals"]
    assert [path.stem for path in paths] == ["learning", "scores", *(f"{name}-seed3" for name in seen)]


def test_a_run_on_logs_is_drawn_without_a_task(tmp_path):
    episodes = logs(2)
    run = make_run(tmp_path, episodes, None, make_policy(2))
    paths = plots.draw_run(run, None, episodes, 3, 1000)
    assert [path.name for path in paths] == ["learning.png", "scores.png", "subgoals-seed3.png"]


@pytest.mark.parametrize("held_out, kind, count", [(0.4, "held-out", 2), (0.0, "training", 6)])
def test_episodes_are_called_held_out_where_they_were(tmp_path, monkeypatch, held_out, kind, count):
    asked = []
    monkeypatch.setattr(plots, "subgoals_on_logs", lambda *arguments: asked.append(arguments) or Figure())
    run = make_run(tmp_path, logs(2), None, make_policy(2))
    run.spec = replace(run.spec, held_out=held_out)  # pyright: ignore[reportAttributeAccessIssue]
    plots.draw_run(run, None, logs(2), 3, 1000)
    [(_, shown, said, *_)] = asked
    assert (said, len(shown.starts)) == (kind, count)
