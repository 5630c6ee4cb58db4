"""The even grid: what it copies, what it interpolates, what it leaves out."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from imucalib_cli.arrays import Floats
from imucalib_cli.errors import InputError
from imucalib_cli.signals.grid import ImuGrid, imu_grid
from imucalib_cli.signals.samples import ImuSamples
from imucalib_cli.signals.timing.stamps import EXACT_SECONDS
from imucalib_cli.signals.turning import compare_turning


def _signal(t: Floats) -> tuple[Floats, Floats]:
    phases = np.arange(3.0)
    return np.sin(3 * t[:, None] + phases), 5 * np.cos(2 * t[:, None] + phases)


def _grid(t: Floats, gyro: Floats, accel: Floats, refine: int = 1) -> ImuGrid:
    return imu_grid(ImuSamples(t=t, gyro=gyro, accel=accel), refine)


def test_samples_at_constant_rate_are_copied() -> None:
    t = 12.5 + np.arange(2000) / 200.0
    rng = np.random.default_rng(0)
    gyro, accel = rng.normal(size=(2, 2000, 3))
    grid = _grid(t, gyro, accel)
    np.testing.assert_array_equal(grid.gyro, gyro)
    np.testing.assert_array_equal(grid.accel, accel)
    np.testing.assert_allclose(grid.t, t, atol=1e-9)
    assert grid.usable.all()
    assert (grid.gaps, grid.refine) == (0, 1)


def test_lost_samples_are_bridged_and_the_rest_copied() -> None:
    t = np.arange(4000) / 200.0
    kept = np.random.default_rng(1).random(4000) >= 0.02
    kept[[0, -1]] = True
    gyro, accel = _signal(t)
    mark = accel + np.random.default_rng(2).normal(size=accel.shape) * 1e-3
    grid = _grid(t[kept], gyro[kept], mark[kept])
    assert len(grid.usable) == 4000
    np.testing.assert_array_equal(grid.accel[kept], mark[kept])
    np.testing.assert_allclose(grid.gyro, gyro, atol=1e-6)
    assert grid.usable.all()


def test_jittered_samples_are_interpolated_at_their_stamps() -> None:
    rng = np.random.default_rng(3)
    t = np.arange(4000) / 200.0 + rng.uniform(-1e-3, 1e-3, 4000)
    grid = _grid(t, *_signal(t))
    gyro, accel = _signal(grid.t)
    inner = slice(3, -3)
    # Stamps within EXACT_SECONDS of the grid are copied: off by that times the slope, 3 and 10.
    np.testing.assert_allclose(grid.gyro[inner], gyro[inner], atol=3 * EXACT_SECONDS)
    np.testing.assert_allclose(grid.accel[inner], accel[inner], atol=10 * EXACT_SECONDS)


def test_rows_in_a_gap_are_unusable_and_neighbours_clean() -> None:
    t = np.arange(4000) / 200.0
    kept = (t <= 5.0) | (t >= 6.3)
    gyro, accel = _signal(t)
    accel[t > 5.5] += 1000.0
    grid = _grid(t[kept], gyro[kept], accel[kept])
    np.testing.assert_array_equal(grid.usable, kept)
    assert grid.gaps == 1
    np.testing.assert_array_equal(grid.accel[kept], accel[kept])


def test_jittered_samples_are_not_mixed_across_a_gap() -> None:
    rng = np.random.default_rng(4)
    t = np.arange(4000) / 200.0 + rng.uniform(-1e-3, 1e-3, 4000)
    t = t[(t <= 5.0) | (t >= 6.3)]
    gyro, accel = _signal(t)
    late = t > 5.5
    accel[late] += 1000.0
    grid = _grid(t, gyro, accel)
    expected = _signal(grid.t)[1] + 1000.0 * (grid.t > 5.5)[:, None]
    inner = np.flatnonzero(grid.usable)[3:-3]
    np.testing.assert_allclose(grid.accel[inner], expected[inner], atol=10 * EXACT_SECONDS)


@pytest.mark.parametrize("refine", [2, 5])
def test_finer_grid_keeps_samples_and_interpolates_between(refine: int) -> None:
    t = np.arange(1000) / 100.0
    gyro, accel = _signal(t)
    grid = _grid(t, gyro, accel, refine)
    assert grid.dt == pytest.approx(0.01 / refine)
    np.testing.assert_array_equal(grid.gyro[::refine], gyro)
    np.testing.assert_allclose(grid.accel, _signal(grid.t)[1], atol=1e-6)
    assert len(grid.usable) == 999 * refine + 1


def test_stamps_spanning_years_are_refused() -> None:
    """Half of the samples are stamped with the time since boot: no grid of terabytes."""
    t, values = np.arange(1000) / 100, np.zeros((1000, 3))
    t[500:] += 1.7e9
    with pytest.raises(InputError, match=r"span 1\.7e\+09 s, but its 1000 samples fill"):
        _grid(t, values, values)
    trajectory: Any = SimpleNamespace(span=(0.0, 10.0))
    with pytest.raises(InputError, match="cannot fill"):
        compare_turning(t, values, trajectory, 1.0)
    t[500:] -= 1.7e9 - 60.0
    assert _grid(t, values, values).gaps == 1
