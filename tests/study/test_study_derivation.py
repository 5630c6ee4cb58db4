"""Figures 5 to 7 against the engine's own acceleration; any figure is the same bytes each time."""

import math
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats
from imucalib_cli.simulate.options import PhysicsOptions
from imucalib_cli.simulate.recording import Recording
from imucalib_cli.study.figures import draw_curve, logarithmic, new_figure, save_svg
from imucalib_cli.study.method_runs import wrong_guess
from imucalib_cli.study.recordings import clean_recording
from imucalib_cli.study.studies.derivation import (
    compared_by_matched,
    compared_by_paper,
)

PHYSICS = PhysicsOptions(imu_rate=250, robot_rate=250, duration=24)


def bar() -> Recording:
    return clean_recording("barbot", PHYSICS)


def acceleration_of_the_imu(recording: Recording) -> Floats:
    """World x acceleration at the IMU's instants, from the engine's state of the bar."""
    state = recording.state
    R = Rotation.from_quat(state.position[:, [4, 5, 6, 3]])
    omega, alpha = state.velocity[:, 3:], state.acceleration[:, 3:]
    arm = np.broadcast_to(recording.t_parent_imu, omega.shape)
    swing = np.cross(alpha, arm) + np.cross(omega, np.cross(omega, arm))
    return np.asarray((state.acceleration[:, :3] + R.apply(swing))[:, 0])


def test_both_filters_match_simulated_acceleration() -> None:
    truth = wrong_guess(bar(), 0.0, 0.0, 0)
    true = acceleration_of_the_imu(bar())
    for found, most in (
        (compared_by_paper(bar(), truth, 11, 0.0), 0.02),
        (compared_by_matched(bar(), truth, 11), 2e-4),
    ):
        at = np.searchsorted(bar().imu.t, found.t - 1e-9)
        inner = slice(20, -20)
        # smoothed over 40 ms; the bar's ramps take 300
        np.testing.assert_allclose(found.derived[inner], true[at][inner], atol=0.003)
        np.testing.assert_allclose(found.measured[inner], true[at][inner], atol=0.003)
        assert np.abs(found.mismatch[inner]).max() < most
        assert np.abs(true).max() > 0.15


def drawn(path: Path) -> bytes:
    figure, (left, right) = new_figure(1, 2)
    draw_curve(left, "error", [0.0, 0.1, 1.0], [1.0, math.nan, 2.0])
    draw_curve(left, "nothing", [0.1], [math.nan])
    draw_curve(left, "bound", [0.1, 1.0], [0.1, 0.2], linestyle="--", marker="")
    draw_curve(right, "more", [0.1, 1.0], [0.5, 0.0])
    for axes in (left, right):
        logarithmic(axes)
    counts = [[len(line.get_xdata()) for line in axes.get_lines()] for axes in (left, right)]  # type: ignore[arg-type]
    assert counts == [[1, 2], [1]]
    left.legend()
    save_svg(figure, path)
    return path.read_bytes()


def test_same_figure_has_identical_bytes(tmp_path: Path) -> None:
    first, second = drawn(tmp_path / "a.svg"), drawn(tmp_path / "b.svg")
    assert first == second
    root = ET.fromstring(first)
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert b"<dc:date>" not in first
