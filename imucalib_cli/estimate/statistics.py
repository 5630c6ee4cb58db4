"""What a log tells, summed: later questions are answered from it, without the log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.checks.specification import OtherWindow
    from imucalib_cli.estimate.details import Spectrum
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.estimate.solution.normal_equations import NormalEquations


@dataclass(frozen=True, kw_only=True, eq=False)
class LogStatistics:
    """The normal equations of one IMU in one log, and what its data add to them."""

    equations: NormalEquations
    options: MatchedOptions
    """Of the run."""
    parts: Floats
    """(p, n + 1, n + 1), normal matrices of [e J] of parts of equal duration; without rounding
    their sum is that of the equations, but where parts were heard that the fit left out."""
    edges: Floats
    """(p + 1,), s of the log."""
    spectra: tuple[Spectrum, Spectrum]
    """Accelerometer, gyroscope."""
    windows: tuple[OtherWindow, ...]
    """What other windows say of every component."""
    widened: Floats
    """(6, 6), what findings about the data add to the covariance of the pose."""
    offset_variance: float
    """s², what stamps add to the variance of the time offset."""
    seconds: float
    """Of the log."""
    clock_stepped: bool
    """Whether the clocks were set within the log: a drift is then what the step looks like."""
