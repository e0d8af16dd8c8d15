"""Feedback experts for the four Fetch tasks: the present observation in, an action out, no memory.

The robot's gripper is a velocity actuator. An action's first three entries move it along x, y and z: a full action by
33 mm a step, half an action by half of that, after one step of getting under way. The last entry opens (+1) or
closes (-1) the fingers, which move along y.

Positions are in metres and speeds in metres per second, in the world's frame, z up. The table's top is at 0.4 m.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

Expert = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(observation [10 or 25], goal [3] in metres) -> action [4] within [-1, 1]."""

ACTION_DIM = 4
STEP_S = 0.04
FULL_ACTION_M = 0.033
"""How far a full action moves the gripper in one step."""


class Scene(NamedTuple):
    """An observation of Push, Pick or Slide: positions and velocities [3] of the gripper and of the object, and how
    far each finger is open in metres. `object` is the cube or the puck: its centre."""

    gripper: np.ndarray
    gripper_velocity: np.ndarray
    object: np.ndarray
    object_velocity: np.ndarray
    finger: float


def read_scene(observation: np.ndarray) -> Scene:
    """[25] -> Scene. Observations give velocities in metres per step, the object's relative to the gripper's."""
    return Scene(
        gripper=observation[0:3],
        gripper_velocity=observation[20:23] / STEP_S,
        object=observation[3:6],
        object_velocity=(observation[14:17] + observation[20:23]) / STEP_S,
        finger=float(observation[9:11].mean()),
    )


# Reach


