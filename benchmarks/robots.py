"""Six small robots, each with an operator whose logs are learned from: goal environments, and who drives them.

A differential drive (mm, rad) and a boat in a current (km, minutes) go round obstacles; MuJoCo's Reacher and
Gymnasium's FetchReach reach; a crane (mm) moves a load on a rope, and must not leave it swinging; a drone (m), seen
from the side, hovers on two rotors. Defaults for one's own data were chosen on robots like the drive, the Reacher,
FetchReach and the crane; on the boat and the drone nothing was.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from guider.data.episodes import Episodes, make_episodes
from guider.tasks.gymnasium_tasks import make_gymnasium

Array = np.ndarray
Operator = Callable[[Array], Array]
"""From a state to the action of somebody who drives by hand, for one goal."""


@dataclass(frozen=True)
class Field:
    """A rectangle with obstacles in it. size: (width, height); obstacles: (left, bottom, right, top) of each; margin:
    how near the robot's centre comes to what it must not touch; cell: side of the squares ways are planned over."""

    size: tuple[float, float]
    obstacles: tuple[tuple[float, float, float, float], ...]
    margin: float
    cell: float

    def blocked(self, place: Array, margin: float | None = None) -> bool:
        m = self.margin if margin is None else margin
        (x, y), (width, height) = place, self.size
        outside = not (m <= x <= width - m and m <= y <= height - m)
        return outside or any(a - m < x < c + m and b - m < y < d + m for a, b, c, d in self.obstacles)

    @cached_property
    def free(self) -> Array:
        """[columns, rows] bool: cells that ways may lead over, a little further from obstacles than need be."""
        shape = [round(side / self.cell) for side in self.size]
        centres = (np.indices(shape).reshape(2, -1).T + 0.5) * self.cell
        return ~np.array([self.blocked(centre, 1.5 * self.margin) for centre in centres]).reshape(shape)

    def place(self, rng: np.random.Generator) -> Array:
        """A free place, uniformly."""
        while True:
            drawn = rng.uniform(0, self.size)
            if self.free[self.index(drawn)]:
                return drawn

    def index(self, place: Array) -> tuple[int, int]:
        column, row = np.clip(place // self.cell, 0, np.array(self.free.shape) - 1).astype(int)
        return column, row

    def lengths_to(self, goal: Array) -> Array:
        """[columns, rows]: how long the shortest way over free cells is from each cell to the goal's."""
        numbers = np.arange(self.free.size).reshape(self.free.shape)
        edges = []
        for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1)):
            first = (slice(None, -dx or None), slice(max(0, -dy), -dy if dy > 0 else None))
            second = (slice(dx, None), slice(max(0, dy), -1 if dy < 0 else None))
            joined = self.free[first] & self.free[second]
            pairs = numbers[first][joined], numbers[second][joined]
            edges.append((*pairs, np.full(joined.sum(), self.cell * np.hypot(dx, dy))))
        begins, ends, weights = (np.concatenate(part) for part in zip(*edges, strict=True))
        graph = coo_matrix((weights, (begins, ends)), shape=(self.free.size,) * 2)
        return dijkstra(graph, directed=False, indices=numbers[self.index(goal)]).reshape(self.free.shape)

    def ahead(self, place: Array, lengths: Array, goal: Array, cells: int) -> Array:
        """What to steer for: the goal once it is near, else some cells further down the way that `lengths` tell of."""
        if np.linalg.norm(goal - place) < cells * self.cell:
            return goal
        column, row = self.index(place)
        for _ in range(cells):
            window = np.full((3, 3), np.inf)
            for i, j in np.ndindex(3, 3):
                c, r = column + i - 1, row + j - 1
                if 0 <= c < lengths.shape[0] and 0 <= r < lengths.shape[1]:
                    window[i, j] = lengths[c, r]
            i, j = np.unravel_index(np.argmin(window), window.shape)
            column, row = column + int(i) - 1, row + int(j) - 1
        return (np.array([column, row]) + 0.5) * self.cell


def _turned(angle: Array | float) -> Any:
    """An angle in (-pi, pi]."""
    return np.pi - (np.pi - angle) % (2 * np.pi)


FLAT = Field((5_000.0, 4_000.0), ((1_600, 0, 1_800, 2_500), (3_200, 1_500, 3_400, 4_000)), margin=140.0, cell=100.0)


def _drive_start(rng: np.random.Generator) -> Array:
    return np.array([*FLAT.place(rng), rng.uniform(-np.pi, np.pi), 0, 0])


