# pyright: reportAttributeAccessIssue=false
# (mujoco is a compiled module without type stubs)
"""Many copies of one MuJoCo model, stepped together on all cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from guider.data.store import Recording
from guider.support.physics import mujoco
from guider.tasks.types import Report, Scene


@dataclass(frozen=True)
class Start:
    """How a copy begins: qpos [nq] and qvel [nv] in MuJoCo's units, and the goal [goal_dim] it aims at."""

    qpos: np.ndarray
    qvel: np.ndarray
    goal: np.ndarray


class MujocoVectorEnv:
    """Copies of one model whose observation is qpos followed by qvel; a VectorEnv.

    A copy is its state vector alone: every step starts from (qpos, qvel) with the contact solver cold, so the
    observation determines what follows, and a copy's trajectory depends neither on the other copies nor on
    the number of cores. The stepping itself is MuJoCo's rollout: C++ threads, one per core.

    model:        without activations or plugins, so that (time, qpos, qvel) is its whole state; its motors limited
    frame_skip:   simulation steps per environment step
    sample_start: draws a copy's start; given np.random.default_rng(seed) of that copy
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        frame_skip: int,
        sample_start: Callable[[np.random.Generator], Start],
        count: int,
    ):
        threads = min(available_cores(), count)
        self.count = count
        self._model = model
        self._frame_skip = frame_skip
        self._sample_start = sample_start
        self._data = [mujoco.MjData(model) for _ in range(threads)]
        self._pool = mujoco.rollout.Rollout(nthread=threads if threads > 1 else 0)
        self._states = np.zeros((count, 1 + model.nq + model.nv))
        self._no_sensors = np.empty((count, frame_skip, model.nsensordata))

    def reset(self, seeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Start every copy anew; copy i is wholly determined by seeds[i].

        seeds: [count] int, not negative. Returns observations [count, nq + nv] and goals [count, goal_dim],
        float32.
        """
        if len(seeds) != self.count:
            raise ValueError(f"{len(seeds)} seeds for {self.count} copies")
        starts = [self._sample_start(np.random.default_rng(int(seed))) for seed in seeds]
        observations = self.place(np.arange(self.count), starts)
        return observations, np.array([start.goal for start in starts], np.float32)

    def place(self, copies: np.ndarray, starts: Sequence[Start]) -> np.ndarray:
        """Put the numbered copies where `starts` say, and return all observations [count, nq + nv] float32."""
        self._states[copies, 0] = 0.0
        self._states[copies, 1:] = [np.concatenate([start.qpos, start.qvel]) for start in starts]
        return self._observations()

    def step(self, actions: np.ndarray, active: np.ndarray) -> np.ndarray:
        """Advance the copies where `active` by one environment step; the others stay as they are.

        actions: [count, nu], which MuJoCo clips to the actuators' range; active: [count] bool.
        Returns observations [count, nq + nv] float32.
        """
        rows = np.flatnonzero(active)
        if len(rows) > 0:
            self._states[rows] = self._advance(self._states[rows], np.asarray(actions, float)[rows])
        return self._observations()

    def scene(self, copy: int) -> Scene:
        """What there is to see of a copy, see Visible."""
        data = mujoco.MjData(self._model)
        data.qpos[:], data.qvel[:] = np.split(self._states[copy, 1:], [self._model.nq])
        mujoco.mj_forward(self._model, data)
        return Scene(self._model, data, {})

    def close(self) -> None:
        """Release threads and simulators."""
        self._pool.close()
        self._data.clear()

    def _advance(self, states: np.ndarray, actions: np.ndarray) -> np.ndarray:
        controls = np.repeat(actions[:, None], self._frame_skip, axis=1)
        trajectories, _ = self._pool.rollout(
            self._model, self._data, states, controls, sensordata=self._no_sensors[: len(states)]
        )
        return np.asarray(trajectories)[:, -1]

    def _observations(self) -> np.ndarray:
        return self._states[:, 1:].astype(np.float32)


def available_cores() -> int:
    """CPU cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def on_all_cores(recipe: Any, steps: int, seed: int, report: Report, *, record: Callable[..., Recording]) -> Recording:
    """What `record`, which takes the number of processes last, makes of a recipe."""
    return record(recipe, steps, seed, report, available_cores())
