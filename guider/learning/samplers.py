"""Batches from logged data: a key goes in, a batch comes out, all of it compiled and on the device.

No sampled pair, subgoal or relabelled goal ever lies in another episode than its state, except the
goals drawn on purpose from anywhere (`random_goal_fraction`).
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from guider.learning.windows import Data

Future = Literal["uniform", "geometric", "last"]
"""Which state ahead becomes a goal: any with equal chance, nearer ones rather, or the episode's last."""
Ahead = Literal["uniform", "last"]
"""And which of the next steps' states a subgoal."""


class Windows(NamedTuple):
    """c-step pairs (Eq. 2): s^G_t and s^G_{t+c}, [B, G] each."""

    achieved: jax.Array
    later: jax.Array


class HighBatch(NamedTuple):
    """High-level transitions (Algorithm 1, lines 7-10, before z is drawn), [B, G] each."""

    achieved: jax.Array
    later: jax.Array
    goal: jax.Array


class LowBatch(NamedTuple):
    """Low-level transitions (Algorithm 1, lines 14-16).

    observation, next_observation: [B, S]; action: [B, A] in [-1, 1]; achieved, next_achieved: [B, G];
    subgoal, goal: [B, G], g_sub and g_final; subgoal_steps: [B] steps from the row to the one g_sub was taken from;
    chosen_at: [B, G], s^G where g_sub was chosen.
    """

    observation: jax.Array
    action: jax.Array
    next_observation: jax.Array
    achieved: jax.Array
    next_achieved: jax.Array
    subgoal: jax.Array
    subgoal_steps: jax.Array
    chosen_at: jax.Array
    goal: jax.Array


class FlatBatch(NamedTuple):
    """Transitions with one goal, for methods without subgoals.

    observation, next_observation: [B, S]; action: [B, A] in [-1, 1]; achieved, next_achieved, goal: [B, G];
    steps: [B] int, steps from the row to the one the goal was taken from, -1 where that is not ahead in its episode.
    """

    observation: jax.Array
    action: jax.Array
    next_observation: jax.Array
    achieved: jax.Array
    next_achieved: jax.Array
    goal: jax.Array
    steps: jax.Array


class ValueBatch(NamedTuple):
    """Stretches of n steps with a goal, to learn V(s, g) from (HIQL).

    observation, end_observation: [B, S], the stretch's first state and the one after its last step;
    achieved: [B, n, G], s^G at each step, and end: [B, G] after the last; valid: [B, n] bool, False from the episode's
    end on, where its last state stands; goal: [B, G].
    """

    observation: jax.Array
    end_observation: jax.Array
    achieved: jax.Array
    end: jax.Array
    valid: jax.Array
    goal: jax.Array


class CriticBatch(NamedTuple):
    """Transitions with two goals, of a critic and of the policy that it guides.

    observation, next_observation: [B, S]; action: [B, A] in [-1, 1]; achieved, next_achieved, goal, actor_goal: [B, G].
    """

    observation: jax.Array
    action: jax.Array
    next_observation: jax.Array
    achieved: jax.Array
    next_achieved: jax.Array
    goal: jax.Array
    actor_goal: jax.Array


class WaypointBatch(NamedTuple):
    """Transitions on the way to a goal, and where that way leads in a number of steps (HIQL).

    observation, next_observation, ahead_observation: [B, S]; action: [B, A] in [-1, 1];
    achieved, next_achieved, ahead, goal: [B, G], s^G of the three states and the goal.
    """

    observation: jax.Array
    action: jax.Array
    next_observation: jax.Array
    ahead_observation: jax.Array
    achieved: jax.Array
    next_achieved: jax.Array
    ahead: jax.Array
    goal: jax.Array


class Trajectories(NamedTuple):
    """Windows of c states and the actions taken in them (OPAL).

    observations: [B, c, S]; actions: [B, c, A] in [-1, 1]; valid: [B, c] bool, False from the episode's end on, where
    its last state stands.
    """

    observations: jax.Array
    actions: jax.Array
    valid: jax.Array