def _drive_move(state: Array, action: Array) -> Array:
    """A tenth of a second. state: x, y mm, heading rad, speed mm/s, turn rad/s; action: the last two as asked for."""
    x, y, heading, speed, turn = state
    speed += np.clip(action[0] - speed, -70, 70)
    turn += np.clip(action[1] - turn, -0.4, 0.4)
    heading = _turned(heading + 0.1 * turn)
    ahead = np.array([x + 0.1 * speed * np.cos(heading), y + 0.1 * speed * np.sin(heading)])
    if FLAT.blocked(ahead):
        ahead, speed = np.array([x, y]), 0.0
    return np.array([*ahead, heading, speed, turn])


def _drive_operator(goal: Array, rng: np.random.Generator) -> Operator:
    lengths, bias = FLAT.lengths_to(goal), rng.normal(0, 0.1)

    def act(state: Array) -> Array:
        nonlocal bias
        bias = 0.95 * bias + rng.normal(0, 0.04)
        target = FLAT.ahead(state[:2], lengths, goal, 3)
        off = _turned(np.arctan2(*(target - state[:2])[::-1]) - state[2])
        near = min(1.0, np.linalg.norm(goal - state[:2]) / 300)
        return np.array([350 * near * max(0.0, 1 - abs(off)) + rng.normal(0, 20), 2 * off + bias + rng.normal(0, 0.1)])

    return act


SEA = Field((10.0, 6.0), ((2.5, 2.0, 4.0, 6.0), (6.0, 0.0, 7.5, 3.5)), margin=0.15, cell=0.2)


def _boat_start(rng: np.random.Generator) -> Array:
    heading = rng.uniform(-np.pi, np.pi)
    return np.array([*SEA.place(rng), np.cos(heading), np.sin(heading), 0.1, 0.0])


def _boat_move(state: Array, action: Array) -> Array:
    """Ten seconds, in a current that runs round the sea's middle. state: x, y km, the heading's cosine and sine, speed
    km/min, turn rad/min; action: rudder within 0.03, throttle from 0 to 1."""
    x, y, cosine, sine, speed, turn = state
    speed += 0.15 * (0.25 * action[1] - speed)
    turn += 0.4 * (action[0] / 0.03 * 12 * speed - turn)
    heading = np.arctan2(sine, cosine) + turn / 6
    cosine, sine = np.cos(heading), np.sin(heading)
    current = 0.04 * np.array([3 - y, x - 5]) / 5
    ahead = np.array([x, y]) + (speed * np.array([cosine, sine]) + current) / 6
    if SEA.blocked(ahead):  # it scrapes along
        along = [place for place in (np.array([x, ahead[1]]), np.array([ahead[0], y])) if not SEA.blocked(place)]
        ahead, speed = along[0] if along else np.array([x, y]), 0.7 * speed
    return np.array([*ahead, cosine, sine, speed, turn])


def _boat_operator(goal: Array, rng: np.random.Generator) -> Operator:
    lengths = SEA.lengths_to(goal)

    def act(state: Array) -> Array:
        target = SEA.ahead(state[:2], lengths, goal, 3)
        off = _turned(np.arctan2(*(target - state[:2])[::-1]) - np.arctan2(state[3], state[2]))
        throttle = 1 - 0.6 * min(1.0, abs(off)) + rng.normal(0, 0.05)
        return np.array([0.03 * (1.2 * off - 0.15 * state[5]) + rng.normal(0, 0.004), throttle])

    return act


ROPE_MM, GRAVITY_MM = 2_000.0, 9_810.0


def _crane_state(trolley: float, speed: float, swing: float, rate: float) -> Array:
    return np.array([trolley, speed, swing, rate, trolley + ROPE_MM * np.sin(swing)])


def _crane_move(state: Array, action: Array) -> Array:
    """A tenth of a second in ten. state: trolley mm, its speed mm/s, swing rad, its rate rad/s, the load's place mm;
    action: the trolley's acceleration within 0.03 g."""
    trolley, speed, swing, rate, _ = state
    for _ in range(10):
        pushed = action[0] * GRAVITY_MM
        if not 0 < trolley + 0.01 * (speed + 0.01 * pushed) < 6_000:
            pushed = -speed / 0.01
        speed += 0.01 * pushed
        trolley += 0.01 * speed
        rate += 0.01 * (-GRAVITY_MM / ROPE_MM * np.sin(swing) - pushed / ROPE_MM * np.cos(swing) - 0.05 * rate)
        swing += 0.01 * rate
    return _crane_state(trolley, speed, swing, rate)


def _crane_start(rng: np.random.Generator) -> Array:
    return _crane_state(rng.uniform(500, 5_500), 0, rng.normal(0, 0.05), 0)


def _crane_goal(rng: np.random.Generator) -> Array:
    return rng.uniform(500, 5_500, 1)


