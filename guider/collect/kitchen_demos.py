"""A scripted demonstrator for Gymnasium-Robotics' FrankaKitchen-v1: seven subtasks, done the way people do them.

A subtask is a plan: a generator that looks at the kitchen and says, step by step, where the hand should be. Plans aim
at handles, which they find as sites of the simulation; a demonstrator's style makes no two demonstrations alike.
Coordinates are the world's, in metres: seen from the robot, x runs to the right along the counter, y ahead, z up.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from guider.collect.reaching import FINGER_LIMIT_M, TURN_LIMIT_RAD_S, Arm, Hand, act
from guider.data.readers.kitchen import kitchen_states

EPISODE_STEPS = 280
ATTEMPTS = 2

# The angles that the arm is reset to (rad); a demonstrator's posture is near it.
RESET_JOINTS = np.array([0.148, -1.768, 1.844, -2.477, 0.260, 0.713, 1.595])
POSTURE_SPREAD_RAD = 0.08
TEMPO_SPREAD = 0.10  # of the logarithm
NOISE_SPREADS = (0.02, 0.06)  # of an action; an episode's is drawn between them
NOISE_PERSISTENCE = 0.7  # correlation between one step and the next
FINGER_NOISE = 0.3  # as a share of the joints'
POSITION_SPREAD_M = 0.008
ROTATION_SPREAD_RAD = 0.04

CLOSED_M = 0.0
FINGERTIP_M = 0.05
"""The fingertips lie this far ahead of the hand's position."""


@dataclass(frozen=True)
class Pace:
    """How a stretch of motion goes.

    speed_m_s: at most
    near_m:    it ends within this distance of its aim (0: never); near_rad: and this turn
    steps:     it ends after so many steps at the latest
    jitter:    share of the spreads above by which it misses its aim
    """

    speed_m_s: float
    near_m: float
    near_rad: float
    steps: int
    jitter: float


REACH = Pace(speed_m_s=1.0, near_m=0.015, near_rad=0.25, steps=50, jitter=0.5)
TOUCH = Pace(speed_m_s=0.3, near_m=0.02, near_rad=0.3, steps=12, jitter=0.4)
WORK = Pace(speed_m_s=0.5, near_m=0.0, near_rad=0.0, steps=45, jitter=0.4)
LEAVE = Pace(speed_m_s=0.8, near_m=0.05, near_rad=np.pi, steps=6, jitter=1.0)

Chain = tuple[str, ...]
"""Subtasks, in the order in which they are done."""
Aim = tuple[Hand, float]
"""Where the hand should be, and how fast it may move there (m/s)."""
Plan = Generator[Aim, None, bool]
"""Aims, one a step; returns whether the object is where the plan wanted it."""


@dataclass(frozen=True)
class Kitchen:
    """What a plan sees."""

    arm: Arm
    rng: np.random.Generator

    def site(self, name: str) -> np.ndarray:
        """[3] m."""
        return self.arm.data.site(name).xpos.copy()

    def body(self, name: str) -> np.ndarray:
        """[3] m."""
        return self.arm.data.body(name).xpos.copy()

    def joint(self, name: str) -> float:
        """rad or m."""
        return float(self.arm.data.joint(name).qpos[0])

    def about(self, mark: float, spread: float) -> float:
        """A mark as this demonstrator takes it."""
        return mark + spread * self.rng.standard_normal()

    def move(self, aim: Callable[[], Hand], pace: Pace, until: Callable[[], bool] = lambda: False) -> Plan:
        """Follow a moving aim until `until` holds or the pace ends; returns whether it holds."""
        offset = pace.jitter * POSITION_SPREAD_M * self.rng.standard_normal(3)
        yaw, pitch = pace.jitter * ROTATION_SPREAD_RAD * self.rng.standard_normal(2)
        for _ in range(pace.steps):
            exact = aim()
            hand = Hand(exact.position + offset, exact.yaw_rad + yaw, exact.pitch_rad + pitch, exact.grip_m)
            distance, turn = (np.linalg.norm(error) for error in self.arm.errors(hand))
            if until() or (distance < pace.near_m and turn < pace.near_rad):
                break
            yield hand, pace.speed_m_s
        return until()

    def go(self, hand: Hand, pace: Pace) -> Plan:
        """Move to where the aim stands still."""
        return self.move(lambda: hand, pace)

    def here(self, hand: Hand) -> Hand:
        """Turned and opened as `hand`, but where the arm is now."""
        return replace(hand, position=self.arm.position)

    def grip(self, hand: Hand, grip_m: float, steps: int) -> Iterator[Aim]:
        """Stay, turned as `hand`, while the fingers move."""
        held = replace(self.here(hand), grip_m=grip_m)
        for _ in range(steps):
            yield held, WORK.speed_m_s


