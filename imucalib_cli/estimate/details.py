"""Series and curves behind an estimate: for plots, files and programs.

Nothing here decides anything.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import asdict, replace

from imucalib_cli.estimate.checks.segments import parts_of_log
from imucalib_cli.estimate.model.state import Chain
from imucalib_cli.estimate.solution.spectrum import Spectrum
from imucalib_cli.process import one_thread
from imucalib_cli.signals.stretches import stretches_of

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.checks.segments import LogParts
    from imucalib_cli.estimate.checks.specification import Dependence
    from imucalib_cli.estimate.model.state import State
    from imucalib_cli.estimate.solution.fit import Fit
    from imucalib_cli.estimate.solution.normal_equations import LogStatistics
    from imucalib_cli.signals.samples import ImuSamples

_OFFSETS: Final = (1.0, 2.0, 4.0, 8.0, 16.0, 30.0)
"""Sigmas of the time offset, at which other offsets are tried on either side."""
_INSTANTS: Final = 20_000
"""About as many are drawn of a log, and at least its windows."""


class WindowSeries(Struct, frozen=True, kw_only=True, eq=False):
    """Measured readings and those predicted by the robot's motion, at W instants.

    Vectors are in the IMU's axes at the window's centre. Errors of sensor and robot are removed,
    biases too. Both sides pass the same filters, so the difference is noise.
    """

    t: Floats
    """(W,), s of the log, by the IMU's stamps."""
    accel_measured: Floats
    """(W, 3), specific force, m/s²."""
    accel_predicted: Floats
    """(W, 3)."""
    gyro_measured: Floats
    """(W, 3), rad/s."""
    gyro_predicted: Floats
    """(W, 3)."""
    weight: Floats
    """(W,), 0 to 1, of the nearest window of the fit; 0 was left out."""
    R_world_parent: Floats
    """(W, 3, 3), of the parent link at the same instants, errors of the robot removed."""
    p_world_parent: Floats
    """(W, 3), m; from the base IMU on, if there is one."""

    @property
    def left_out(self) -> list[tuple[float, float]]:
        """Stretches, s, whose windows the fit left out; each window extends half a step about."""
        if len(self.t) < 2:
            return []
        out = stretches_of(self.weight <= 0.0)
        half = 0.5 * float(np.median(np.diff(self.t)))
        starts, ends = self.t[out.first] - half, self.t[out.end - 1] + half
        return list(zip(starts.tolist(), ends.tolist(), strict=True))

    def with_gaps(self) -> WindowSeries:
        """The series with a row of nan in each gap, so that no line is drawn across."""
        steps = np.diff(self.t)
        usual = np.median(steps) if len(steps) else 0.0
        gaps = np.flatnonzero(steps > 2.5 * usual) + 1
        if not len(gaps):
            return self
        columns = asdict(self).items()
        filled = {name: np.insert(values, gaps, np.nan, axis=0) for name, values in columns}
        middle = 0.5 * (self.t[gaps - 1] + self.t[gaps])
        return replace(self, **filled | {"t": np.insert(self.t, gaps, middle)})

    @property
    def accel_residual(self) -> Floats:
        """(W, 3), measured less predicted, m/s²."""
        return self.accel_measured - self.accel_predicted

    @property
    def gyro_residual(self) -> Floats:
        """(W, 3), measured less predicted, rad/s."""
        return self.gyro_measured - self.gyro_predicted


class OffsetProfile(Struct, frozen=True, kw_only=True, eq=False):
    """How much worse the log fits with another time offset and all else solved again."""

    seconds: Floats
    """(K,), IMU stamp - robot stamp, ascending."""
    sigmas: Floats
    """(K,), square root of the rise of the chi-squared, in stated sigmas of the offset."""


class Details(Struct, frozen=True, kw_only=True, eq=False, dict=True):
    """Series and curves behind an estimate by the matched method, each computed when first read."""

    fit: Fit
    """By this log and this IMU alone."""
    state: State
    """Values of the unknowns at which the windows are; the fit's, or by several IMUs."""
    imu: ImuSamples
    """As used: in order, spikes bridged."""
    dependence: tuple[Dependence, ...]
    """The answer by other windows, where there are any."""
    log: LogStatistics
    """Of the fit."""
    std: Floats
    """(6,), m and rad, 1 sigma of the pose as stated."""

    @property
    def half_window(self) -> float:
        """s: extent of a window to either side of its instant."""
        windowing = self.fit.model.windowing
        return 0.5 * windowing.grid.dt * (windowing.plan.length - 1)

    @property
    def spectra(self) -> tuple[Spectrum, Spectrum]:
        """Accelerometer, gyroscope."""
        return self.log.spectra

    @cached_property
    @one_thread()
    def windows(self) -> WindowSeries:
        """Both sides of the equations."""
        return window_series(self.fit, self.state)

    @cached_property
    @one_thread()
    def stretches(self) -> LogParts | None:
        """None where the whole pose is held."""
        return parts_of_log(self.log, self.std)

    @cached_property
    @one_thread()
    def offset(self) -> OffsetProfile | None:
        """None where the time offset was given."""
        return _offset_profile(self.fit)


