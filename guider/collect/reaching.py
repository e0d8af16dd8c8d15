# pyright: reportAttributeAccessIssue=false
# (mujoco is a compiled module without type stubs)
"""Moving the hand of a Franka arm to where it should be: differential inverse kinematics, one step at a time.

The arm is Gymnasium-Robotics' in its kitchen: nine actions in [-1, 1], of which each moves the set point of one
position servo (7 joints, 2 fingers) away from where the joint is now.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from guider.support.physics import mujoco

STEP_S = 0.08
# An action of 1 puts the servo's set point 2 rad/s (the fingers': 2 m/s) times STEP_S ahead of the joint.
SET_POINT_RANGE = 2.0 * STEP_S
# Against its own damping the arm covers about half of the way to the set point within a step.
SERVO_SHARE = 0.5
SERVO_GAINS = np.array([870.0, 870.0, 870.0, 870.0, 120.0, 120.0, 120.0])  # Nm/rad
# The load of what the hand pushes is compensated in part, and never beyond these torques: a jammed hand must not push
# ever harder.
LOAD_SHARE = 0.7
LOAD_LIMITS = np.array([40.0, 40.0, 40.0, 40.0, 6.0, 6.0, 6.0])  # Nm
# Shares of what is missing that a step makes up for.
POSITION_GAIN = 0.9
ROTATION_GAIN = 0.5
TURN_LIMIT_RAD_S = 1.5
# Rotations count less than positions (1 rad as much as 0.3 m), and motion is damped near singular postures.
ROTATION_WEIGHT_M = 0.3
DAMPING = 0.02
POSTURE_GAIN = 0.05
LIMIT_MARGIN_RAD = 0.005
FINGER_LIMIT_M = 0.04
SQUEEZE = -0.5
"""The fingers' action where they are told to close: they press on whatever is between them."""


@dataclass(frozen=True)
class Hand:
    """Where the hand should be.

    position:  [3] of the point between the palm and the fingertips (the site `end_effector`), metres, world frame
    yaw_rad:   of the way the fingers point: 0 is ahead, along y; positive turns to the left, towards -x
    pitch_rad: positive points the fingers up
    grip_m:    of each finger from the middle: 0.04 is open; 0 closes and squeezes
    """

    position: np.ndarray
    yaw_rad: float = 0.0
    pitch_rad: float = 0.0
    grip_m: float = FINGER_LIMIT_M

    @property
    def rotation(self) -> np.ndarray:
        """[3, 3], its columns in the world frame: up, the way the fingers open, the way they point."""
        cos_yaw, sin_yaw = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        cos_pitch, sin_pitch = np.cos(self.pitch_rad), np.sin(self.pitch_rad)
        up = sin_yaw * sin_pitch, -cos_yaw * sin_pitch, cos_pitch
        opening = cos_yaw, sin_yaw, 0.0
        pointing = -sin_yaw * cos_pitch, cos_yaw * cos_pitch, sin_pitch
        return np.stack([up, opening, pointing], axis=1)

    def shifted(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Hand:
        """The same hand, moved by metres along the world's axes."""
        return replace(self, position=self.position + np.array([x, y, z]))

    def ahead(self, distance_m: float) -> Hand:
        """The same hand, moved the way its fingers point."""
        return replace(self, position=self.position + distance_m * self.rotation[:, 2])


@dataclass(frozen=True)
class Arm:
    """A view of the simulated arm; it changes as the simulation does."""

    model: mujoco.MjModel
    data: mujoco.MjData

    @property
    def position(self) -> np.ndarray:
        """[3] m, of the hand."""
        return self.data.site("end_effector").xpos.copy()

    def errors(self, hand: Hand) -> tuple[np.ndarray, np.ndarray]:
        """What is missing: [3] metres and [3] radians (axis times angle), both in the world frame."""
        rotation = self.data.site("end_effector").xmat.reshape(3, 3)
        quaternion, turn = np.zeros(4), np.zeros(3)
        mujoco.mju_mat2Quat(quaternion, (hand.rotation @ rotation.T).ravel())
        mujoco.mju_quat2Vel(turn, quaternion, 1.0)
        return hand.position - self.position, turn

    def jacobian(self) -> np.ndarray:
        """[6, 7]: joint motions -> motion (m) and turn (rad) of the hand."""
        move, turn = np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
        mujoco.mj_jacSite(self.model, self.data, move, turn, self.model.site("end_effector").id)
        return np.concatenate([move, turn])[:, :7]


def act(arm: Arm, hand: Hand, speed_m_s: float, turn_rad_s: float, posture: np.ndarray) -> np.ndarray:
    """[9] action in [-1, 1] that takes the arm a step towards `hand`, no faster than told.

    posture: [7] joint angles (rad) towards which the arm moves as far as that does not move the hand.

    The joints' set points lie ahead of them by the step wanted, over the share of it that the servo covers, plus the
    sag: what gravity and contact would push them back. Where a joint cannot keep up, all slow down alike.
    """
    move, turn = arm.errors(hand)
    motion = np.concatenate(
        [_shorten(POSITION_GAIN * move, speed_m_s * STEP_S), _shorten(ROTATION_GAIN * turn, turn_rad_s * STEP_S)]
    )
    step = joint_step(arm.jacobian(), motion, arm.data.qpos[:7], posture, arm.model.jnt_range[:7])
    load = np.clip(-LOAD_SHARE * arm.data.qfrc_constraint[:7], -LOAD_LIMITS, LOAD_LIMITS)
    sag = (arm.data.qfrc_bias[:7] + load) / SERVO_GAINS
    joints = (step / SERVO_SHARE + sag) / SET_POINT_RANGE
    fingers = (hand.grip_m - arm.data.qpos[7:9]) / SERVO_SHARE / SET_POINT_RANGE if hand.grip_m > 0 else [SQUEEZE] * 2
    return np.clip(np.concatenate([joints / max(1.0, np.abs(joints).max()), fingers]), -1.0, 1.0)


def joint_step(
    jacobian: np.ndarray, motion: np.ndarray, joints: np.ndarray, posture: np.ndarray, limits: np.ndarray
) -> np.ndarray:
    """[7] joint step (rad) that moves the hand by `motion`, [6] metres and radians, as nearly as it can.

    Damped least squares (Wampler 1986); what the hand leaves open pulls towards `posture`. Joints that would pass
    their `limits`, [7, 2], stand still, and the others are solved for again.
    """
    weights = np.array([1.0, 1.0, 1.0, *[ROTATION_WEIGHT_M] * 3])
    low, high = limits[:, 0] + LIMIT_MARGIN_RAD, limits[:, 1] - LIMIT_MARGIN_RAD
    free = np.ones(len(joints), bool)
    while True:
        task = weights[:, None] * jacobian[:, free]
        inverse = task.T @ np.linalg.inv(task @ task.T + DAMPING**2 * np.eye(6))
        pull = POSTURE_GAIN * (posture - joints)[free]
        step = np.zeros(len(joints))
        step[free] = inverse @ (weights * motion - task @ pull) + pull
        target = joints + step
        passing = ((target < low) & (step < 0)) | ((target > high) & (step > 0))
        if not passing.any():
            return step
        free &= ~passing


def _shorten(vector: np.ndarray, longest: float) -> np.ndarray:
    return vector * min(1.0, longest / max(np.linalg.norm(vector), 1e-12))