def door(kitchen: Kitchen, joint: str, hinge: str, handle: Hand, opened_rad: float, yaw_share: float) -> Plan:
    """Take a door by its handle and pull it open, round its hinge, as far as `opened_rad`, or until the handle slips
    out of the hand.

    handle:    how to take it when the door is shut, but where it is now
    yaw_share: share of the door's angle by which the hand turns with it
    """
    hinge_position = kitchen.body(hinge)
    to_handle, start_rad = handle.position - hinge_position, kitchen.joint(joint)

    def handle_at(angle_rad: float) -> Hand:
        position = hinge_position + _turned(to_handle, angle_rad - start_rad)
        return replace(handle, position=position, yaw_rad=handle.yaw_rad + yaw_share * angle_rad)

    def pull() -> Hand:
        angle_rad = kitchen.joint(joint)
        lead_rad = np.clip(1.1 * opened_rad - angle_rad, -0.35, 0.35)
        return replace(handle_at(angle_rad), position=handle_at(angle_rad + lead_rad).position, grip_m=CLOSED_M)

    def is_open() -> bool:
        return abs(kitchen.joint(joint)) > abs(opened_rad)

    def has_slipped() -> bool:
        return bool(np.linalg.norm(handle_at(kitchen.joint(joint)).position - kitchen.arm.position) > 0.07)

    yield from kitchen.go(handle_at(start_rad).ahead(-0.12), REACH)
    yield from kitchen.go(handle_at(start_rad), TOUCH)
    yield from kitchen.grip(handle_at(start_rad), CLOSED_M, steps=4)
    yield from kitchen.move(pull, replace(WORK, steps=70), until=lambda: is_open() or has_slipped())
    done = is_open()
    release = handle_at(kitchen.joint(joint))
    yield from kitchen.grip(release, FINGER_LIMIT_M, steps=2)
    yield from kitchen.go(kitchen.here(release).ahead(-0.12), LEAVE)
    return done


def microwave(kitchen: Kitchen) -> Plan:
    """Open the door, which turns to the left (its joint's angle falls), about as far as the goal."""
    handle = Hand(kitchen.site("microhandle_site"), yaw_rad=0.3, pitch_rad=-0.15)
    return door(kitchen, "microwave", "microdoorroot", handle, kitchen.about(-0.72, 0.06), yaw_share=0.2)


def hinge_cabinet(kitchen: Kitchen) -> Plan:
    """Open the right door, which turns to the right, about as far as it goes."""
    handle = Hand(kitchen.site("hinge_site2"))
    return door(kitchen, "right_hinge_cabinet", "hingerightdoor", handle, 1.42, yaw_share=0.45)


