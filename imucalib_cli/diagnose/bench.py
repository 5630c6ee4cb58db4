"""A bench for cheap fits: the same IMU against other kinematics, a few windows, few passes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.diagnose.ideal import idealised
from imucalib_cli.errors import InputError
from imucalib_cli.estimate import columns
from imucalib_cli.estimate.fit import MIN_WINDOWS, make_unknowns
from imucalib_cli.estimate.offset import coarse_time_offset
from imucalib_cli.estimate.prepare import clean_imu
from imucalib_cli.estimate.robust import SCALE_FLOOR, window_weights
from imucalib_cli.estimate.solve import Solution, State, refine, solve_globally
from imucalib_cli.estimate.windows import Windowing, WindowPlan, WindowRows
from imucalib_cli.signals.grid import ImuGrid, imu_grid
from imucalib_cli.signals.kernels import matched_filter
from imucalib_cli.signals.spikes import MAD_TO_STD, NOISE_OF_DEVIATION, deviation_from_neighbours
from imucalib_cli.signals.trajectory import CleanTrack, Trajectory, clean_track

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Correction
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.robot.path import KinematicPath, Track
    from imucalib_cli.signals.lag import Lag
    from imucalib_cli.signals.samples import ImuSamples

Floats = NDArray[np.float64]

MOST_SECONDS = 60.0
"""Longest stretch tried: the liveliest of the log."""
_ENOUGH_SECONDS, _ENOUGH_SAMPLES = 30.0, 30_000
"""A shorter one will do where the IMU is fast."""
_SHORTEST_WINDOW = 0.2
"""s: cheap windows are few, so they had better not be short."""
_PASSES = 2
_OFFSET_STEP = 1e-4
_TRIMMED = 0.05
"""Share of windows, the worst, that no score counts: contacts and shocks are no hypothesis."""
_LEAST_NOISE = (5.0 * SCALE_FLOOR[0], 5.0 * SCALE_FLOOR[1])
"""m/s² and rad/s: residuals of a window smaller than this are as good as none."""


@dataclass(frozen=True, eq=False)
class Trial:
    """How well one kinematic path explains the IMU."""

    path: KinematicPath
    windowing: Windowing
    rows: WindowRows
    weights: Floats
    solution: Solution
    time_offset: float
    left: tuple[float, float]
    """Residual of a window, m/s² and rad/s, trimmed root mean square."""
    total: tuple[float, float]
    """What there was to explain: acceleration without gravity, and rotation."""
    noise: tuple[float, float]
    """What the sensor's own white noise leaves in a window."""

    @property
    def shares(self) -> tuple[float, float]:
        """Share of the acceleration and of the rotation left unexplained."""
        accel, gyro = (
            left / max(total, 3.0 * noise)
            for left, total, noise in zip(self.left, self.total, self.noise, strict=True)
        )
        return accel, gyro

    @property
    def score(self) -> float:
        """Mean logarithm of the residuals over the noise: less is better."""
        return float(
            0.5
            * sum(
                np.log(np.hypot(left, noise) / noise)
                for left, noise in zip(self.left, self.noise, strict=True)
            )
        )


@dataclass(frozen=True, eq=False)
class Bench:
    """An IMU made ready for trials."""

    grid: ImuGrid
    options: MatchedOptions
    plan: WindowPlan
    noise: tuple[float, float]
    robot_ticks: bool
    _cleaned: dict[int, tuple[Track, CleanTrack]] = field(default_factory=dict)

    def trajectory(self, path: KinematicPath) -> Trajectory:
        """Trajectory of a path; each track is cleaned once.

        Raises:
            InputError: A track has too few usable samples.
        """
        for track in path.tracks:
            if id(track) not in self._cleaned:
                self._cleaned[id(track)] = (track, clean_track(track))
        tracks = tuple(self._cleaned[id(track)][1] for track in path.tracks)
        return Trajectory(path, tracks, use_ticks=self.robot_ticks)

    def lag(
        self, path: KinematicPath, most: float | None = None, about: float = 0.0
    ) -> tuple[float, Lag | None]:
        """Coarse time offset, s, and how alike the rates are in it, whatever the mount.

        Args:
            path: The kinematics to assume.
            most: Largest offset searched, s; default: of the options.
            about: Offset from which it is counted, s.
        """
        trajectory = self.trajectory(path)
        told = self.options.time_offset
        about = about if told is None else told
        most = self.options.max_offset if most is None else most
        shifted = replace(self.grid, t0=self.grid.t0 - about)
        offset, lag = coarse_time_offset(shifted, trajectory, most if told is None else 0.01)
        return about + (offset if told is None else 0.0), lag

    def trial(
        self,
        path: KinematicPath,
        *,
        near: Trial | None = None,
        offset: float | None = None,
        hopeless: float | None = None,
    ) -> Trial | None:
        """Fit the pose, biases, tilt and offset to a path on few windows.

        Args:
            path: The kinematics to assume.
            near: A trial of nearly the same path, from which to go on.
            offset: Time offset to begin with, s; default: searched.
            hopeless: Share of the rotation that, left over by the rows alone, ends the trial.

        Returns:
            None where the streams share too few windows, or where it is hopeless.
        """
        if near is not None:
            offset = near.time_offset
        try:
            windowing = Windowing(self.grid, self.trajectory(path), self.plan)
        except InputError:
            return None
        if offset is None:
            offset, _ = self.lag(path)
        if len(windowing.centres(offset)) < MIN_WINDOWS:
            return None
        return _fit(self, windowing, offset, near, hopeless)


