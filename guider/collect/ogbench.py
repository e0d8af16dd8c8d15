"""Recording by the protocol of OGBench's public generators (Park et al. 2025), in its own environments: who wanders
through a maze, and who plays at a table.

OGBench and the oracles that play are an extra, imported by whoever makes an environment.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal, Protocol

import numpy as np

from guider.collect import check_steps
from guider.collect.processes import map_in_processes
from guider.data.ends import lengths_from_ends
from guider.data.store import Recording

MazeKind = Literal["navigate", "stitch", "explore"]
TableKind = Literal["play", "noisy"]
EPISODE_ROWS_AT_ONCE = 16_000
"""Rows that a worker process records before it reports: half a minute at most."""
STITCH_CELLS = 4
EXPLORE_STEPS = 10
MIN_NORM = 0.4
"""Least size of what a Markov oracle asks for."""
LEFT_M, RIGHT_M = -0.3, 0.29
IN_DRAWER_M = (0.06, 0.08)
"""Heights of a cube that lies in the drawer, which stands on the left."""
CUBE_QPOS = slice(14, 17)
"""Where a scene's only cube is."""


class Play(Protocol):
    """Who acts, in one kind of environment."""

    def __call__(self, env: Any, steps: int, seed: int, log: Log) -> None:
        """Play one episode of so many steps, wholly determined by `seed`, and log every one.

        env: unwrapped. NumPy's global generator is seeded too: OGBench draws from it.
        """
        ...


@dataclass(frozen=True)
class Recipe:
    """How to record in one of OGBench's environments. make_env is called in worker processes."""

    make_env: Callable[[], Any]
    play: Play
    episode_steps: int


@dataclass
class Log:
    """Rows of an episode by name, as OGBench's files have them."""

    rows: dict[str, list[Any]] = field(default_factory=dict)

    def add(self, observation: np.ndarray, action: np.ndarray, info: dict[str, Any]) -> None:
        """info: what the step says, the state of the simulator before it included."""
        row = {"observations": observation, "actions": action, "qpos": info["prev_qpos"], "qvel": info["prev_qvel"]}
        if "prev_button_states" in info:
            row["button_states"] = info["prev_button_states"]
        for name, value in row.items():
            self.rows.setdefault(name, []).append(value)

    def arrays(self) -> dict[str, np.ndarray]:
        """[rows, ...] each: int64 of what is counted, float32 of all else."""
        whole = {name: np.array(values) for name, values in self.rows.items()}
        return {
            name: array.astype(np.int64 if np.issubdtype(array.dtype, np.integer) else np.float32)
            for name, array in whole.items()
        }


