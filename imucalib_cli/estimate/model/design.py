"""Exact residuals of filter windows, for given values of the unknowns.

Per window, with D the Savitzky-Golay derivative and K its Peano kernel (docs/method.md):

    accelerometer  R_c' (D2 (p + R t) - K2*(R R_fs a) - g)       = noise
    gyroscope      vee(R_c' (D1 R - K1*(R [R_fs w]x)))           = noise

R, p is the parent link's pose in the world with the chain's errors removed, R_c the same at the
window's centre; a and w are the readings with the sensor's errors removed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from imucalib_cli.estimate.effects import Clock, Reading, Samples, less_errors
from imucalib_cli.estimate.model.state import Chain
from imucalib_cli.estimate.model.windows import blocks, in_windows, window_centres
from imucalib_cli.robot.rotations import skew, vee
from imucalib_cli.signals.kernels import MARGIN
from imucalib_cli.signals.samples import SENSORS

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats, Indices
    from imucalib_cli.estimate.model.layout import Layout
    from imucalib_cli.estimate.model.state import State
    from imucalib_cli.estimate.model.windows import Windowing, WindowPlan
    from imucalib_cli.signals.samples import Sensor

_NEIGHBOURS: Final = 3
"""Samples on either side by which a pose between samples is found. Residuals of an IMU at 50 Hz on
an arm whose moves take 1.6 s then differ from those of exact poses by 0.02 of a window's noise."""
BLOCK = 512
"""Windows computed at once: with fewer, half an hour takes longer; with more, more memory."""