class SkillBatch(NamedTuple):
    """High-level transitions of OPAL: what was done for c steps, where it led, and a goal.

    later_observation: [B, S]; achieved, later, goal: [B, G], s^G at the window's start and end, and the goal.
    """

    trajectories: Trajectories
    later_observation: jax.Array
    achieved: jax.Array
    later: jax.Array
    goal: jax.Array


def _choose(key: jax.Array, rows: jax.Array, count: int) -> jax.Array:
    return rows[jax.random.randint(key, (count,), 0, len(rows))]


def _steps(data: Data, rows: jax.Array) -> dict[str, jax.Array]:
    """Of each row: state, action, next state, and s^G of both."""
    return {
        "observation": data.observations[rows],
        "action": data.actions[rows],
        "next_observation": data.observations[rows + 1],
        "achieved": data.achieved[rows],
        "next_achieved": data.achieved[rows + 1],
    }


def _goals(
    data: Data,
    key: jax.Array,
    first: jax.Array,
    last: jax.Array,
    relabel_fraction: float,
    random_fraction: float,
    future: Future = "uniform",
    mean_steps: float = 1.0,
) -> tuple[jax.Array, jax.Array]:
    """g_final for each row: a state of [first, last] of its own episode with probability `relabel_fraction`,
    a state from anywhere with `random_fraction`, else the recorded goal. Without recorded goals, the
    remainder is relabelled too. first, last: [B] rows; mean_steps: of geometric futures, from `first` on.
    Returns (goals [B, G], the rows they were taken from [B], -1 where that is not a row ahead)."""
    row_key, anywhere_key, kind_key = jax.random.split(key, 3)
    first = jnp.minimum(first, last)
    if future == "last":
        rows = last
    elif future == "geometric":
        rows = jnp.minimum(first - 1 + jax.random.geometric(row_key, 1 / mean_steps, first.shape), last)
    else:
        rows = jax.random.randint(row_key, first.shape, first, last + 1)
    anywhere = data.achieved[jax.random.randint(anywhere_key, first.shape, 0, len(data.achieved))]
    kind = jax.random.uniform(kind_key, first.shape)
    from_anywhere = (kind >= relabel_fraction) & (kind < relabel_fraction + random_fraction)
    recorded = kind >= relabel_fraction + random_fraction
    goal = jnp.where(from_anywhere[:, None], anywhere, data.achieved[rows])
    if data.goals is None:
        return goal, jnp.where(from_anywhere, -1, rows)
    return jnp.where(recorded[:, None], data.goals[first], goal), jnp.where(from_anywhere | recorded, -1, rows)


def sample_windows(data: Data, key: jax.Array, batch_size: int, period_steps: int) -> Windows:
    """Uniform c-step windows (Algorithm 1, line 2)."""
    rows = _choose(key, data.window_rows, batch_size)
    later = jnp.minimum(rows + period_steps, data.last_row[rows])
    return Windows(data.achieved[rows], data.achieved[later])