def _crane_operator(goal: Array, rng: np.random.Generator) -> Operator:
    def act(state: Array) -> Array:
        wanted = np.clip(0.7 * (goal[0] - state[0]), -600, 600)
        push = 1.2 * (wanted - state[1]) / GRAVITY_MM + 0.12 * state[2] + 0.05 * state[3]
        return np.array([push + rng.normal(0, 0.003)])

    return act


ROOM_M, ARM_M, INERTIA = np.array([8.0, 5.0]), 0.2, 0.02
"""The drone's room, half its width, and its inertia (kg m²); it weighs a kilogram."""


def _drone_move(state: Array, action: Array) -> Array:
    """A twentieth of a second in ten. state: x, z m, velocities m/s, pitch rad, its rate rad/s; action: thrust of the
    left and the right rotor, N. Walls stop it."""
    place, velocity, pitch, rate = state[:2], state[2:4], state[4], state[5]
    for _ in range(10):
        lift = action.sum() * np.array([-np.sin(pitch), np.cos(pitch)])
        velocity = velocity + 0.005 * (lift - [0, 9.81] - 0.2 * velocity)
        rate += 0.005 * ARM_M * (action[1] - action[0]) / INERTIA
        ahead, pitch = place + 0.005 * velocity, _turned(pitch + 0.005 * rate)
        place = np.clip(ahead, 0, ROOM_M)
        velocity = np.where(place == ahead, velocity, 0.0)
    return np.array([*place, *velocity, pitch, rate])


def _drone_place(rng: np.random.Generator) -> Array:
    return rng.uniform(1, ROOM_M - 1)


def _drone_start(rng: np.random.Generator) -> Array:
    return np.array([*_drone_place(rng), 0, 0, rng.normal(0, 0.05), 0])


def _drone_operator(goal: Array, rng: np.random.Generator) -> Operator:
    def act(state: Array) -> Array:
        (right, up, pitch, rate), (to_x, to_z) = state[2:], goal - state[:2]
        lean = -np.clip(to_x - 1.6 * right, -3, 3) / 9.81
        lift = (9.81 + np.clip(2 * to_z - 2 * up, -4, 4)) / np.cos(pitch)
        turn = INERTIA * (30 * (lean - pitch) - 8 * rate) / ARM_M
        return (lift + turn * np.array([-1, 1])) / 2 + rng.normal(0, 0.15, 2)

    return act


def _reacher_operator(goal: Array, rng: np.random.Generator) -> Operator:
    def act(state: Array) -> Array:
        angles = np.arctan2(state[2:4], state[:2])
        first, second = 0.1 * np.sin(angles[0]), 0.11 * np.sin(angles.sum())
        third, fourth = 0.1 * np.cos(angles[0]), 0.11 * np.cos(angles.sum())
        leads = np.array([[-first - second, -second], [third + fourth, fourth]])  # the fingertip's Jacobian
        return 100 * leads.T @ (goal - state[6:8]) - 0.1 * state[4:6] + rng.normal(0, 0.05, 2)

    return act


def _fetch_operator(goal: Array, rng: np.random.Generator) -> Operator:
    def act(state: Array) -> Array:
        return np.array([*(6 * (goal - state[:3]) + rng.normal(0, 0.3, 3)), 0])

    return act


class Simulated(gymnasium.Env):
    """A goal environment from three functions. start(rng) -> state; goal(rng) -> goal; move(state, action) -> state."""

    def __init__(self, start, goal, move, low, high, goal_indices, radius: float):
        self._start, self._goal, self._move, self._indices = start, goal, move, list(goal_indices)
        self.distance_threshold = radius
        drawn = np.random.default_rng(0)
        state, aim = (spaces.Box(-np.inf, np.inf, np.shape(part)) for part in (start(drawn), goal(drawn)))
        self.observation_space = spaces.Dict(observation=state, achieved_goal=aim, desired_goal=aim)
        self.action_space = spaces.Box(np.float32(low), np.float32(high))

    def _seen(self) -> dict[str, Array]:
        return {"observation": self.state, "achieved_goal": self.state[self._indices], "desired_goal": self.goal}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state, self.goal = self._start(self.np_random), self._goal(self.np_random)
        return self._seen(), {}

    def step(self, action):
        low, high = self.action_space.low, self.action_space.high  # pyright: ignore[reportAttributeAccessIssue]
        self.state = self._move(self.state, np.clip(np.asarray(action, float), low, high))
        return self._seen(), 0.0, False, False, {}


