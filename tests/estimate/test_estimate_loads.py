"""What joints carry, against the motion of a planar arm in closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib_cli.estimate.model.layout import lay_out
from imucalib_cli.estimate.model.loads import Loads
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.robot.path import FixedStep, JointStep, KinematicPath, Track
from imucalib_cli.signals.trajectory import Trajectory

Floats = NDArray[np.float64]

GRAVITY = 9.81
UPPER, LOWER = 0.4, 0.3
"""m, lengths of the arm."""


def positions(t: Floats) -> Floats:
    """Of shoulder and elbow about y, (M, 2), rad."""
    return np.stack([0.5 * np.sin(2.0 * t), 0.4 * np.cos(1.7 * t)], axis=1)


def places(t: Floats) -> tuple[Floats, Floats]:
    """Of elbow and hand, (M,) each: x + i z, m."""
    shoulder, elbow = positions(t).T
    upper = UPPER * np.exp(-1j * shoulder)
    return upper, upper + LOWER * np.exp(-1j * (shoulder + elbow))


def torque(t: Floats, about: Floats | float, place: int) -> Floats:
    """(M,), Nm, about y, by weight and inertia of 1 kg at the elbow (0) or in the hand (1)."""
    step = 1e-3
    before, here, after = (places(t + shift)[place] for shift in (-step, 0.0, step))
    force = -1j * GRAVITY - (after - 2.0 * here + before) / step**2
    arm = here - about
    return np.asarray(arm.imag * force.real - arm.real * force.imag)


@pytest.mark.parametrize("gap", [(0.0, 0.0), (4.0, 5.0)])
def test_load_is_by_weight_and_inertia(gap: tuple[float, float]) -> None:
    """Of the mass behind the shoulder a quarter is at the elbow, the rest in the hand."""
    t = np.arange(0.0, 10.0, 0.01)
    t = t[(t < gap[0]) | (t >= gap[1])]
    y = np.array([0.0, 1.0, 0.0])
    upper: dict[str, Any] = {"mass": 0.7, "centre": np.array([UPPER, 0.0, 0.0])}
    lower: dict[str, Any] = {"mass": 2.1, "centre": np.array([LOWER, 0.0, 0.0])}
    path = KinematicPath(
        world="base",
        parent="hand",
        steps=(
            JointStep(name="shoulder", kind="revolute", axis=y, track=0, column=0, **upper),
            FixedStep(R=np.eye(3), p=np.array([UPPER, 0.0, 0.0])),
            JointStep(name="elbow", kind="revolute", axis=y, track=0, column=1, **lower),
            FixedStep(R=np.eye(3), p=np.array([LOWER, 0.0, 0.0])),
        ),
        tracks=(
            Track(name="q", kind="joints", t=t, values=positions(t), names=("shoulder", "elbow")),
        ),
    )
    trajectory = Trajectory.of(path)
    layout = lay_out(trajectory, MatchedOptions())
    loads = Loads.of(trajectory, layout, np.array([0.0, 0.0, -GRAVITY]), np.zeros(layout.size))
    shoulder = 0.25 * torque(t, 0.0, 0) + 0.75 * torque(t, 0.0, 1)
    elbow = torque(t, places(t)[0], 1)
    found = loads.at(t)
    inner = (t > 0.2) & (t < 9.8) & (np.abs(t - gap[0]) > 0.2) & (np.abs(t - gap[1]) > 0.2)
    np.testing.assert_allclose(found["shoulder"][inner], shoulder[inner], atol=0.01)
    np.testing.assert_allclose(found["elbow"][inner], elbow[inner], atol=0.01)
    # At ends and gaps nothing jumps: a jump would look like a shock of the arm.
    np.testing.assert_allclose(found["shoulder"], shoulder, atol=0.3)
    assert np.abs(np.diff(found["shoulder"] - shoulder))[np.diff(t) < 0.1].max() < 0.05