def make_bench(
    samples: ImuSamples,
    options: MatchedOptions,
    *,
    seconds: float,
    imu_ticks: bool,
    robot_ticks: bool,
    corrections: tuple[Correction, ...] = (),
) -> Bench:
    """Prepare the liveliest stretch of an IMU for trials.

    Args:
        samples: As stamped.
        options: Of the fit that is to be explained.
        seconds: Its window.
        imu_ticks: Whether it read the IMU's stamps as ticks of a constant rate.
        robot_ticks: The same of the robot's.
        corrections: What it found to be wrong with the sensor.
    """
    # A pose known in one link is no guide in another; what it hides would be blamed on the chain.
    options = replace(options, pose=None)
    clean = clean_imu(samples)
    t = clean.ticks.t if imu_ticks and clean.ticks is not None else clean.t
    t, gyro, accel = idealised(t, clean.gyro, clean.accel, corrections)
    norms = [float(each.value[0]) for each in corrections if each.name == "gravity_norm"]
    options = replace(options, gravity_norm=norms[0] if norms else options.gravity_norm)
    part = _liveliest(t, gyro, accel)
    grid = imu_grid(t[part], gyro[part], accel[part])
    length = max(2 * round(max(seconds, _SHORTEST_WINDOW) / grid.dt / 2) + 1, options.degree + 4)
    length += 1 - length % 2
    plan = WindowPlan(
        length=length,
        hop=max(length // 2, 1),
        first_derivative=matched_filter(length, options.degree, 1, grid.dt),
        second_derivative=matched_filter(length, options.degree, 2, grid.dt),
    )
    noise = [
        max(_own_noise(values) * float(np.linalg.norm(pair.average)), least)
        for values, pair, least in (
            (accel[part], plan.second_derivative, _LEAST_NOISE[0]),
            (gyro[part], plan.first_derivative, _LEAST_NOISE[1]),
        )
    ]
    return Bench(grid, options, plan, (noise[0], noise[1]), robot_ticks)


def _liveliest(t: Floats, gyro: Floats, accel: Floats) -> slice:
    """The stretch with most rotation, and most acceleration beside it."""
    interval = float(np.median(np.diff(t)))
    seconds = min(max(_ENOUGH_SECONDS, _ENOUGH_SAMPLES * interval), MOST_SECONDS)
    if t[-1] - t[0] <= seconds:
        return slice(0, len(t))
    turning = ((gyro - np.median(gyro, axis=0)) ** 2).sum(axis=1)
    pushing = ((accel - np.median(accel, axis=0)) ** 2).sum(axis=1)
    life = turning / max(turning.mean(), 1e-12) + 0.2 * pushing / max(pushing.mean(), 1e-12)
    so_far = np.concatenate([[0.0], np.cumsum(life)])
    starts = np.arange(0, len(t), max(len(t) // 400, 1))
    ends = np.searchsorted(t, t[starts] + seconds)
    best = int(np.argmax(so_far[ends] - so_far[starts]))
    return slice(int(starts[best]), int(ends[best]))


def _own_noise(values: Floats) -> float:
    off = np.abs(deviation_from_neighbours(values))
    return float(np.median(off)) * MAD_TO_STD / NOISE_OF_DEVIATION


def _fit(
    bench: Bench, windowing: Windowing, offset: float, near: Trial | None, hopeless: float | None
) -> Trial | None:
    still = make_unknowns(bench.options, offset_free=False)
    moving = make_unknowns(bench.options, offset_free=bench.options.time_offset is None)
    rows = windowing.rows(offset, windowing.centres(offset))
    if hopeless is not None and _left_by_any_matrix(rows) > hopeless:
        return None
    weights = np.ones(len(rows.centres))
    if near is None:
        state = solve_globally(_normal_matrix(rows, weights, bench.noise), still).state
    else:
        state = near.solution.state
    for turn in range(_PASSES + 1):
        if turn > 0:
            centres = windowing.centres(offset)
            if len(centres) < MIN_WINDOWS:
                break
            rows = windowing.rows(offset, centres)
            weights = np.ones(len(rows.centres))
        for _ in range(2):
            weights = window_weights(rows, state.vector(), redescend=False)
            state = refine(_normal_matrix(rows, weights, bench.noise), still, state).state
        _set_offset_column(windowing, offset, rows, state)
        if turn == _PASSES or bench.options.time_offset is not None:
            break
        step = refine(_normal_matrix(rows, weights, bench.noise), moving, state).state
        reach = 0.25 * windowing.plan.length * windowing.grid.dt
        offset += float(np.clip(step.tau, -reach, reach))
        state = replace(step, tau=0.0)
    solution = refine(_normal_matrix(rows, weights, bench.noise), still, state)
    return Trial(
        path=windowing.trajectory.path,
        windowing=windowing,
        rows=rows,
        weights=weights,
        solution=solution,
        time_offset=offset,
        left=_left(rows, solution.state),
        total=_total(rows, solution.state),
        noise=bench.noise,
    )


def _left_by_any_matrix(rows: WindowRows) -> float:
    """Share of the robot's turning left by the best 3x3 matrix: no rotation leaves less."""
    known = rows.gyro[:, :, columns.ONE].reshape(-1)
    free = np.concatenate([rows.gyro[:, :, columns.R], rows.gyro[:, :, columns.BG]], axis=2)
    free = free.reshape(len(known), -1)
    left = known - free @ np.linalg.lstsq(free, known, rcond=1e-6)[0]
    turning = float(np.linalg.norm(known))
    return float(np.linalg.norm(left)) / turning if turning > 0.0 else 0.0


def _normal_matrix(rows: WindowRows, weights: Floats, noise: tuple[float, float]) -> Floats:
    """Normal matrix of all windows, the sensors weighted by their noise."""
    root = np.sqrt(weights)[:, None, None]
    total = np.zeros((columns.COUNT, columns.COUNT))
    for part, std in zip((rows.accel, rows.gyro), noise, strict=True):
        flat = (part * (root / std)).reshape(-1, columns.COUNT)
        total += flat.T @ flat
    return total


def _set_offset_column(windowing: Windowing, offset: float, rows: WindowRows, state: State) -> None:
    """Fill the column of the time offset by central difference."""
    x = state.vector()
    x[columns.TAU] = 0.0
    h = _OFFSET_STEP
    later = windowing.residuals(offset + h, rows.centres, x)
    earlier = windowing.residuals(offset - h, rows.centres, x)
    rows.accel[:, :, columns.TAU] = (later[0] - earlier[0]) / (2 * h)
    rows.gyro[:, :, columns.TAU] = (later[1] - earlier[1]) / (2 * h)


def trimmed_rms(values: Floats) -> float:
    """Root mean square size of rows, the largest few left out."""
    squares = np.sort((values**2).sum(axis=1))
    return float(np.sqrt(np.mean(squares[: max(int(len(squares) * (1 - _TRIMMED)), 1)])))


def _left(rows: WindowRows, state: State) -> tuple[float, float]:
    accel, gyro = rows.residuals(state.vector())
    return trimmed_rms(accel), trimmed_rms(gyro)


def _total(rows: WindowRows, state: State) -> tuple[float, float]:
    """Measured acceleration without gravity, as this fit sees it, and measured rotation."""
    x = state.vector()
    derived = rows.accel[:, :, columns.ONE] + rows.accel[:, :, columns.T] @ x[columns.T]
    measured = np.zeros((2, len(rows.centres), 3))
    measured[0] = derived - (rows.accel @ x)
    rest = np.zeros(columns.COUNT)
    rest[columns.R], rest[columns.BG] = x[columns.R], x[columns.BG]
    measured[1] = rows.gyro @ rest
    return trimmed_rms(measured[0]), trimmed_rms(measured[1])