def kettle(kitchen: Kitchen) -> Plan:
    """Push the kettle to the back of the stove with two spread fingers, low on the middle of its rear.

    A kettle that turns is pushed on the side that turns it back; one that drifts, on the side it drifts to.
    """
    height_m, behind_m = 1.70, 0.122  # where the fingertips touch it, and how far from its centre
    place_x, place_y, turn_rad = -0.23, kitchen.about(0.74, 0.012), -0.06
    steering_m_per_rad, steering = 0.5, 0.5
    pitch_rad = -0.45

    def hand(x: float, y: float, pitch_rad: float) -> Hand:
        return Hand(np.array([x, y - behind_m, height_m]), 0.0, pitch_rad, grip_m=0.036).ahead(-FINGERTIP_M)

    def push() -> Hand:
        x, y, yaw_rad = _kettle_pose(kitchen)
        aside = steering_m_per_rad * (turn_rad - yaw_rad) + steering * (x - place_x)
        lower_rad = 0.15 * np.clip((y - 0.35) / 0.4, 0.0, 1.0)  # as the arm stretches
        return hand(x + np.clip(aside, -0.07, 0.07), min(y + 0.07, place_y + 0.03), pitch_rad - lower_rad)

    start_x, start_y, _ = _kettle_pose(kitchen)
    rear = hand(start_x, start_y, pitch_rad)
    yield from kitchen.go(rear.shifted(y=-0.07, z=0.03), REACH)
    yield from kitchen.go(rear, TOUCH)
    done = yield from kitchen.move(push, WORK, until=lambda: _kettle_pose(kitchen)[1] > place_y)
    yield from kitchen.go(kitchen.here(push()).shifted(y=-0.10, z=0.05), LEAVE)
    return done


def burner(kitchen: Kitchen, site: str, joint: str) -> Plan:
    """Turn a knob: put the open fingers on both sides of its lever and push that along its arc with the left one.

    The lever points up and turns to the right (its joint's angle falls). The finger aims at where the lever will be
    `lead_rad` later, and `push_m` beyond it, or it would only lean on it.
    """
    lever_m, finger_m, opening_m, lead_rad, push_m = 0.028, 0.014, 0.045, 0.3, 0.015
    lever_plane_y = 0.657
    knob_x, _, knob_z = kitchen.site(site)
    turned_rad = kitchen.about(-0.82, 0.04)

    def hand(x: float, z: float) -> Hand:
        """The fingertips about a point relative to the knob's axis."""
        return Hand(np.array([knob_x + x, lever_plane_y, knob_z + z]), pitch_rad=-0.3).ahead(-FINGERTIP_M)

    def push() -> Hand:
        angle_rad, ahead_m = lead_rad - kitchen.joint(joint), push_m - finger_m
        sine, cosine = np.sin(angle_rad), np.cos(angle_rad)
        return hand(lever_m * sine + ahead_m * cosine + opening_m, lever_m * cosine - ahead_m * sine)

    # A little to the right: the arm swings to the left as it stretches.
    astride = hand(0.02, lever_m)
    yield from kitchen.go(astride.shifted(y=-0.10), REACH)
    yield from kitchen.go(astride, TOUCH)
    done = yield from kitchen.move(push, WORK, until=lambda: kitchen.joint(joint) < turned_rad)
    yield from kitchen.go(kitchen.here(push()).shifted(x=-0.02, y=-0.10), LEAVE)
    return done


def light_switch(kitchen: Kitchen) -> Plan:
    """Sweep the switch from right to left with closed fingers."""
    sweep_plane_y = 0.585
    x, _, z = kitchen.site("light_site")
    switch = Hand(np.array([x, sweep_plane_y, z + 0.006]), grip_m=CLOSED_M)
    right, left = switch.shifted(x=0.06), switch.shifted(x=-0.11)
    yield from kitchen.go(right.ahead(-0.09), REACH)
    yield from kitchen.go(right, TOUCH)
    done = yield from kitchen.move(lambda: left, WORK, until=lambda: kitchen.joint("light_switch") < -0.66)
    yield from kitchen.go(kitchen.here(left).shifted(x=0.02, y=-0.12), LEAVE)
    return done


