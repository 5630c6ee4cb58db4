"""Stamps that reach over years: refused in a sentence, not answered with terabytes."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib_cli.errors import InputError
from imucalib_cli.signals.grid import imu_grid
from imucalib_cli.signals.trajectory import Trajectory
from imucalib_cli.signals.turning import compare_turning


def two_epochs(count: int = 1000) -> np.ndarray:
    """Half of the samples are stamped with the time since boot."""
    t = np.arange(count) / 100
    return np.concatenate([t[: count // 2], t[count // 2 :] + 1.7e9])


def test_a_grid_over_years_is_refused() -> None:
    t = two_epochs()
    values = np.zeros((len(t), 3))
    with pytest.raises(InputError, match=r"reach over 1\.7e\+09 s, of which its 1000 samples fill"):
        imu_grid(t, values, values)


def test_long_gaps_are_not_refused() -> None:
    t = np.concatenate([np.arange(500) / 100, np.arange(500) / 100 + 60])
    values = np.zeros((len(t), 3))
    assert imu_grid(t, values, values).gaps == 1


def test_bins_over_years_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    t = two_epochs()
    trajectory = object.__new__(Trajectory)
    monkeypatch.setattr(Trajectory, "span", (0.0, 10.0), raising=False)
    with pytest.raises(InputError, match="cannot fill"):
        compare_turning(t, np.zeros((len(t), 3)), trajectory, 1.0)
