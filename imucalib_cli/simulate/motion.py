"""Motion of the systems as functions of time: an arm, a free body, and a legged robot.

A legged robot gets no feedback: feet move relative to a level frame that walks with the robot, the
trunk sways in that frame, and the joints follow from the geometry of the legs. The robot stays
upright because its feet stand wide.
"""

from __future__ import annotations

from bisect import bisect_right
from itertools import chain, cycle
from math import ceil
from typing import TYPE_CHECKING, Literal, TypeVar

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.robot.rotations import matrix_from_rpy

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.simulate.config import Arm, Foot, FreeBody, Gait, Legged

X = TypeVar("X", float, "Floats")
_KNOT = 0.004
"""s, between knots of the references' spline: steps last some fifty of them."""
_SWAYS = ("x", "y", "z", "roll", "pitch", "yaw")


def quintic(x: X) -> tuple[X, X]:
    """Rise from 0 to 1 over x in [0, 1], at rest at both ends: value and derivative by x."""
    return x**3 * (10 - x * (15 - 6 * x)), 30 * x**2 * (1 - x) ** 2


class ArmReference:
    """Joint references of an arm: quintic moves with standstill between them."""

    def __init__(self, arm: Arm, duration: float) -> None:
        """Compute the plan for ``duration`` s; it repeats from its second move on."""
        start = np.radians(np.array(arm.start_deg))
        self._begins = [0.0]
        self._moves: list[tuple[float, Floats, Floats]] = [(1.0, start, np.zeros_like(start))]
        t, position = arm.start_rest, start
        for move in chain(arm.moves, cycle(arm.moves[1:])):
            if t >= duration:
                break
            target = np.radians(np.array(move.to_deg))
            self._begins.append(t)
            self._moves.append((move.seconds, position, target - position))
            t, position = t + move.seconds + move.rest, target

    def __call__(self, t: float) -> tuple[Floats, Floats]:
        """Positions (J,), rad, and rates (J,), rad/s, at t."""
        number = bisect_right(self._begins, t) - 1
        seconds, position, difference = self._moves[max(number, 0)]
        value, rate = quintic(min(max((t - self._begins[number]) / seconds, 0.0), 1.0))
        return position + value * difference, (rate / seconds) * difference


class PushPlan:
    """Forces, torques and brake on a free body."""

    def __init__(self, body: FreeBody, profile: Literal["smooth", "hard"]) -> None:
        """Repeat the body's pushes in order, ramped or switched at once."""
        self._body = body
        self._ramp = body.ramp if profile == "smooth" else 0.0
        self._stop = body.stop if profile == "smooth" else 0.0
        self._period = body.push + body.stop + body.pause
        self._pushes = [(np.array(p.force), np.array(p.torque)) for p in body.pushes]
        self._nothing = np.zeros(3)

    def __call__(self, t: float) -> tuple[Floats, Floats, float]:
        """Force (3,), world axes, N; torque (3,), body axes, N m; brake, 1/s, at t."""
        since = t - self._body.start_rest
        if since < 0:
            return self._nothing, self._nothing, 0.0
        number, since = divmod(since, self._period)
        if since < self._body.push:
            force, torque = self._pushes[int(number) % len(self._pushes)]
            scale = self._rise(min(since, self._body.push - since), self._ramp)
            return scale * force, scale * torque, 0.0
        brake = self._body.brake * self._rise(since - self._body.push, self._stop)
        return self._nothing, self._nothing, brake

    @staticmethod
    def _rise(since: float, seconds: float) -> float:
        return 1.0 if since >= seconds else quintic(since / seconds)[0]


def instants(rate: float, duration: float, phase: float = 0.0) -> Floats:
    """Regular instants (k + phase) / rate within [0, duration], s."""
    count = ceil(duration * rate - phase + 1e-9)
    return np.asarray((np.arange(count) + phase) / rate, dtype=np.float64)


class GaitReference:
    """Joint references of a legged robot, by a cubic spline through its gait."""

    def __init__(self, legged: Legged, duration: float) -> None:
        """Compute the plan for ``duration`` s; walks repeat in their order.

        Raises:
            InputError: A foot is out of its leg's reach.
        """
        from scipy.interpolate import CubicSpline

        t = np.arange(-1, np.ceil(duration / _KNOT) + 2) * _KNOT
        self._begin, self._last = t[0], len(t) - 2
        self._pieces = np.ascontiguousarray(
            np.moveaxis(CubicSpline(t, joint_plan(legged, t)).c, 1, 0)
        )

    def __call__(self, t: float) -> tuple[Floats, Floats]:
        """Positions (J,), rad, and rates (J,), rad/s, at t."""
        number = min(max(int((t - self._begin) / _KNOT), 0), self._last)
        cubic, square, linear, constant = self._pieces[number]
        x = t - self._begin - number * _KNOT
        position = ((cubic * x + square) * x + linear) * x + constant
        return position, (3 * cubic * x + 2 * square) * x + linear