class Model(Struct, frozen=True, eq=False):
    """The two streams through their windows, with the layout of the unknowns."""

    windowing: Windowing
    layout: Layout

    def centres(self, state: State) -> Indices:
        """Windows with every sample of both streams."""
        grid = self.windowing.grid
        usable = grid.usable.copy()
        for shift in set(self.shifts(state)):
            usable &= self.windowing.trajectory.covered(self.robot_times(grid.t, shift))
        return window_centres(self.windowing.plan, usable)

    @property
    def middle(self) -> float:
        """Instant from which ages are counted, s."""
        grid = self.windowing.grid
        return grid.t0 + 0.5 * grid.dt * (len(grid.usable) - 1)

    @property
    def seconds(self) -> float:
        """Duration of the log, s."""
        grid = self.windowing.grid
        return max(grid.dt * (len(grid.usable) - 1), grid.dt)

    def shifts(self, state: State) -> tuple[tuple[float, float], tuple[float, float]]:
        """Shift in the middle, s, and drift of the accelerometer's and the gyroscope's stamps."""
        found = np.array([[state.held_offset, 0.0], [state.held_offset, 0.0]])
        for each, effect in self.layout.of(Clock):
            found += state.x[each.part] * np.array([effect.accel, effect.gyro])
        (accel, accel_drift), (gyro, gyro_drift) = found.tolist()
        return (accel, accel_drift), (gyro, gyro_drift)

    def robot_times(self, t: Floats, shift: tuple[float, float]) -> Floats:
        """Robot stamps of the instants that a sensor stamps ``t``, s."""
        return np.asarray(t - shift[0] - shift[1] * (t - self.middle))

    def corrected(self, state: State, span: slice) -> tuple[Floats, Floats]:
        """Readings of a stretch of the grid with the sensor's errors removed."""
        grid = self.windowing.grid
        pad = slice(max(span.start - 1, 0), min(span.stop + 1, len(grid.usable)))
        inner = slice(span.start - pad.start, span.stop - pad.start)
        samples = self.samples(grid.accel[pad], grid.gyro[pad], pad.start, 1)
        accel, gyro = (self.less_errors(state, samples, sensor) for sensor in SENSORS)
        return accel[inner], gyro[inner]

    def less_errors(self, state: State, samples: Samples, sensor: Sensor) -> Floats:
        """(M, 3), readings of a sensor with its errors removed."""
        errors = ((effect, state.x[each.part]) for each, effect in self.layout.of(Reading))
        return less_errors(errors, samples, sensor)

    def samples(self, accel: Floats, gyro: Floats, first: int, every: int) -> Samples:
        """Readings at grid samples from ``first``, every so many."""
        dt = self.windowing.grid.dt
        index = first + every * np.arange(len(accel))
        age = np.asarray((dt * index - (self.middle - self.windowing.grid.t0)) / self.seconds)
        return Samples(accel=accel, gyro=gyro, age=age, dt=dt * every)

    def residuals(
        self, state: State, centres: Indices, plans: tuple[WindowPlan, ...] = ()
    ) -> list[Residuals]:
        """Exact residuals of windows about centres (W,), ascending, for each of some plans.

        The plan is the model's own by default. Residuals of windows that do not fit are zero.
        """
        plans = plans or (self.windowing.plan,)
        grid = self.windowing.grid
        chain = Chain.of(self.windowing.trajectory, self.layout, state)
        shift_a, shift_g = self.shifts(state)
        reach = max(plan.length // 2 + MARGIN for plan in plans)
        found = [Residuals(*(np.zeros((len(centres), n)) for n in (6, 3, 3))) for _ in plans]
        for part in blocks(centres, self.windowing.plan.hop, BLOCK):
            first, last = int(centres[part][0]), int(centres[part][-1])
            span = slice(max(first - reach, 0), min(last + reach + 1, len(grid.usable)))
            local = centres[part] - span.start
            accel, gyro = self.corrected(state, span)
            R, p, R_gyro = self._poses(chain, span, shift_a, shift_g)
            place = p - p[0] + R @ state.t
            force = np.einsum("nij,nj->ni", R, accel @ state.R.T)
            measured = (R_gyro @ skew(gyro @ state.R.T)).reshape(-1, 9)
            flat = R_gyro.reshape(-1, 9)
            for plan, residuals in zip(plans, found, strict=True):
                room = np.minimum(local, len(p) - 1 - local) >= plan.length // 2 + MARGIN
                where, at = part.start + np.flatnonzero(room), local[room]
                once, twice = plan.first_derivative, plan.second_derivative
                # Over the robot's time, not the IMU's.
                pushed = in_windows(place, twice.derivative, at) / (1.0 - shift_a[1]) ** 2
                turned = in_windows(flat, once.derivative, at) / (1.0 - shift_g[1])
                left = pushed - in_windows(force, twice.average, at) - state.gravity
                turns_left = turned - in_windows(measured, once.average, at)
                back, back_gyro = (np.swapaxes(each[at], 1, 2) for each in (R, R_gyro))
                residuals.acceleration[where] = pushed
                residuals.rate[where] = vee(back_gyro @ turned.reshape(-1, 3, 3))
                residuals.values[where, :3] = np.einsum("wij,wj->wi", back, left)
                residuals.values[where, 3:] = vee(back_gyro @ turns_left.reshape(-1, 3, 3))
        return found

    def _poses(
        self, chain: Chain, span: slice, accel: tuple[float, float], gyro: tuple[float, float]
    ) -> tuple[Floats, Floats, Floats]:
        """R_world_parent and p_world_parent for the accelerometer, and R for the gyroscope.

        Over a span of the grid; their stamps have each a shift, s, and a drift. The latter is a
        rotation up to the error of a polynomial in each of its entries.
        """
        grid, near = self.windowing.grid, self.windowing.trajectory.nearest_covered

        def poses(first: int, end: int, shift: tuple[float, float]) -> tuple[Floats, Floats]:
            stamps = np.asarray(grid.t0 + grid.dt * np.arange(first, end))
            return chain.poses(near(self.robot_times(stamps, shift)))

        if gyro == accel or gyro[1] != accel[1]:
            R, p = poses(span.start, span.stop, accel)
            return R, p, R if gyro == accel else poses(span.start, span.stop, gyro)[0]
        later = (accel[0] - gyro[0]) / (grid.dt * (1.0 - accel[1]))
        whole = round(later)
        beyond = abs(whole) + _NEIGHBOURS
        R, p = poses(span.start - beyond, span.stop + beyond, accel)
        # Polynomials through its neighbours: a chain takes ten times as long.
        places = np.arange(-_NEIGHBOURS, _NEIGHBOURS + 1)
        powers = np.vander(places, increasing=True)
        weights = np.linalg.solve(powers.T, (later - whole) ** np.arange(len(places)))
        count = span.stop - span.start
        R_gyro = np.zeros((count, 3, 3))
        for weight, place in zip(weights.tolist(), (beyond + whole + places).tolist(), strict=True):
            R_gyro += weight * R[place : place + count]
        return R[beyond : beyond + count], p[beyond : beyond + count], R_gyro


class Residuals(Struct, frozen=True, eq=False):
    """Residuals of windows, and how much the windows move."""

    values: Floats
    """(W, 6): accelerometer m/s², gyroscope rad/s, parent frame at the window's centre."""
    acceleration: Floats
    """(W, 3), of the IMU's place by the kinematics, m/s², world axes."""
    rate: Floats
    """(W, 3), of the parent link by the kinematics, rad/s."""

    def of(self, rows: Indices) -> Residuals:
        """Of some of the windows."""
        return Residuals(self.values[rows], self.acceleration[rows], self.rate[rows])

    @property
    def motion(self) -> Floats:
        """(W,), how much each window moves, (m/s²)²: turns count as a metre away."""
        turning = (self.rate**2).sum(axis=1) ** 2
        return np.asarray((self.acceleration**2).sum(axis=1) + turning)

    @property
    def turning(self) -> float:
        """rad/s, root mean square rate."""
        return float(np.sqrt(np.mean((self.rate**2).sum(axis=1))))