def record(recipe: Recipe, steps: int, seed: int, report: Callable[[int, int], None], cores: int) -> Recording:
    """Record `steps` rows by `recipe` in `cores` worker processes; the last episode is cut short where they are full.

    Episode n is determined by (seed, n), whatever the number of cores. report: called with (rows done, rows in all).
    Raises GuiderError if `steps` is below 2.
    """
    check_steps(steps)
    episodes = -(-steps // recipe.episode_steps)
    batches = np.array_split(np.arange(episodes), -(-episodes * recipe.episode_steps // EPISODE_ROWS_AT_ONCE))
    recorded: list[dict[str, np.ndarray]] = []
    report(0, steps)
    with map_in_processes(min(cores, len(batches))) as map_batches:
        for batch in map_batches(partial(_episodes, recipe, seed), batches):
            recorded += batch
            report(min(len(recorded) * recipe.episode_steps, steps), steps)
    arrays = {name: np.concatenate([episode[name] for episode in recorded])[:steps] for name in recorded[0]}
    lengths = lengths_from_ends(np.arange(1, steps + 1) % recipe.episode_steps == 0)
    observations, actions = arrays.pop("observations"), arrays.pop("actions")
    bound = np.ones(actions.shape[1], np.float32)
    return Recording(observations, actions, lengths, action_low=-bound, action_high=bound, simulation=arrays)


def _episodes(recipe: Recipe, seed: int, numbers: np.ndarray) -> list[dict[str, np.ndarray]]:
    env = recipe.make_env()
    recorded = []
    try:
        for number in numbers:
            own = int(np.random.SeedSequence([seed, int(number)]).generate_state(1)[0])
            with numpys_generator(own):
                log = Log()
                recipe.play(env, recipe.episode_steps, own, log)
            recorded.append(log.arrays())
    finally:
        env.close()
    return recorded


@contextmanager
def numpys_generator(seed: int) -> Iterator[None]:
    """Seed NumPy's global generator, and put it back as it was."""
    before = np.random.get_state()  # noqa: NPY002
    np.random.seed(seed)  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(before)  # noqa: NPY002


@dataclass(frozen=True)
class Wander:
    """Through a maze, from a random cell, along the maze's own shortest ways.

    kind: navigate: to one random cell after the other, none of them in the middle of a corridor; stitch: to one of the
          cells four steps away, and stay there; explore: in a new random direction every ten steps
    act:  (observation [S], unit direction [2] in the maze's frame) -> action
    noise: standard deviation of the noise on every action entry
    """

    kind: MazeKind
    act: Callable[[np.ndarray, np.ndarray], np.ndarray]
    noise: float

    def __call__(self, env: Any, steps: int, seed: int, log: Log) -> None:
        """See Play."""
        rng = np.random.default_rng([seed, 1])  # the environment draws joints from default_rng(seed)
        cells, ends = np.argwhere(env.maze_map == 0), _not_in_corridors(env.maze_map)
        start = _any_of(cells, rng)
        goal = _any_of(_cells_away(env, start, STITCH_CELLS) if self.kind == "stitch" else ends, rng)
        observation, _ = env.reset(seed=seed, options={"task_info": {"init_ij": start, "goal_ij": goal}})
        way: dict[tuple[Any, ...], np.ndarray] = {}
        direction = np.zeros(2)
        for step in range(steps):
            if self.kind != "explore":
                direction = _towards(_next_centre(env, way) - env.get_xy())
            elif step % EXPLORE_STEPS == 0:
                direction = _towards(rng.standard_normal(2))
            action = self.act(env.get_ob(), direction)
            action = np.clip(action + self.noise * rng.standard_normal(action.shape), -1.0, 1.0)
            following, _, _, _, info = env.step(action)
            if info["success"] and self.kind == "navigate":
                env.set_goal(goal_xy=env.add_noise(env.ij_to_xy(_any_of(ends, rng))))
            log.add(observation, action, info)
            observation = following


def _any_of(cells: np.ndarray, rng: np.random.Generator) -> tuple[int, int]:
    row, column = cells[rng.integers(len(cells))].tolist()
    return row, column


def _towards(displacement: np.ndarray) -> np.ndarray:
    return displacement / (np.linalg.norm(displacement) + 1e-6)


def _not_in_corridors(walls: np.ndarray) -> np.ndarray:
    """[cells, 2]: free cells but those whose only free neighbours are two that face each other."""

    def in_corridor(row: int, column: int) -> bool:
        across = walls[row, column - 1], walls[row, column + 1]
        along = walls[row - 1, column], walls[row + 1, column]
        return sorted([across, along]) == [(0, 0), (1, 1)]

    return np.array([cell for cell in np.argwhere(walls == 0).tolist() if not in_corridor(*cell)])


def _cells_away(env: Any, start: tuple[int, int], count: int) -> np.ndarray:
    """[cells, 2]: those that the shortest way to leads through so many cells; the start itself where there are none."""
    centre = np.array(env.ij_to_xy(start))
    _, steps = env.get_oracle_subgoal(centre, centre)
    found = np.argwhere(steps == count)
    return found if len(found) else np.array([start])


def _next_centre(env: Any, known: dict[tuple[Any, ...], np.ndarray]) -> np.ndarray:
    """The centre of the next cell on the maze's own way to its goal, looked up where it is known."""
    xy, goal = env.get_xy(), env.cur_goal_xy
    key = (*env.xy_to_ij(xy), *env.xy_to_ij(goal))
    if key not in known:
        known[key] = env.get_oracle_subgoal(xy, goal)[0]
    return known[key]


@dataclass(frozen=True)
class PlayAtTable:
    """One random target after the other: a cube to be put somewhere, a button to be pressed, a drawer or a window to be
    moved.

    kind:   play: OGBench's oracles that follow a plan with smooth noise; noisy: those that look at every step, with
            noise of an episode's own size
    random: share of the steps that a random action is taken at
    """

    kind: TableKind
    random: float = 0.0

    def __call__(self, env: Any, steps: int, seed: int, log: Log) -> None:
        """See Play."""
        rng = np.random.default_rng([seed, 1])
        healthy = False
        while not healthy:
            log.rows.clear()
            self._play_once(env, steps, int(rng.integers(2**31)), rng, log)
            healthy = not hasattr(env, "_drawer_site_id") or _is_in_sight(np.array(log.rows["qpos"])[:, CUBE_QPOS])

    def _play_once(self, env: Any, steps: int, seed: int, rng: np.random.Generator, log: Log) -> None:
        oracles = self._oracles(env)
        observation, info = env.reset(seed=seed)
        stacking = rng.uniform(*_STACKING.get(env._env_type, (0.5, 0.5)))
        spread = rng.uniform(0.0, 0.1) * np.array([1, 1, 1, 3, 10])
        oracle = oracles[info["privileged/target_task"]]
        oracle.reset(observation, info)
        for _ in range(steps):
            if rng.random() < self.random:
                action = rng.uniform(-1.0, 1.0, 5)
            else:
                action = np.array(oracle.select_action(observation, info))
                if self.kind == "noisy":
                    action = action + spread * rng.standard_normal(5)
            action = np.clip(action, -1.0, 1.0)
            following, _, _, _, info = env.step(action)
            if oracle.done:
                seen, target = env.set_new_target(p_stack=stacking)
                oracle = oracles[target["privileged/target_task"]]
                oracle.reset(seen, target)
            log.add(observation, action, info)
            observation = following

    def _oracles(self, env: Any) -> dict[str, Any]:
        """By what they see to; those of things that are not there are never asked."""
        from ogbench.manipspace.oracles.markov import button_markov, cube_markov, drawer_markov, window_markov
        from ogbench.manipspace.oracles.plan import button_plan, cube_plan, drawer_plan, window_plan

        closed = {"gripper_always_closed": not hasattr(env, "_num_cubes")}
        if self.kind == "play":
            return {
                "cube": cube_plan.CubePlanOracle(env=env),
                "button": button_plan.ButtonPlanOracle(env=env, **closed),
                "drawer": drawer_plan.DrawerPlanOracle(env=env),
                "window": window_plan.WindowPlanOracle(env=env),
            }
        return {
            "cube": cube_markov.CubeMarkovOracle(env=env, min_norm=MIN_NORM),
            "button": button_markov.ButtonMarkovOracle(env=env, min_norm=MIN_NORM, **closed),
            "drawer": drawer_markov.DrawerMarkovOracle(env=env, min_norm=MIN_NORM),
            "window": window_markov.WindowMarkovOracle(env=env, min_norm=MIN_NORM),
        }


_STACKING = {"single": (0.0, 0.0), "double": (0.0, 0.25), "triple": (0.05, 0.35)}
"""(least, greatest) chance that a cube is to be put on another one; an episode draws its own."""


def _is_in_sight(cube: np.ndarray) -> bool:
    """[rows, 3] positions: whether the cube never lies too far to the right, nor to the left unless in the drawer."""
    _, side, height = cube.T
    outside = (height < IN_DRAWER_M[0]) | (height > IN_DRAWER_M[1])
    return not (side >= RIGHT_M).any() and not ((side <= LEFT_M) & outside).any()
