"""A wrong length is found; a contact drops out; a wrong everything is not trusted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib_cli.signals.interpolate import lagrange
from tests.estimate.estimate_arm import (
    INDUSTRIAL,
    LINKS,
    UNLIKELY,
    Moves,
    calibrated,
    make_log,
    nees,
    pose_error,
    sigma,
    taken_as_exact,
)
from tests.slow import slow_after

Floats = NDArray[np.float64]


def stretched(link: int, by: float = 1.01) -> tuple[tuple[float, float, float], ...]:
    """One link longer than it is."""
    x, z, turn = LINKS[link]
    return (*LINKS[:link], (by * x, z, turn), *LINKS[link + 1 :])


@pytest.mark.parametrize("link", slow_after(1, [1, 2]))
@pytest.mark.parametrize("seed", slow_after(1, range(4)))
def test_a_link_one_percent_long_is_found(link: int, seed: int) -> None:
    moves = Moves(seed=seed, seconds=40.0)
    right = make_log(moves).noisy(seed, INDUSTRIAL)
    wrong = replace(right, path=make_log(moves, links=stretched(link)).path)
    told, honest = calibrated(wrong), calibrated(right)
    for estimate in (told, honest):
        assert estimate.trusted
        assert np.all(np.abs(pose_error(estimate, right.mount)) < 4 * sigma(estimate))
    assert honest.findings == ()
    (found,) = told.findings
    assert (found.code, found.values["name"]) == ("unknown.found", "origin")
    values, stds = (np.array(found.values[key]) for key in ("values", "stds"))
    # True less URDF, along x of the link's frame.
    assert abs(values[0] + 0.01 * LINKS[link][0]) < 4 * stds[0]
    # Finding it costs little: taken as it is, the error would be ten sigmas of an exact robot.
    assert np.linalg.norm(sigma(told)[:3]) < 2 * np.linalg.norm(sigma(honest)[:3])
    believed = taken_as_exact(wrong)
    error = np.linalg.norm(pose_error(believed, wrong.mount)[:3])
    assert error > 5 * np.linalg.norm(pose_error(told, wrong.mount)[:3])
    assert error < 4 * np.linalg.norm(sigma(believed)[:3])


@pytest.mark.parametrize("seed", slow_after(1, range(3)))
def test_a_contact_drops_out(seed: int) -> None:
    log = make_log(Moves(seconds=30.0)).noisy(seed)
    rng = np.random.default_rng(seed)
    touched = (log.imu.t > 12.0) & (log.imu.t < 12.5)
    accel = log.imu.accel.copy()
    accel[touched] += 30.0 * rng.normal(size=(int(touched.sum()), 3))
    spoiled = calibrated(log.with_imu(log.imu.t, log.imu.gyro, accel))
    whole = calibrated(log)
    assert spoiled.trusted
    assert np.all(
        np.abs(pose_error(spoiled, log.mount) - pose_error(whole, log.mount)) < 0.5 * sigma(whole)
    )
    np.testing.assert_allclose(sigma(spoiled), sigma(whole), rtol=0.15)
    # Half a second and a window, in steps of a quarter of the window.
    assert 10 <= spoiled.residuals.windows_dropped <= 20
    assert whole.residuals.windows_dropped <= 2


def test_a_joint_zero_off_is_found_and_covered() -> None:
    log = make_log(Moves(seconds=40.0)).noisy(3, INDUSTRIAL)
    estimate = calibrated(log.with_joints(values=log.path.tracks[0].values + 0.01 * np.eye(6)[3]))
    assert estimate.trusted
    assert nees(estimate, log.mount) < UNLIKELY
    (found,) = estimate.findings
    assert (found.code, found.values["name"]) == ("unknown.found", "joint_zero")
    assert found.values["labels"] == ("j3",)
    # True less reported.
    assert found.values["values"] == pytest.approx((-0.01,), rel=0.02)


def test_held_joints_are_used_where_they_change() -> None:
    log = make_log(Moves(seconds=40.0)).noisy(3, INDUSTRIAL)
    values = log.path.tracks[0].values
    estimate = calibrated(log.with_joints(values=values[(np.arange(len(values)) // 10) * 10]))
    assert any("held" in each for each in estimate.warnings)
    assert np.linalg.norm(estimate.t_parent_imu - log.mount.t) < 5e-4


def test_one_stamp_of_zero_costs_one_sample() -> None:
    log = make_log(Moves(seconds=20.0)).noisy(3, INDUSTRIAL)
    t = log.imu.t + 1.7e9
    t[1000] = 0.0
    late = log.with_imu(t, log.imu.gyro, log.imu.accel)
    estimate = calibrated(late.with_joints(t=log.path.tracks[0].t + 1.7e9))
    assert estimate.trusted
    assert nees(estimate, log.mount) < UNLIKELY
    assert any("1 with stamps far from the log" in each for each in estimate.warnings)


def test_the_wrong_link_is_not_trusted() -> None:
    """The IMU sits on the flange, the URDF is told the forearm."""
    log = make_log().noisy(0)
    forearm = replace(log.path, steps=log.path.steps[:6])
    estimate = calibrated(replace(log, path=forearm))
    assert any("does not explain the gyroscope" in reason for reason in estimate.distrust)


def test_the_wrong_unit_of_acceleration_is_not_trusted() -> None:
    log = make_log().noisy(0)
    estimate = calibrated(log.with_imu(log.imu.t, log.imu.gyro, log.imu.accel / 9.80665))
    assert not estimate.trusted


def test_joints_that_are_stamped_tens_of_milliseconds_apart_are_not_trusted() -> None:
    """Each is found with its size; the first order that is modelled no longer is enough."""
    log = make_log(Moves(seed=4, seconds=24.0)).noisy(1, INDUSTRIAL)
    lead = np.array([0.02, 0.05, 0.03, 0.06, 0.02, 0.04])
    (track,) = log.path.tracks
    shifted = [
        lagrange(track.t, track.values, track.t + late)[:, column]
        for column, late in enumerate(lead)
    ]
    estimate = calibrated(log.with_joints(values=np.stack(shifted, axis=1)))
    assert not estimate.trusted
    named = {
        str(each.values["label"]): float(str(each.values["value"]))
        for each in estimate.findings
        if each.code == "unknown.implausible"
    }
    # Their mean is the time offset, and what each is off it is told.
    assert named
    for label, value in named.items():
        assert value == pytest.approx(lead.mean() - lead[int(label[1:])], abs=5e-3)
