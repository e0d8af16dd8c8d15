# pyright: reportAttributeAccessIssue=false
# (mujoco is a compiled module without type stubs)
"""Gymnasium's goal environments as tasks: Gymnasium-Robotics' AntMaze, and any other by its id.

The AntMaze tasks are for Minari's `D4RL/antmaze` sets. Their ant is Gymnasium's, with motors of gear 150: another
robot than D4RL's, so neither data nor scores belong to the tasks of guider.tasks.antmaze.
"""

from __future__ import annotations

from contextlib import redirect_stderr
from dataclasses import replace
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

import gymnasium
import numpy as np
from gymnasium import spaces

from guider.errors import GuiderError
from guider.support.physics import mujoco
from guider.tasks.goal_measure import Met, environments_rule, first_disagreement, radius_of
from guider.tasks.gym_env import GymVectorEnv, Reading, read_goal_observation
from guider.tasks.mazes import Maze, floor_places, make_maze
from guider.tasks.replay import check_replay
from guider.tasks.types import Task

ANTMAZE_CELL_SIZE_M = 4.0
ANTMAZE_RADIUS_M = 0.45
ANTMAZE_FRAME_SKIP = 5
COPIES = 20
GOALS_SAMPLED = 3


def read_with_achieved_goal(observation: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """For observations without the achieved goal: it is put in front, as guider.data.readers.minari does."""
    state = np.concatenate([observation["achieved_goal"], observation["observation"]])
    return state, observation["desired_goal"]


def make_gymnasium(env_id: str, **options: Any) -> gymnasium.Env:
    """The environment `env_id`, or `module:env_id`. Raises GuiderError if it cannot be made."""
    with redirect_stderr(StringIO()):  # where the package prints notices about other environments
        import gymnasium_robotics
    gymnasium.register_envs(gymnasium_robotics)
    try:
        return gymnasium.make(env_id, disable_env_checker=True, **options)
    except (gymnasium.error.Error, ImportError) as error:
        reason = " ".join(str(error).split())
        raise GuiderError(f"{env_id} cannot be made; is the package that brings it installed? ({reason})") from error


def make_antmaze(env_id: str, maze: Maze) -> gymnasium.Env:
    """Gymnasium-Robotics' AntMaze in `maze`. Its observation has no contact forces, as in Minari's data.

    An episode starts within 1 m, along each axis, of the start cell's centre and aims within 1 m of the goal cell's.
    It goes on when the goal is met, and the goal stays.
    """
    named = {maze.start_cell: "r", maze.goal_cell: "g"}
    maze_map = [
        [named.get((row, column), int(cell)) for column, cell in enumerate(cells)]
        for row, cells in enumerate(maze.layout)
    ]
    env = make_gymnasium(env_id, maze_map=maze_map, include_cfrc_ext_in_observation=False)
    antmaze: Any = env.unwrapped
    Path(antmaze.tmp_xml_file_path).unlink()  # it leaves one behind for each copy
    return env


def goal_task(identifier: str) -> Task:
    """The task `gym:identifier`: any Gymnasium goal environment.

    identifier: `ENV_ID` or `module:ENV_ID`; then, where the environment has no `distance_threshold` or no step limit,
        `?radius=0.5` (goal units), `?horizon=100` (steps) or both, joined by `&`

    The state is `observation`, with the achieved goal in front where it is not among its entries. An episode keeps
    the goal of its reset. c is a twentieth of the horizon, at least 5; a subgoal counts as reached within twice the
    radius. Raises GuiderError for an environment that cannot be made, has no goals, leaves a fact open, or by its
    own sparse `compute_reward` counts goals as met otherwise than within the radius.
    """
    name = f"gym:{identifier}"
    env_id, _, query = identifier.partition("?")
    env = make_gymnasium(env_id)
    try:
        _check_spaces(name, env)
        observations = _look_around(env)
        goal_indices, read = _find_goal(observations)
        facts: dict[str, Any] = {
            "radius": getattr(env.unwrapped, "distance_threshold", None),
            "horizon": env.spec.max_episode_steps if env.spec else None,
        }
        facts |= _given_facts(name, query)
        goals = np.unique([o["desired_goal"] for o in observations], axis=0)[:GOALS_SAMPLED].astype(float)
        met = environments_rule(env, goals)
        for fact in (fact for fact, value in facts.items() if value is None):
            known = radius_of(met, _space_of(env), goals) if fact == "radius" and met else None
            number = "NUMBER" if known is None else f"{known:g}"
            raise GuiderError(f"{name} does not say its {fact}; add it: {name}{'&' if query else '?'}{fact}={number}")
        radius, horizon_steps = float(facts["radius"]), int(facts["horizon"])
        if met is not None:
            _check_goal_measure(name, env, met, goals, radius)
    finally:
        env.close()
    state, _ = read(observations[0])
    unchecked = "" if met else "; its compute_reward cannot say whether the radius is its own"
    return Task(
        name=name,
        summary=f"the goal environment {env_id}{unchecked}",
        domain="gym",
        goal_indices=goal_indices,
        state_dim=len(state),
        action_dim=_width(env.action_space),
        radius=radius,
        reach_radius=2 * radius,
        horizon_steps=horizon_steps,
        period_steps=max(5, round(horizon_steps / 20)),
        environment=f"{env_id} in Gymnasium {gymnasium.__version__}",
        source="Gymnasium",
        make_env=partial(GymVectorEnv, partial(make_gymnasium, env_id), read=read),
        copies=COPIES,
        score="return",
    )


def _given_facts(name: str, query: str) -> dict[str, float]:
    """`radius=0.5&horizon=100` -> the facts given. Raises GuiderError unless they are known and positive numbers."""
    given = {}
    for fact, text in parse_qsl(query, keep_blank_values=True):
        try:
            given[fact] = {"radius": float, "horizon": int}[fact](text)
        except (KeyError, ValueError):
            raise GuiderError(f"{name}: {fact}={text} is neither radius=NUMBER nor horizon=STEPS") from None
        if not 0 < given[fact] < np.inf:
            raise GuiderError(f"{name}: {fact} must be above 0 and finite")
    return given


def _check_spaces(name: str, env: gymnasium.Env) -> None:
    observed = env.observation_space.spaces if isinstance(env.observation_space, spaces.Dict) else {}
    parts = [observed.get(key) for key in ("observation", "achieved_goal", "desired_goal")]
    if not all(map(_width, parts)) or _width(parts[1]) != _width(parts[2]):
        raise GuiderError(
            f"{name} is no goal environment: its observation must be a dict of vectors `observation`, "
            "`achieved_goal` and, of the same length, `desired_goal`"
        )
    action_space: Any = env.action_space
    if not _width(action_space) or not action_space.is_bounded():
        raise GuiderError(f"{name}: actions must be vectors within bounds, not {action_space}")


def _width(space: spaces.Space | None) -> int:
    """Entries of a vector space; 0 for any other space."""
    return space.shape[0] if isinstance(space, spaces.Box) and len(space.shape) == 1 else 0


def _check_goal_measure(name: str, env: gymnasium.Env, met: Met, goals: np.ndarray, radius: float) -> None:
    """Raise GuiderError where the environment's rule differs from the radius in a sample."""
    space = _space_of(env)
    away = first_disagreement(met, space, goals, radius)
    if away is None:
        return
    own = radius_of(met, space, goals)
    shown = ", ".join(f"{entry:.4g}" for entry in away)
    judged = "missed, by its own compute_reward met" if np.linalg.norm(away) > radius else "met, by its own missed"
    advice = (
        "such goals are not met by one distance of all entries: wrap it in an environment whose goals are, or train on "
        "its data as your own, without a task (--goal-indices, --radius)"
        if own is None
        else f"its own radius is {own:g}: say so by ?radius={own:g}"
    )
    raise GuiderError(
        f"{name} counts goals as met otherwise than within {radius:g}: at desired_goal + [{shown}], which is "
        f"{np.linalg.norm(away):.4g} off, a goal would be {judged}; {advice}"
    )


def _space_of(env: gymnasium.Env) -> Any:
    """The Box of achieved goals of an environment that passed `_check_spaces`."""
    observed: Any = env.observation_space
    return observed["achieved_goal"]


def _look_around(env: gymnasium.Env) -> list[dict[str, np.ndarray]]:
    """What is seen in a few resets and random steps."""
    observations = []
    env.action_space.seed(0)
    for seed in range(5):
        observations.append(env.reset(seed=seed)[0])
        observations.extend(env.step(env.action_space.sample())[0] for _ in range(5))
    return observations


def _find_goal(observations: list[dict[str, np.ndarray]]) -> tuple[tuple[int, ...], Reading]:
    """The state entries of the goal space, and how to read states that have them."""
    states, achieved = (np.stack([o[key] for o in observations]) for key in ("observation", "achieved_goal"))
    close: Any = np.isclose(achieved[:, :, None], states[:, None], atol=1e-5)
    equal = close.all(axis=0)  # [goal entries, state entries]
    entries = tuple(equal.argmax(axis=1).tolist())
    if equal.any(axis=1).all() and len(set(entries)) == len(entries):
        return entries, read_goal_observation
    return tuple(range(len(entries))), read_with_achieved_goal


def _antmaze_model(env_id: str, maze: Maze) -> mujoco.MjModel:
    antmaze: Any = make_antmaze(env_id, maze).unwrapped
    return antmaze.model


def _antmaze(data: str, size: str, maze: Maze) -> Task:
    """data: the name of the Minari set, without `D4RL/antmaze/` and version; size: as in the environment's id."""
    env_id = f"AntMaze_{size}-v5"
    environment = f"Gymnasium-Robotics {env_id} (gear 150) in MuJoCo {mujoco.__version__}, 4 m cells"
    return Task(
        name=f"gym-antmaze-{data}",
        summary=f"Gymnasium's ant walks through the maze {maze.name}; data: minari:D4RL/antmaze/{data}-v1",
        domain="antmaze",
        goal_indices=(0, 1),
        state_dim=29,
        action_dim=8,
        radius=ANTMAZE_RADIUS_M,
        reach_radius=1.0,
        horizon_steps=700 if size == "UMaze" else 1000,
        period_steps=50,
        environment=environment,
        source="Gymnasium-Robotics",
        make_env=partial(GymVectorEnv, partial(make_antmaze, env_id, maze), read=read_with_achieved_goal),
        copies=COPIES,
        places=floor_places,
        check_data=partial(check_replay, partial(_antmaze_model, env_id, maze), ANTMAZE_FRAME_SKIP, environment),
    )


_UMAZE, _MEDIUM, _LARGE = (make_maze(name, ANTMAZE_CELL_SIZE_M) for name in ("umaze", "medium", "large"))

# Routes are those of the environments Minari's sets name for evaluation, but in umaze: that one mirrors the maze its
# data was recorded in. Here the ant walks where it was recorded: `umaze` went from cell (3, 1) to (1, 1).
GYM_ANTMAZES = (
    _antmaze("umaze", "UMaze", replace(_UMAZE, start_cell=(3, 1), goal_cell=(1, 1))),
    _antmaze("umaze-diverse", "UMaze", _UMAZE),
    _antmaze("medium-play", "Medium", _MEDIUM),
    _antmaze("medium-diverse", "Medium", _MEDIUM),
    _antmaze("large-play", "Large", _LARGE),
    _antmaze("large-diverse", "Large", _LARGE),
)