def _windows_with_goals(
    data: Data,
    key: jax.Array,
    batch_size: int,
    period_steps: int,
    goal_offset: int,
    relabel_fraction: float,
    random_goal_fraction: float,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Rows where uniform c-step windows start and end, [B] each, and goals from their ends on, [B, G]."""
    row_key, goal_key = jax.random.split(key)
    rows = _choose(row_key, data.window_rows, batch_size)
    last = data.last_row[rows]
    later = jnp.minimum(rows + period_steps, last)
    goal, _ = _goals(data, goal_key, later + goal_offset, last, relabel_fraction, random_goal_fraction)
    return rows, later, goal


def sample_high(
    data: Data,
    key: jax.Array,
    batch_size: int,
    period_steps: int,
    goal_offset: int,
    relabel_fraction: float,
    random_goal_fraction: float,
) -> HighBatch:
    """High-level transitions with hindsight goals (Algorithm 1, lines 7-10).

    A relabelled goal is s^G_i with i uniform in [t + c + goal_offset, T]; offset 1 is the paper's strict
    range, 0 the authors' code. Where that range is empty, i = T.
    """
    rows, later, goal = _windows_with_goals(
        data, key, batch_size, period_steps, goal_offset, relabel_fraction, random_goal_fraction
    )
    return HighBatch(data.achieved[rows], data.achieved[later], goal)


def sample_low(
    data: Data,
    key: jax.Array,
    batch_size: int,
    subgoal_steps: int,
    kept_steps: int,
    ahead: Ahead,
    future: Future,
    relabel_fraction: float,
    random_goal_fraction: float,
) -> LowBatch:
    """Low-level transitions with hindsight subgoals (Algorithm 1, lines 14-16).

    g_sub = s^G_j with j in [t + 1, min(k + subgoal_steps, T)], uniform or the last as `ahead` says; g_final = s^G_i
    with i in [j, T] as `future` says, j included: every final approach looks like that. k <= t is where g_sub was
    chosen: t itself where kept_steps is 1, else uniform over the kept_steps states, of the same episode, that end
    with t.
    """
    row_key, subgoal_key, goal_key = jax.random.split(key, 3)
    rows = _choose(row_key, data.transition_rows, batch_size)
    last = data.last_row[rows]
    chosen_at = rows
    if kept_steps > 1:
        first = jnp.searchsorted(data.last_row, last)  # of the episode: the first row whose last row is this
        earliest = jnp.maximum(first, rows - kept_steps + 1)
        chosen_at = jax.random.randint(jax.random.fold_in(key, 3), rows.shape, earliest, rows + 1)
    furthest = jnp.minimum(chosen_at + subgoal_steps, last)
    subgoal_rows = furthest if ahead == "last" else jax.random.randint(subgoal_key, rows.shape, rows + 1, furthest + 1)
    goal, _ = _goals(data, goal_key, subgoal_rows, last, relabel_fraction, random_goal_fraction, future)
    return LowBatch(
        **_steps(data, rows),
        subgoal=data.achieved[subgoal_rows],
        subgoal_steps=subgoal_rows - rows,
        chosen_at=data.achieved[chosen_at],
        goal=goal,
    )


def sample_flat(
    data: Data,
    key: jax.Array,
    batch_size: int,
    future: Future,
    mean_goal_steps: float,
    relabel_fraction: float,
    random_goal_fraction: float,
) -> FlatBatch:
    """Transitions with hindsight goals s^G_i, t < i <= T, i as `future` says (geometric: `mean_goal_steps` ahead)."""
    row_key, goal_key = jax.random.split(key)
    rows = _choose(row_key, data.transition_rows, batch_size)
    goal, goal_rows = _goals(
        data,
        goal_key,
        rows + 1,
        data.last_row[rows],
        relabel_fraction,
        random_goal_fraction,
        future,
        mean_goal_steps,
    )
    return FlatBatch(
        **_steps(data, rows),
        goal=goal,
        steps=jnp.where(goal_rows < 0, -1, goal_rows - rows),
    )


def sample_value(
    data: Data,
    key: jax.Array,
    batch_size: int,
    stretch_steps: int,
    mean_goal_steps: float,
    current_goal_fraction: float,
    random_goal_fraction: float,
) -> ValueBatch:
    """Stretches of `stretch_steps` (HIQL: 1), with goals as in `_value_goals`."""
    row_key, goal_key, kind_key = jax.random.split(key, 3)
    starts = _choose(row_key, data.transition_rows, batch_size)
    last = data.last_row[starts]
    goal = _value_goals(
        data, (goal_key, kind_key), starts, mean_goal_steps, current_goal_fraction, random_goal_fraction
    )
    rows = starts[:, None] + jnp.arange(stretch_steps)
    ends = jnp.minimum(starts + stretch_steps, last)
    return ValueBatch(
        observation=data.observations[starts],
        end_observation=data.observations[ends],
        achieved=data.achieved[jnp.minimum(rows, last[:, None])],
        end=data.achieved[ends],
        valid=rows < last[:, None],
        goal=goal,
    )


def _value_goals(
    data: Data,
    keys: tuple[jax.Array, jax.Array],
    rows: jax.Array,
    mean_goal_steps: float,
    current_goal_fraction: float,
    random_goal_fraction: float,
) -> jax.Array:
    """Goals that are s^G_t itself, a state of any trajectory, or, for the rest, one of the episode's future,
    `mean_goal_steps` ahead on average (geometric). [B] rows -> [B, G]."""
    goal_key, kind_key = keys
    others = 1 - current_goal_fraction
    random_share = random_goal_fraction / others if others > 0 else 0.0
    last = data.last_row[rows]
    goal, _ = _goals(data, goal_key, rows + 1, last, 1 - random_share, random_share, "geometric", mean_goal_steps)
    current = jax.random.uniform(kind_key, rows.shape) < current_goal_fraction
    return jnp.where(current[:, None], data.achieved[rows], goal)


def sample_critic(
    data: Data,
    key: jax.Array,
    batch_size: int,
    mean_goal_steps: float,
    current_goal_fraction: float,
    random_goal_fraction: float,
    actor_random_goal_fraction: float,
) -> CriticBatch:
    """Transitions with the critic's goals as in `_value_goals`, and the policy's, uniform futures s^G_i, t < i <= T, or
    states of any trajectory."""
    row_key, goal_key, kind_key, actor_key = jax.random.split(key, 4)
    rows = _choose(row_key, data.transition_rows, batch_size)
    goal = _value_goals(data, (goal_key, kind_key), rows, mean_goal_steps, current_goal_fraction, random_goal_fraction)
    anywhere = actor_random_goal_fraction
    actor_goal, _ = _goals(data, actor_key, rows + 1, data.last_row[rows], 1 - anywhere, anywhere)
    return CriticBatch(**_steps(data, rows), goal=goal, actor_goal=actor_goal)


def sample_waypoints(
    data: Data, key: jax.Array, batch_size: int, ahead_steps: int, random_goal_fraction: float
) -> WaypointBatch:
    """Transitions with hindsight goals s^G_i, i uniform in (t, T], or goals from anywhere, and the state at
    min(t + ahead_steps, i), or min(t + ahead_steps, T) where the goal is from anywhere (HIQL)."""
    row_key, goal_key = jax.random.split(key)
    rows = _choose(row_key, data.transition_rows, batch_size)
    last = data.last_row[rows]
    goal, goal_rows = _goals(data, goal_key, rows + 1, last, 1 - random_goal_fraction, random_goal_fraction)
    ahead_rows = jnp.minimum(rows + ahead_steps, jnp.where(goal_rows < 0, last, goal_rows))
    return WaypointBatch(
        **_steps(data, rows),
        ahead_observation=data.observations[ahead_rows],
        ahead=data.achieved[ahead_rows],
        goal=goal,
    )


def _trajectories(data: Data, starts: jax.Array, steps: int) -> Trajectories:
    rows, last = starts[:, None] + jnp.arange(steps), data.last_row[starts][:, None]
    inside = jnp.minimum(rows, last)
    return Trajectories(data.observations[inside], data.actions[inside], rows < last)


def sample_trajectories(data: Data, key: jax.Array, batch_size: int, period_steps: int) -> Trajectories:
    """Uniform windows of c steps."""
    return _trajectories(data, _choose(key, data.window_rows, batch_size), period_steps)


def sample_skills(
    data: Data,
    key: jax.Array,
    batch_size: int,
    period_steps: int,
    goal_offset: int,
    relabel_fraction: float,
    random_goal_fraction: float,
) -> SkillBatch:
    """High-level transitions with hindsight goals as in `sample_high`, and the c steps that were taken."""
    rows, later, goal = _windows_with_goals(
        data, key, batch_size, period_steps, goal_offset, relabel_fraction, random_goal_fraction
    )
    return SkillBatch(
        trajectories=_trajectories(data, rows, period_steps),
        later_observation=data.observations[later],
        achieved=data.achieved[rows],
        later=data.achieved[later],
        goal=goal,
    )
