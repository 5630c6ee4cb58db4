"""Block statistics: everything later steps need of the windows, whatever the log's length."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate import columns

if TYPE_CHECKING:
    from imucalib_cli.estimate.windows import WindowRows

Floats = NDArray[np.float64]

BLOCK_SECONDS = 4.0
"""Long against a window, so that blocks are nearly independent; short against a log."""


@dataclass(frozen=True, eq=False)
class BlockStatistics:
    """Sums of w x' J' J x over the windows of each block of time, one matrix per sensor."""

    accel: Floats
    """(B, columns.COUNT, columns.COUNT)."""
    gyro: Floats
    """(B, columns.COUNT, columns.COUNT)."""
    windows: Floats
    """(B,), sum of the weights."""

    def normal_matrix(self, accel_std: float, gyro_std: float) -> Floats:
        """Normal matrix of all blocks, the sensors weighted by their residuals' scale."""
        accel, gyro = self.accel.sum(axis=0), self.gyro.sum(axis=0)
        return np.asarray(accel / accel_std**2 + gyro / gyro_std**2)


def block_statistics(rows: WindowRows, weights: Floats, block: NDArray[np.intp]) -> BlockStatistics:
    """Accumulate the normal matrices.

    Args:
        rows: Of W windows.
        weights: (W,), robust weights in [0, 1].
        block: (W,), block number of each window, ascending.
    """
    count = int(block[-1]) + 1 if len(block) else 0
    edges = np.searchsorted(block, np.arange(count + 1))
    accel = np.zeros((count, columns.COUNT, columns.COUNT))
    gyro = np.zeros_like(accel)
    for index in range(count):
        part = slice(edges[index], edges[index + 1])
        root = np.sqrt(weights[part])[:, None, None]
        for rows_of, total in ((rows.accel, accel), (rows.gyro, gyro)):
            flat = (rows_of[part] * root).reshape(-1, columns.COUNT)
            total[index] = flat.T @ flat
    sums = np.bincount(block, weights, count)
    return BlockStatistics(accel, gyro, sums.astype(np.float64))