def slide_cabinet(kitchen: Kitchen) -> Plan:
    """Put the open fingers round the handle and slide the door to the right.

    Where the hinge cabinet's door stands open in the way, the hand comes in from the right of it.
    """
    blocked = kitchen.joint("right_hinge_cabinet") > 0.5
    yaw = 0.75 if blocked else 0.0
    handle = Hand(kitchen.site("slide_site"), yaw)
    opened = kitchen.about(0.37, 0.02)

    def push() -> Hand:
        straightened = yaw * max(0.0, 1.0 - kitchen.joint("slide_cabinet") / 0.3)
        return Hand(kitchen.site("slide_site"), straightened).shifted(x=0.13)

    if blocked:
        yield from kitchen.go(replace(handle, position=np.array([0.06, 0.36, 2.60])), REACH)
    yield from kitchen.go(handle.ahead(-0.13), REACH)
    yield from kitchen.go(handle, TOUCH)
    done = yield from kitchen.move(push, WORK, until=lambda: kitchen.joint("slide_cabinet") > opened)
    yield from kitchen.go(kitchen.here(push()).shifted(y=-0.12), LEAVE)
    return done


def _turned(offset: np.ndarray, angle_rad: float) -> np.ndarray:
    """A [3] vector turned about the vertical."""
    x, y, z = offset
    return np.array([np.cos(angle_rad) * x - np.sin(angle_rad) * y, np.sin(angle_rad) * x + np.cos(angle_rad) * y, z])


def _kettle_pose(kitchen: Kitchen) -> tuple[float, float, float]:
    """x and y (m) and yaw (rad; small)."""
    x, y, _, _, _, _, quaternion_z = kitchen.arm.data.joint("kettle").qpos
    return float(x), float(y), 2.0 * float(quaternion_z)


PLANS: dict[str, Callable[[Kitchen], Plan]] = {
    "microwave": microwave,
    "kettle": kettle,
    "bottom burner": partial(burner, site="knob2_site", joint="knob_Joint_2"),
    "top burner": partial(burner, site="knob4_site", joint="knob_Joint_4"),
    "light switch": light_switch,
    "slide cabinet": slide_cabinet,
    "hinge cabinet": hinge_cabinet,
}


def demonstrate(env: Any, chain: Chain, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """One episode: a chain's subtasks in order, each tried twice at most, until all are done or 280 steps are over.

    env: a KitchenEnv. Returns states [T + 1, 30] and the T actions [T, 9] between them, float32. All is determined by
    `rng`'s state; the same actions replayed after the reset with the same seed give the same states.
    """
    observation, _ = env.reset(seed=int(rng.integers(2**31)))
    kitchen = Kitchen(Arm(env.model, env.data), rng)
    tempo = np.exp(TEMPO_SPREAD * rng.standard_normal())
    posture = RESET_JOINTS + POSTURE_SPREAD_RAD * rng.standard_normal(7)
    noise = _tremor(rng)
    states, actions = [kitchen_states(observation["observation"])], []
    for hand, speed_m_s in _follow(kitchen, chain):
        exact = act(kitchen.arm, hand, tempo * speed_m_s, tempo * TURN_LIMIT_RAD_S, posture)
        actions.append(np.clip(exact + noise[len(actions)], -1.0, 1.0).astype(np.float32))
        observation, *_ = env.step(actions[-1])
        states.append(kitchen_states(observation["observation"]))
        if len(actions) == EPISODE_STEPS:
            break
    return np.array(states, np.float32), np.array(actions, np.float32)


def _follow(kitchen: Kitchen, chain: Chain) -> Iterator[Aim]:
    for subtask in chain:
        for _ in range(ATTEMPTS):
            if (yield from PLANS[subtask](kitchen)):
                break


def _tremor(rng: np.random.Generator) -> np.ndarray:
    """[280, 9] noise on an episode's actions: a stationary first-order autoregression."""
    spread = rng.uniform(*NOISE_SPREADS) * np.array([1.0] * 7 + [FINGER_NOISE] * 2)
    shocks = spread * rng.standard_normal((EPISODE_STEPS, 9))
    noise = np.zeros((EPISODE_STEPS, 9))
    noise[0] = shocks[0]
    for step in range(1, EPISODE_STEPS):
        noise[step] = NOISE_PERSISTENCE * noise[step - 1] + np.sqrt(1.0 - NOISE_PERSISTENCE**2) * shocks[step]
    return noise