def window_series(fit: Fit, state: State) -> WindowSeries:
    """Both sides of the equations at every window of the fit, and at instants between them.

    The state may be another than the fit's.
    """
    windowing, plan = fit.model.windowing, fit.model.windowing.plan
    # The step is a fraction of the fit's own.
    wanted = max(_INSTANTS // max(len(fit.windows.centres), 1), 1)
    parts = [n for n in range(1, plan.hop // plan.node + 1) if plan.hop % n == 0 and n <= wanted]
    finer = replace(plan, hop=plan.hop // max(parts, default=1))
    model = replace(fit.model, windowing=replace(windowing, plan=finer))
    centres = model.centres(state)
    (residuals,) = model.residuals(state, centres)
    t = windowing.grid.t[centres]
    robot_times = windowing.trajectory.nearest_covered(model.robot_times(t, model.shifts(state)[0]))
    chain = Chain.of(windowing.trajectory, model.layout, state)
    frames = chain.path.frames(chain.values(robot_times))
    R_world_parent, p_world_parent = frames[-1]
    if chain.base is not None:  # without the free fall of the base
        p_world_parent = p_world_parent - frames[chain.path.base_step + 1][1]
    nearest = np.searchsorted(0.5 * (fit.windows.centres[1:] + fit.windows.centres[:-1]), centres)
    force = np.einsum("wji,wj->wi", R_world_parent, residuals.acceleration - state.gravity)
    # Residuals are predicted less measured, in the parent's axes.
    accel, gyro = force @ state.R, residuals.rate @ state.R
    return WindowSeries(
        t=t,
        accel_measured=accel - residuals.values[:, :3] @ state.R,
        accel_predicted=accel,
        gyro_measured=gyro - residuals.values[:, 3:] @ state.R,
        gyro_predicted=gyro,
        weight=fit.windows.weights[nearest],
        R_world_parent=R_world_parent,
        p_world_parent=p_world_parent,
    )


def spectra_of(fit: Fit) -> tuple[Spectrum, Spectrum]:
    """Density of a fit's residuals, accelerometer and gyroscope."""
    grid = fit.model.windowing.grid
    accel, gyro = (
        Spectrum(
            frequency=frequency,
            density=np.sqrt(2.0 * grid.dt * power),
            own=noise * float(np.sqrt(2.0 * grid.dt * grid.refine)),
        )
        for frequency, power, noise in zip(
            fit.windows.noise.frequency, fit.windows.noise.power, grid.noise, strict=True
        )
    )
    return accel, gyro


def _offset_profile(fit: Fit) -> OffsetProfile | None:
    """The misfit with the time offset held at values about the one found."""
    value, std = fit.of("time_offset")
    if not len(value) or std[0] <= 0.0:
        return None
    seconds = value[0] + std[0] * np.array([*(-n for n in _OFFSETS[::-1]), 0.0, *_OFFSETS])
    misfit = _misfits(fit, seconds)
    sigmas = np.sqrt(np.maximum(misfit - misfit[len(_OFFSETS)], 0.0))
    # The stated sigma knows the noise's colour, which the chi-squared does not.
    beside = sigmas[[len(_OFFSETS) - 1, len(_OFFSETS) + 1]].mean()
    return OffsetProfile(seconds=seconds, sigmas=sigmas / max(float(beside), 1e-9))


def _misfits(fit: Fit, offsets: Floats) -> Floats:
    """Least chi-squared, priors included, with the time offset held at each of some values (K,).

    Residuals there are exact; how they change with all else is as it is at the fit.
    """
    windows, equations, layout = fit.windows, fit.equations, fit.layout
    clock = np.arange(layout.size) == layout.part("time_offset").start

    def residuals(offset: float) -> Floats:
        there = replace(windows.at, x=np.where(clock, offset, windows.at.x))
        return windows.model.residuals(there, windows.centres)[0].values

    left = np.stack([residuals(offset) for offset in offsets.tolist()], axis=-1)
    changes = (left - windows.residuals.values[:, :, None]) * windows.whitening[:, :, None]
    left *= windows.whitening[:, :, None]
    moved = np.zeros((len(offsets), layout.size))
    for part, rows in windows.rows():
        J = rows[:, :, 1:].reshape(-1, layout.size)
        moved += changes[part].reshape(len(J), -1).T @ J
    moved = moved @ fit.statistics.calibration[1:, 1:].T / equations.level
    others = equations.problem(layout, fit.options).of(~clock[layout.free])
    _, inverse = others.solve(fit.u)
    P = others.precision(fit.u)
    gradients = others.score + P * others.offset + moved[:, layout.free & ~clock]
    squares = (left**2).sum(axis=(0, 1)) / equations.level + P @ others.offset**2
    return np.asarray(squares - ((gradients @ inverse) * gradients).sum(axis=1))
