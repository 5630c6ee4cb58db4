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
