"""Copies of a Gymnasium goal environment, stepped on all cores."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import gymnasium
import numpy as np

from guider.errors import GuiderError
from guider.tasks.simulation import available_cores
from guider.tasks.types import Scene

Reading = Callable[[Any], tuple[np.ndarray, np.ndarray]]
"""An environment's observation -> (state [S], goal [G])."""


def read_goal_observation(observation: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """For observations that are dicts of `observation`, which holds the achieved goal's entries, and `desired_goal`."""
    return observation["observation"], observation["desired_goal"]


class GymVectorEnv:
    """`count` environments from `make`; a VectorEnv.

    Threads step them: MuJoCo lets go of Python's lock while it simulates. Whether an environment says that an
    episode is over is ignored: tasks say it themselves.
    """

    def __init__(self, make: Callable[[], gymnasium.Env], count: int, read: Reading = read_goal_observation):
        self.count = count
        self._read = read
        self._envs = [make() for _ in range(count)]
        self._threads = min(available_cores(), count)
        self._pool = ThreadPoolExecutor(self._threads)

    def reset(self, seeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See VectorEnv."""
        if len(seeds) != self.count:
            raise ValueError(f"{len(seeds)} seeds for {self.count} copies")

        def reset_one(copy: int) -> tuple[np.ndarray, np.ndarray]:
            return self._read(self._envs[copy].reset(seed=int(seeds[copy]))[0])

        states, goals = zip(*self._pool.map(reset_one, range(self.count)), strict=True)
        self._states = np.array(states, np.float32)
        return self._states.copy(), np.array(goals, np.float32)

    def step(self, actions: np.ndarray, active: np.ndarray) -> np.ndarray:
        """See VectorEnv. Actions are clipped to the environment's bounds."""
        space = self._envs[0].action_space
        assert isinstance(space, gymnasium.spaces.Box)
        clipped = np.clip(actions, space.low, space.high)

        def step_some(copies: np.ndarray) -> None:
            for copy in copies:
                self._states[copy] = self._read(self._envs[copy].step(clipped[copy])[0])[0]

        list(self._pool.map(step_some, np.array_split(np.flatnonzero(active), self._threads)))
        return self._states.copy()

    def scene(self, copy: int) -> Scene:
        """What there is to see of a copy, see Visible."""
        env: Any = self._envs[copy].unwrapped
        if not (hasattr(env, "model") and hasattr(env, "data")):
            raise GuiderError(f"{type(env).__name__} is no MuJoCo simulation, and only those can be filmed")
        renderer = getattr(getattr(env, "robot_env", env), "mujoco_renderer", None)
        return Scene(env.model, env.data, getattr(renderer, "default_cam_config", None) or {})

    def close(self) -> None:
        """See VectorEnv."""
        self._pool.shutdown()
        for env in self._envs:
            env.close()