def joint_plan(legged: Legged, t: Floats) -> Floats:
    """Angles of all joints, rad, (N, J), at times t (N,), s.

    Raises:
        InputError: A foot is out of its leg's reach.
    """
    gait = legged.gait
    walk = _walk(gait, t)
    started = quintic(np.clip((t - gait.start_rest) / gait.blend, 0.0, 1.0))[0]
    shift, turn = _sway(gait, t, started)
    angles = np.zeros((len(t), len(legged.joints)))
    for foot in legged.feet:
        hip, thigh, knee = (legged.joints[number].xyz for number in legged.leg(foot))
        beside = hip[1] + thigh[1] + np.copysign(gait.wider, thigh[1])
        stand = np.array([hip[0], beside, -gait.height])
        in_level = stand + _step(gait, foot, stand, walk, t)
        in_trunk = ((in_level - shift)[:, None] @ turn)[:, 0]  # turn is R_level_trunk
        lengths = thigh[1], knee[2], foot.xyz[2]
        angles[:, legged.leg(foot)] = leg_angles(in_trunk - np.array(hip), lengths, foot.link)
    numbers = {joint.name: number for number, joint in enumerate(legged.joints)}
    for swing in gait.swings:
        wave = np.sin(2 * np.pi * (t - gait.start_rest) / swing.period)
        angles[:, numbers[swing.joint]] += np.radians(swing.amplitude_deg) * started * wave
    return angles


def leg_angles(p: Floats, lengths: tuple[float, float, float], name: str) -> Floats:
    """Angles of a leg's joints (N, 3), rad, that bring its foot to p (N, 3), m, knee backwards.

    Args:
        p: Place of the foot from the first joint, along the axes of the trunk.
        lengths: y from the first joint to the second, z from there to the third, z to the foot, m.
        name: Name of the leg, for the error message.

    Raises:
        InputError: The leg does not reach there.
    """
    beside, upper, lower = lengths[0], abs(lengths[1]), abs(lengths[2])
    x, y, z = p.T
    below = np.sqrt(np.maximum(y**2 + z**2 - beside**2, 0.0))
    cosine = (x**2 + below**2 - upper**2 - lower**2) / (2 * upper * lower)
    if (np.abs(cosine) > 1).any() or (y**2 + z**2 < beside**2).any():
        raise InputError(f"the gait takes the foot of {name} out of reach: step or sway less")
    first = np.arctan2(z, y) - np.arctan2(-below, beside)
    third = -np.arccos(cosine)
    second = np.arctan2(-x, below) - np.arctan2(
        lower * np.sin(third), upper + lower * np.cos(third)
    )
    return np.stack([(first + np.pi) % (2 * np.pi) - np.pi, second, third], axis=1)


def _walk(gait: Gait, t: Floats) -> Floats:
    """Forward and left, m/s, turn, rad/s, and lift, m, at each time; (N, 4)."""
    begins, before = gait.start_rest, np.zeros(4)
    value = np.zeros((len(t), 4))
    for walk in cycle(gait.walks):
        if begins >= t[-1]:
            break
        then = np.array([walk.forward, walk.left, np.radians(walk.turn_deg), walk.lift])
        risen, _ = quintic(np.clip((t - begins) / gait.blend, 0.0, 1.0))
        value += risen[:, None] * (then - before)
        begins, before = begins + walk.seconds, then
    return value


def _step(gait: Gait, foot: Foot, stand: Floats, walk: Floats, t: Floats) -> Floats:
    """Displacement of a foot from its place at rest, in the level frame, m; (N, 3)."""
    share = ((t - gait.start_rest) / gait.period - foot.phase) % 1.0
    forward, left, turn, lift = walk.T
    velocity = np.stack([forward - turn * stand[1], left + turn * stand[0]], axis=1)
    swings = share >= gait.stance
    u = np.where(swings, (share - gait.stance) / (1 - gait.stance), 0.0)
    # A standing foot moves back at the speed of the trunk. A swinging foot returns on a cubic that
    # has this speed at both ends.
    back = share / gait.stance - 0.5
    rate = (1 - gait.stance) / gait.stance
    along = 0.5 + rate * u - (3 + 3 * rate) * u**2 + (2 + 2 * rate) * u**3
    way = -np.where(swings, along, back) * gait.stance * gait.period
    up = lift * np.sin(np.pi * u)  # comes down at speed, as feet do
    return np.column_stack([way[:, None] * velocity, up])


def _sway(gait: Gait, t: Floats, started: Floats) -> tuple[Floats, Floats]:
    """Shift (N, 3), m, and rotation (N, 3, 3) of the trunk in the level frame."""
    value = np.zeros((len(t), 6))
    for sway in gait.sways:
        column = _SWAYS.index(sway.of)
        size = sway.amplitude if column < 3 else np.radians(sway.amplitude)
        value[:, column] += size * started * np.sin(2 * np.pi * (t - gait.start_rest) / sway.period)
    return value[:, :3], matrix_from_rpy(value[:, 3:])
