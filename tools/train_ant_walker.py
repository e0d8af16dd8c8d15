# pyright: reportMissingImports=false
# (the RL library is an extra of its own)
"""Train the ant walker that records antmaze data, and save its weights.

    pip install "guider-rl[walker]"
    python -m tools.train_ant_walker --out guider/assets/ant_walker.npz

SAC (Haarnoja et al. 2018) as SBX implements it, on D4RL's ant without walls. The ant is told a direction, which
changes now and then; it is paid for its speed along it, and an episode ends when the ant falls on its back. The
actions are disturbed as they will be when data is recorded, so that the walker learns to keep its feet.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import gymnasium
import numpy as np
from sbx import SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from guider.collect.ant_walker import VIEW_DIM, rotations, walker_view
from guider.tasks.antmaze import (
    ACTION_NOISE_SPREAD,
    FRAME_SKIP,
    INITIAL_QPOS,
    RESET_QPOS_RANGE,
    RESET_QVEL_SPREAD,
    TIMESTEP_S,
    ant_model,
)
from guider.tasks.mazes import Maze
from guider.tasks.simulation import MujocoVectorEnv, Start

COPIES = 16
EPISODE_STEPS = 500
TURN_CHANCE = 1 / 30
TOP_SPEED_M_PER_S = 2.0
HIDDEN = (256, 256)
OPEN_FIELD = Maze("field", ("00", "00"), 4.0, (0, 0))


def upright(observations: np.ndarray) -> np.ndarray:
    """[n, 29] -> [n] cosine between the ant's up and the world's."""
    return rotations(observations[:, 3:7])[:, 2, 2]


def start(rng: np.random.Generator) -> Start:
    """Standing, or nearly so, headed anywhere."""
    qpos, qvel = np.array(INITIAL_QPOS, float), RESET_QVEL_SPREAD * rng.standard_normal(14)
    qpos += rng.uniform(-RESET_QPOS_RANGE, RESET_QPOS_RANGE, 15)
    heading = rng.uniform(0, np.pi)
    qpos[3:7] += [np.cos(heading) - 1, 0.0, 0.0, np.sin(heading)]
    return Start(qpos, qvel, np.zeros(2))


def directions(rng: np.random.Generator, count: int) -> np.ndarray:
    angle = rng.uniform(0, 2 * np.pi, count)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


class WalkingAnts(VecEnv):
    """Copies of the ant in the open, told where to walk; their actions are disturbed."""

    def __init__(self, count: int, seed: int):
        box = gymnasium.spaces.Box
        super().__init__(count, box(-np.inf, np.inf, (VIEW_DIM,), np.float32), box(-1.0, 1.0, (8,), np.float32))
        self.rng = np.random.default_rng(seed)
        self.env = MujocoVectorEnv(ant_model(OPEN_FIELD), FRAME_SKIP, start, count)

    def reset(self):
        self.states, _ = self.env.reset(self.rng.integers(2**31, size=self.num_envs))
        self.directions = directions(self.rng, self.num_envs)
        self.age = self.rng.integers(EPISODE_STEPS, size=self.num_envs)
        self.returns = np.zeros(self.num_envs)
        return self._views()

    def step_async(self, actions):
        self.actions = np.clip(actions + ACTION_NOISE_SPREAD * self.rng.standard_normal(actions.shape), -1, 1)

    def step_wait(self):
        before = self.states[:, :2].copy()
        self.states = self.env.step(self.actions, np.ones(self.num_envs, bool))
        velocity = (self.states[:, :2] - before) / (FRAME_SKIP * TIMESTEP_S)
        rewards = np.minimum((velocity * self.directions).sum(axis=1), TOP_SPEED_M_PER_S).astype(np.float32)
        self.age += 1
        self.returns += rewards
        fell, late = upright(self.states) < 0, self.age >= EPISODE_STEPS
        ended = np.flatnonzero(fell | late)
        views = self._views()
        infos: list[dict] = [{} for _ in range(self.num_envs)]
        for i in ended:
            infos[i] = {
                "terminal_observation": views[i],
                "TimeLimit.truncated": bool(late[i] and not fell[i]),
                "episode": {"r": self.returns[i], "l": int(self.age[i]), "t": 0.0},
            }
        if len(ended):
            self.states = self.env.place(ended, [start(self.rng) for _ in ended])
            self.age[ended], self.returns[ended] = 0, 0.0
        turning = fell | late | (self.rng.random(self.num_envs) < TURN_CHANCE)
        self.directions[turning] = directions(self.rng, int(turning.sum()))
        return self._views(), rewards, fell | late, infos

    def _views(self) -> np.ndarray:
        return walker_view(self.states, self.directions).astype(np.float32)

    def close(self):
        self.env.close()

    def get_attr(self, attr_name, indices=None):
        return [None] * self.num_envs

    def set_attr(self, attr_name, value, indices=None):
        raise NotImplementedError

    def env_method(self, method_name, *args, indices=None, **kwargs):
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class, indices=None):
        return [False] * self.num_envs


def examine(walker: Callable[[np.ndarray], np.ndarray], seed: int, steps: int = 300, copies: int = 100) -> str:
    """How the walker does with its mean action, disturbed, turning as in training: speed and falls."""
    ants = WalkingAnts(copies, seed)
    views, speed, falls, slow = ants.reset(), 0.0, 0, 0.0
    ants.age[:] = 0
    for _ in range(steps):
        ants.step_async(walker(views))
        views, rewards, done, infos = ants.step_wait()
        speed += rewards.mean() / steps
        slow += (rewards < 0.2).mean() / steps
        falls += sum(not infos[i]["TimeLimit.truncated"] for i in np.flatnonzero(done))
    ants.close()
    rate = 1000 * falls / (steps * copies)
    return f"{speed:.2f} m/s along the direction, {slow:.0%} of steps below 0.2 m/s, {rate:.2f} falls per 1,000 steps"


class Keep(BaseCallback):
    """Save the weights every so many steps, and say how the walker does."""

    def __init__(self, path: Path, every_steps: int):
        super().__init__()
        self.path, self.every, self.began = path, every_steps, time.time()

    def _on_step(self) -> bool:
        if self.n_calls % (self.every // COPIES) == 0:
            save(self.model, self.path)
            report = examine(lambda views: self.model.predict(views, deterministic=True)[0], seed=1)
            print(f"{self.num_timesteps:>8} steps, {(time.time() - self.began) / 60:.1f} min: {report}", flush=True)
        return True


def save(model: SAC, path: Path) -> None:
    """The actor's layers up to its mean, as the walker of guider.collect.ant_walker reads them."""
    layers = model.policy.actor_state.params["params"]
    arrays = {}
    for i, name in enumerate(sorted(layers, key=lambda name: int(name.split("_")[1]))[: len(HIDDEN) + 1]):
        arrays[f"weights_{i}"] = np.asarray(layers[name]["kernel"], np.float32)
        arrays[f"biases_{i}"] = np.asarray(layers[name]["bias"], np.float32)
    partial = path.with_suffix(".partial.npz")
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(partial, **arrays)
    partial.replace(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    model = SAC(
        "MlpPolicy",
        WalkingAnts(COPIES, arguments.seed),
        learning_rate=5e-4,
        learning_starts=10_000,
        batch_size=256,
        gamma=0.98,
        train_freq=1,
        gradient_steps=COPIES // 2,
        policy_delay=2,
        policy_kwargs={"net_arch": {"pi": list(HIDDEN), "qf": [256, 256]}},
        seed=arguments.seed,
    )
    model.learn(arguments.steps, callback=Keep(arguments.out, 100_000))
    save(model, arguments.out)


if __name__ == "__main__":
    main()