class Reacher(gymnasium.Env):
    """MuJoCo's Reacher from anywhere to anywhere. State: its joints' cosines and sines, velocities, fingertip (m)."""

    distance_threshold = 0.02

    def __init__(self):
        self._arm: Any = gymnasium.make("Reacher-v5").unwrapped
        state, aim = (spaces.Box(-np.inf, np.inf, (width,)) for width in (8, 2))
        self.observation_space = spaces.Dict(observation=state, achieved_goal=aim, desired_goal=aim)
        self.action_space = self._arm.action_space

    def _seen(self) -> dict[str, Array]:
        data = self._arm.data
        angles, tip = data.qpos[:2], self._arm.get_body_com("fingertip")[:2]
        state = np.concatenate([np.cos(angles), np.sin(angles), data.qvel[:2], tip])
        return {"observation": state, "achieved_goal": tip.copy(), "desired_goal": self.goal}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._arm.reset(seed=seed)
        angle, distance = self.np_random.uniform(-np.pi, np.pi), self.np_random.uniform(0.05, 0.2)
        self.goal = distance * np.array([np.cos(angle), np.sin(angle)])
        joints = self.np_random.uniform(-np.pi, np.pi, 2) * [1, 0.9]
        self._arm.set_state(np.concatenate([joints, self.goal]), np.zeros(4))
        return self._seen(), {}

    def step(self, action):
        self._arm.step(np.asarray(action, np.float32))
        return self._seen(), 0.0, False, False, {}


@dataclass(frozen=True)
class Logged:
    """A robot and how its logs come about. env: Gymnasium's id; operator: of a goal; episodes, rows: so many, of so
    many rows at most; stops: an episode ends once the goal is met."""

    env: str
    operator: Callable[[Array, np.random.Generator], Operator]
    goal_indices: tuple[int, ...]
    radius: float
    episodes: int
    rows: int
    stops: bool


def _register(name: str, steps: int, make: Callable[[], gymnasium.Env]) -> str:
    gymnasium.register(name, entry_point=make, max_episode_steps=steps)  # pyright: ignore[reportArgumentType]
    return f"benchmarks.robots:{name}"


def _simulated(name: str, steps: int, *facts: Any) -> str:
    return _register(name, steps, lambda: Simulated(*facts))


ROBOTS = {
    "drive": Logged(
        _simulated("Drive-v0", 600, _drive_start, FLAT.place, _drive_move, (-100, -1.5), (350, 1.5), (0, 1), 200),
        _drive_operator, (0, 1), 200, 300, 400, stops=True,
    ),
    "reacher": Logged(
        _register("GoalReacher-v0", 150, Reacher),
        _reacher_operator, (6, 7), 0.02,
        300, 61, stops=False,
    ),
    "fetch": Logged("FetchReach-v4", _fetch_operator, (0, 1, 2), 0.05, 300, 51, stops=False),
    "boat": Logged(
        _simulated("Boat-v0", 600, _boat_start, SEA.place, _boat_move, (-0.03, 0), (0.03, 1), (0, 1), 0.25),
        _boat_operator, (0, 1), 0.25, 300, 400, stops=True,
    ),
    "crane": Logged(
        _simulated(
            "Crane-v0", 300, _crane_start, _crane_goal, _crane_move, [-0.03], [0.03], (4,), 50
        ),
        _crane_operator, (4,), 50, 200, 151, stops=False,
    ),
    "drone": Logged(
        _simulated("Drone-v0", 300, _drone_start, _drone_place, _drone_move, (0, 0), (10, 10), (0, 1), 0.2),
        _drone_operator, (0, 1), 0.2, 200, 151, stops=False,
    ),
}  # fmt: skip


def logs(robot: Logged, seed: int) -> Episodes:
    """What the operator leaves behind: an episode for each reset, with states, actions, and no goals."""
    env, rng = make_gymnasium(robot.env, max_episode_steps=10**6), np.random.default_rng(seed)
    low, high = env.action_space.low, env.action_space.high  # pyright: ignore[reportAttributeAccessIssue]
    states, actions, lengths = [], [], []
    for episode in range(robot.episodes):
        seen, _ = env.reset(seed=1_000_000 * seed + episode)
        operate = robot.operator(seen["desired_goal"], rng)
        for row in range(robot.rows):
            state = np.asarray(seen["observation"])
            action = np.clip(operate(state), low, high)
            states.append(state)
            actions.append(action)
            near = np.linalg.norm(seen["achieved_goal"] - seen["desired_goal"]) < robot.radius / 2
            if (near and robot.stops) or row == robot.rows - 1:
                lengths.append(row + 1)
                break
            seen = env.step(action.astype(np.float32))[0]
    env.close()
    return make_episodes(np.array(states, np.float32), np.array(actions, np.float32), lengths, robot.goal_indices)