def reach(observation: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Moves the gripper straight to the goal."""
    return np.append(move(goal - observation[:3]), 0.0)


# Push: a cube with edges of 50 mm.

PUSH_HEIGHT_M = 0.43
PUSH_STAGE_M = 0.053  # behind the cube's centre, where the gripper goes first
PUSH_DETOUR_M = 0.064  # from the cube's centre, on the way there
PUSH_LANE_M = 0.022  # half the width of the strip behind the cube from which it is pushed
PUSH_CONTACT_M = 0.045  # between the centres when they touch
PUSH_FULL_SPEED = 1.5  # action; above 1 for what steering takes off it
PUSH_LANE_GAIN = 27.0  # action per metre off the strip's middle
PUSH_BRAKING_GAIN = 13.0  # action per metre to go
PUSH_BRAKING_MARGIN_M = 0.02
PUSH_CLOSING_GAIN = 18.0  # further action per metre between the gripper and the cube
PUSH_DONE_M = 0.022


def push(observation: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Goes behind the cube, as seen from the goal, and pushes it there, slower the nearer it comes.

    A pushed cube turns away from the line of pushing, so the gripper steers to where that line meets its back; once
    the gripper has left the strip behind the cube, it goes around it again.
    """
    scene = read_scene(observation)
    gripper, cube = scene.gripper[:2], scene.object[:2]
    to_goal = goal[:2] - cube
    distance = np.linalg.norm(to_goal)
    ahead, left = axes_along(to_goal)
    behind, aside = (cube - gripper) @ ahead, (gripper - cube) @ left
    if distance < PUSH_DONE_M:
        planar = np.zeros(2)
    elif behind > 0.0 and abs(aside) < PUSH_LANE_M:
        braking = PUSH_BRAKING_GAIN * max(distance - PUSH_BRAKING_MARGIN_M, 0.0)
        closing = PUSH_CLOSING_GAIN * max(behind - PUSH_CONTACT_M, 0.0)
        planar = shorten(min(braking + closing, PUSH_FULL_SPEED) * ahead - PUSH_LANE_GAIN * aside * left)
    else:
        planar = shorten(way_around(gripper, cube, cube - PUSH_STAGE_M * ahead, PUSH_DETOUR_M) / FULL_ACTION_M)
    return np.array([*planar, move(PUSH_HEIGHT_M - scene.gripper[2]), 0.0])


# Pick: the same cube.

PICK_GRIP_ABOVE_M = 0.02  # the fingers' middle, above the cube's centre, when they close
PICK_ENTRY_M = 0.051  # the same, when the fingers pass over the cube
PICK_BESIDE_M = ((0.0, 0.085), (0.022, 0.14))  # distances along x and y at which a finger could hit the cube
PICK_AROUND_M = (0.043, 0.0165, 0.0365)  # errors along x, y and z at which the open fingers have the cube between them
PICK_HELD_M = (0.03, 0.02, 0.03)  # the same, when closed fingers hold it
PICK_HELD_FINGER_M = 0.03  # a finger that is open less than this is closed
PICK_DONE_M = 0.02


def pick(observation: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Comes down on the cube with open fingers, closes them, and carries it to the goal.

    Beside the cube, where a finger would push it away, the gripper rises first. A cube that lies at the goal is left
    alone.
    """
    scene = read_scene(observation)
    to_goal = goal - scene.object
    to_cube = scene.object - scene.gripper
    error = to_cube + np.array([0.0, 0.0, PICK_GRIP_ABOVE_M])
    if np.all(np.abs(error) < PICK_HELD_M) and scene.finger < PICK_HELD_FINGER_M:
        return np.append(move(to_goal), -1.0)
    if np.linalg.norm(to_goal) < PICK_DONE_M:
        return np.zeros(ACTION_DIM)
    if np.all(np.abs(error) < PICK_AROUND_M):
        return np.append(move(error), -1.0)
    if all(low <= abs(distance) < high for distance, (low, high) in zip(to_cube[:2], PICK_BESIDE_M, strict=True)):
        error[2] = to_cube[2] + PICK_ENTRY_M
    return np.append(move(error), 1.0)


# Slide: a puck of radius 25 mm, struck with the closed fingers, an upright block.

SLIDE_HEIGHT_M = 0.424
SLIDE_DECELERATION = 0.981  # m/s^2: friction 0.1
SLIDE_PUCK_RADIUS_M = 0.025
SLIDE_BLOCK_HALF_M = (0.0135, 0.0143)  # along x and y
SLIDE_DETOUR_M = 0.062  # from the puck's centre, on the way to the stage
SLIDE_STAGE_GAP_M = 0.009  # behind the point of contact, where the gripper goes first
SLIDE_LONGEST_GAP_M = 0.011  # from which it strikes
SLIDE_AIM_M2 = 0.0008  # how far aside of that point it may be when it strikes, times the distance to go
SLIDE_STILL_SPEED = 0.1  # m/s
SLIDE_DONE_M = 0.03
SLIDE_FOLLOW_GAP_M, SLIDE_FOLLOW_ASIDE_M = 0.006, 0.03  # how far the puck may have gone for a second stroke


def slide(observation: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Strikes the puck so that it comes to rest at the goal, from right behind it, in one stroke or two.

    The block strikes with a corner. Then the puck leaves along the line from the corner to its centre, whatever the
    way the block moves, so the gripper goes to where that line is the direction of launch. The second stroke, in the
    very next step, gives far goals the speed that one step cannot.
    """
    scene = read_scene(observation)
    gripper, puck, velocity = scene.gripper[:2], scene.object[:2], scene.object_velocity[:2]
    to_goal = goal[:2] - puck
    launch = launch_velocity(to_goal)
    speed = float(np.linalg.norm(launch))
    ahead, left = axes_along(launch)
    contact = puck - SLIDE_PUCK_RADIUS_M * ahead - np.copysign(SLIDE_BLOCK_HALF_M, ahead)
    gap, aside = float((contact - gripper) @ ahead), float((gripper - contact) @ left)
    full = 1.0 / np.abs(ahead).max()

    planar = np.zeros(2)
    if np.linalg.norm(velocity) > SLIDE_STILL_SPEED:
        along = float(velocity @ ahead)
        too_slow = speed > along and np.linalg.norm(to_goal - coasting(velocity)) > SLIDE_DONE_M
        if too_slow and abs(gap) < SLIDE_FOLLOW_GAP_M and abs(aside) < SLIDE_FOLLOW_ASIDE_M:
            planar = np.clip(second_stroke(speed, along, gap), 0.0, full) * ahead
    elif (distance := np.linalg.norm(to_goal)) > SLIDE_DONE_M:
        aimed = 0.0 < gap < SLIDE_LONGEST_GAP_M and abs(aside) < SLIDE_AIM_M2 / distance
        if aimed and np.linalg.norm(scene.gripper_velocity[:2]) < SLIDE_STILL_SPEED:
            planar = min(first_stroke(speed, gap), full) * ahead
        else:
            stage = contact - SLIDE_STAGE_GAP_M * ahead
            planar = shorten(way_around(gripper, puck, stage, SLIDE_DETOUR_M) / FULL_ACTION_M)
    return np.array([*planar, move(SLIDE_HEIGHT_M - scene.gripper[2]), 0.0])


def launch_velocity(displacement: np.ndarray) -> np.ndarray:
    """The velocity [2] from which the puck coasts by `displacement` [2]; the inverse of `coasting`."""
    x, y = np.abs(displacement)
    both = np.sqrt(2.0 * SLIDE_DECELERATION * (x + y))
    difference = np.sqrt(2.0 * SLIDE_DECELERATION * abs(x - y)) * (1.0 if x >= y else -1.0)
    return np.copysign([both + difference, both - difference], displacement) / 2.0


def coasting(velocity: np.ndarray) -> np.ndarray:
    """How far [2] the puck slides from `velocity` [2].

    MuJoCo's friction cone is a pyramid: friction slows the faster of the two components alone until both are equal,
    then both at half the rate. So the faster comes to rest after (fast^2 + slow^2) / 2a and the slower after
    fast slow / a, and a puck launched straight at its goal misses it.
    """
    x, y = np.abs(velocity)
    along_faster, along_slower = (x**2 + y**2) / 2.0, x * y
    distances = [along_faster, along_slower] if x >= y else [along_slower, along_faster]
    return np.copysign(distances, velocity) / SLIDE_DECELERATION


def first_stroke(speed: float, gap: float) -> float:
    """Action that launches a puck at rest at `speed` m/s from `gap` metres behind it.

    Measured: an action a launches at 0.93 a - 600 gap^2 / a, within 0.02 m/s.
    """
    return (speed + np.sqrt(speed**2 + 4.0 * 0.93 * 600.0 * gap**2)) / (2.0 * 0.93)


def second_stroke(speed: float, puck_speed: float, gap: float) -> float:
    """Action that brings a puck from `puck_speed` to `speed` m/s one step after the first stroke.

    Measured: an action a leaves it with 0.62 a + 0.46 puck_speed - 27 gap after the step, within 0.02 m/s, in which
    friction has taken its share.
    """
    return (speed - SLIDE_DECELERATION * STEP_S - 0.46 * puck_speed + 27.0 * gap) / 0.62


# What they share

DETOUR_TURN = 0.7  # rad, from one corner of the polygon to the next


def move(error_m: Any) -> Any:
    """Action that takes the gripper that much further, or as far as one step goes: a number, or entry by entry."""
    return np.clip(error_m / FULL_ACTION_M, -1.0, 1.0)


def shorten(planar: np.ndarray) -> np.ndarray:
    """The action [2], made shorter to fit into [-1, 1] but in its direction."""
    return planar / max(1.0, np.abs(planar).max())


def axes_along(vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors along `vector` [2], which is not 0, and to the left of it."""
    ahead = vector / np.linalg.norm(vector)
    return ahead, np.array([-ahead[1], ahead[0]])


def way_around(position: np.ndarray, centre: np.ndarray, target: np.ndarray, clearance_m: float) -> np.ndarray:
    """The displacement [2] to make now, on a way from `position` to `target` that keeps off `centre`.

    Straight on if that keeps the clearance or the target is on the same side. Else to where the tangent from
    `position` meets the circle of that clearance, and from there on along it, between the corners of a polygon.
    """
    offset, straight = position - centre, target - position
    passed = np.clip(-offset @ straight / max(straight @ straight, 1e-12), 0.0, 1.0)
    turn = _wrap(_angle(target - centre) - _angle(offset))
    if np.linalg.norm(offset + passed * straight) > clearance_m or abs(turn) < DETOUR_TURN / 2.0:
        return straight
    tangent = np.arccos(min(1.0, clearance_m / np.linalg.norm(offset)))
    angle = _angle(offset) + np.sign(turn) * min(max(tangent, DETOUR_TURN), abs(turn))
    corner_m = clearance_m / np.cos(DETOUR_TURN / 2.0)
    return corner_m * np.array([np.cos(angle), np.sin(angle)]) - offset


def _angle(vector: np.ndarray) -> float:
    return float(np.arctan2(vector[1], vector[0]))


def _wrap(angle: float) -> float:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
