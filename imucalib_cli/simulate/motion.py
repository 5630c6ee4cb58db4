"""Motion of the systems: references of an arm and pushes of a free body, as functions of time."""

from __future__ import annotations

from bisect import bisect_right
from math import ceil
from typing import TYPE_CHECKING, Literal, TypeVar

import numpy as np

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.simulate.config import Arm, FreeBody

X = TypeVar("X", float, "Floats")


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
        t, position, number = arm.start_rest, start, 0
        while t < duration:
            again = len(arm.moves) > 1 and number >= len(arm.moves)
            move = arm.moves[1 + (number - 1) % (len(arm.moves) - 1) if again else number]
            target = np.radians(np.array(move.to_deg))
            self._begins.append(t)
            self._moves.append((move.seconds, position, target - position))
            t, position, number = t + move.seconds + move.rest, target, number + 1
            if number >= len(arm.moves) == 1:
                break

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
