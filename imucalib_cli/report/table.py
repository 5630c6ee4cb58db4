"""Measured and predicted values of the windows as a table that PlotJuggler and pandas read."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.layout import csv_text
from imucalib_cli.optional import optional
from imucalib_cli.signals.samples import AXES

if TYPE_CHECKING:
    from collections.abc import Mapping

    from imucalib_cli.arrays import Floats, Integers
    from imucalib_cli.estimate.details import WindowSeries

    Column = Floats | Integers


def stamps_ns(t: Floats, origin_ns: int) -> Integers:
    """Absolute stamps (N,), ns, of instants (N,), s of the log."""
    return origin_ns + np.round(t * 1e9).astype(np.int64)


def residual_table(windows: WindowSeries, origin_ns: int) -> dict[str, Column]:
    """One row for each instant, columns by name.

    ``time_s`` is seconds of the log. ``stamp_ns`` is the same instant by the IMU's clock, which has
    ``origin_ns`` at the log's second 0. The other columns are named
    <sensor>_<axis>_<measured|predicted|residual>_<unit>, IMU axes.
    """
    table: dict[str, Column] = {"time_s": windows.t, "stamp_ns": stamps_ns(windows.t, origin_ns)}
    for sensor, unit in (("accel", "m_s2"), ("gyro", "rad_s")):
        for axis, letter in enumerate(AXES):
            for what in ("measured", "predicted", "residual"):
                values = getattr(windows, f"{sensor}_{what}")[:, axis]
                table[f"{sensor}_{letter}_{what}_{unit}"] = values
    return {**table, "weight": windows.weight}


def as_csv(table: Mapping[str, Column]) -> bytes:
    """A table with its header, by commas."""
    columns = (values.tolist() for values in table.values())
    rows = (
        [f"{each:.10g}" if isinstance(each, float) else each for each in row]
        for row in zip(*columns, strict=True)
    )
    return csv_text(table, rows).encode()


def as_parquet(table: Mapping[str, Column]) -> bytes:
    """A table as Parquet; InputError where pyarrow is not installed."""
    arrow = optional("pyarrow", "Parquet needs", "parquet")
    parquet = optional("pyarrow.parquet", "Parquet needs", "parquet")
    buffer = io.BytesIO()
    parquet.write_table(arrow.table(dict(table)), buffer)
    return buffer.getvalue()
