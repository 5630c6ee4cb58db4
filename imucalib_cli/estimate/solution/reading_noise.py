"""Noise of the readings, and its effect on columns that are made of a reading.

It is in such a column and in the residual alike, as if the readings had more information.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from imucalib_cli.estimate.effects import PoseStream, Reading
from imucalib_cli.estimate.model.jacobian import plan_nodes
from imucalib_cli.estimate.model.kinematic_noise import kinematic_noise
from imucalib_cli.estimate.model.layout import places_of
from imucalib_cli.estimate.solution.algebra import inverse_of
from imucalib_cli.estimate.solution.spectrum import one_sided
from imucalib_cli.signals.samples import SENSORS, STANDARD_GRAVITY

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.estimate.model.design import Model
    from imucalib_cli.estimate.model.windows import Windowing

_LEAST_LEFT: Final = 0.1
"""Power of a sensor's noise that its errors leave: more than a filter can take away is rounding."""
_ALL_NOISE: Final = 0.8
"""Share of noise in a column from which it is all noise: noise is known to some per cent only."""


class NoiseSpectrum(Struct, frozen=True, eq=False):
    """Noise of each sensor's residuals, as the variance of white grid samples of that level."""

    frequency: tuple[Floats, Floats]
    """Hz, middle of each band that the windows let through, ascending: accelerometer, gyroscope."""
    power: tuple[Floats, Floats]
    """(m/s²)² and (rad/s)², in these bands."""

    @classmethod
    def white(cls, std: Floats) -> NoiseSpectrum:
        """Of samples with standard deviations (2,), m/s² and rad/s."""
        return cls((np.zeros(1), np.zeros(1)), (std[:1] ** 2, std[1:] ** 2))

    @classmethod
    def of(
        cls, model: Model, x: Floats, frequency: Floats, left: Floats, passed: Bools
    ) -> NoiseSpectrum:
        """The noise of a fit's windows, with errors x (n,) removed.

        ``left`` (2, bands) is the power of the residuals at ``frequency`` (bands,), Hz; ``passed``
        (2, bands) says which bands the windows let through.
        """
        # Without noise a power may be negative by rounding.
        power = np.maximum(left / _share_left(model, x, frequency), 0.0)
        accel, gyro = passed
        return cls((frequency[accel], frequency[gyro]), (power[0, accel], power[1, gyro]))

    def at(self, sensor: int, length: int, dt: float) -> tuple[Floats, Floats]:
        """Bins (F,) of a transform of so many samples, Hz, and a sensor's mean power in each.

        Beyond the bands it is that of the nearest. A bias that walks is far louder at the lowest
        frequencies than it is in the mean.
        """
        frequency = np.arange(length // 2 + 1) / (length * dt)
        edges = np.clip((np.arange(len(frequency) + 1) - 0.5) / (length * dt), 0.0, frequency[-1])
        known = self.frequency[sensor]
        f = np.unique(np.concatenate([known, edges]))
        power = np.interp(f, known, self.power[sensor])
        steps = 0.5 * np.diff(f) * (power[1:] + power[:-1])
        sums = np.concatenate([[0.0], np.cumsum(steps)])
        return frequency, np.asarray(np.diff(np.interp(edges, f, sums)) / np.diff(edges))


def calibration(
    model: Model, x: Floats, noise: NoiseSpectrum, weights: Floats, total: Floats
) -> tuple[Floats, Floats]:
    """The factor that turns noisy columns into the mean of what the true ones may be.

    A column that is all noise becomes zero and weighs nothing.

    Args:
        model: Of the windows.
        x: (n,), the errors that are removed.
        noise: Of the residuals.
        weights: (2,), windows over the square of the scale of their residuals.
        total: (n + 1, n + 1), sum of [e J]' [e J].

    Returns:
        T (n + 1, n + 1) of [e J] T', and the noise's part (n,) of their score.

    Source: regression calibration, Carroll et al., Measurement Error in Nonlinear Models, 2006,
        4.
    """
    added, score = _of_columns(model, x, noise, weights)
    _add_streams(model, x, noise, weights, (added, score))
    T = np.eye(len(total))
    noisy = np.flatnonzero(np.diag(added))
    if len(noisy):
        # A hundred-millionth of the weakest prior weighs nothing, and keeps rounding finite.
        weakest = np.maximum(model.layout.std_at(model.layout.bounds[:, 1]), 1e-12)
        inverse = inverse_of(total[1:, 1:] + np.diag(1e-8 / weakest**2))
        unit = np.sqrt(np.diag(added)[noisy])
        powers, axes = np.linalg.eigh(added[np.ix_(noisy, noisy)] / np.outer(unit, unit))
        root = unit[:, None] * axes * np.sqrt(np.maximum(powers, 0.0))
        shares, turn = np.linalg.eigh(root.T @ inverse[np.ix_(noisy, noisy)] @ root)
        root = root @ turn
        # J becomes J (I - A^-1 N), with N = root root' the noise in A.
        no_more_than_all = root / np.where(shares > _ALL_NOISE, shares, 1.0)
        T[1 + noisy, 1:] -= no_more_than_all @ (root.T @ inverse[noisy])
    return T, T[1:, 1:] @ score


def _of_columns(
    model: Model, x: Floats, noise: NoiseSpectrum, weights: Floats
) -> tuple[Floats, Floats]:
    """The noise's part of information (n, n) and score (n,) in columns made of a reading.

    It has the residuals' spectrum, less the noise of joints: motion that these do not report,
    vibration say, is in the reading too. Where poses are tracked the tracker is noisy, and the
    reading has the white noise of the sensor.
    """
    windowing, layout = model.windowing, model.layout
    plan, dt = windowing.plan, windowing.grid.dt
    nodes = plan_nodes(plan, dt)
    on_information = np.zeros((layout.size, layout.size))
    on_score = np.zeros(layout.size)
    own = list(layout.of(Reading))
    of_base = list(layout.of_base(Reading))
    tracked = windowing.trajectory.has_poses
    base = windowing.trajectory.base_readings or windowing.grid
    for (sensor, name), (errors, white, grid) in itertools.product(
        enumerate(SENSORS),
        (
            (own, np.array(windowing.grid.noise), windowing.grid),
            (of_base, windowing.base_noise, base),
        ),
    ):
        mean = grid.mean_reading[sensor]
        found = [
            (each.part, response)
            for each, effect in errors
            if effect.sensor == name and (response := effect.own_response(nodes.dt, mean)).any()
        ]
        if not found:
            continue
        pair = (nodes.second, nodes.first)[sensor]
        answers = np.concatenate([response for _, response in found])
        spectra, size = nodes.spectra(pair, answers)
        plain = plan.filters[sensor].average
        length = 2 * size
        frequency, seen = noise.at(sensor, length, dt)
        # Two IMUs share the noise by what each has of white noise.
        share = white[sensor] / max(windowing.noise[sensor], 1e-300) if of_base else 1.0
        least = np.minimum(white[sensor] ** 2 * windowing.grid.refine, seen)
        power = least
        if not tracked:  # twice the expected noise of the joints is subtracted
            place, tilt, turn = _of_kinematics(windowing, frequency)
            of_joints = (place + tilt, turn)[sensor]
            power = np.maximum(share**2 * (seen - 2.0 * of_joints), least)
        root = np.sqrt(power * weights[sensor] * one_sided(length) / length)
        root *= plan.noise_gains[sensor]
        in_columns = spectra * root
        margin = (size - len(plain)) // 2
        in_residual = np.fft.rfft(np.pad(plain, margin), length) * root
        places = places_of(part for part, _ in found)
        left = in_residual - np.tensordot(x[places], in_columns, axes=1)
        # A reading enters its residual with the other sign than its column: ``left`` is minus the
        # noise of the residual, which the columns of the unit contain too.
        in_columns[np.isin(places, layout.accel_scale)] -= left / 3.0
        flat = in_columns.reshape(len(places), -1).view(np.float64)
        # No column responds to noise of both sensors.
        on_information[np.ix_(places, places)] = flat @ flat.T
        on_score[places] = -(flat @ left.ravel().view(np.float64))
    return on_information, on_score


def _add_streams(
    model: Model, x: Floats, noise: NoiseSpectrum, weights: Floats, to: tuple[Floats, Floats]
) -> None:
    """Add that of the columns of tracked poses, which contain the noise of the tracker.

    Positions are seen by the accelerometer, quaternions by the gyroscope. The noise is what the
    samples show, or the residuals' noise without the white noise of the IMU, whichever is larger.
    """
    windowing, layout, (on_information, on_score) = model.windowing, model.layout, to
    plan, grid = windowing.plan, windowing.grid
    for sensor in range(2):
        plain = plan.filters[sensor].average
        length = 2 * len(plain)
        frequency, seen = noise.at(sensor, length, grid.dt)
        found = {}
        for each, stream in layout.of(PoseStream):
            if stream.what == "filter":
                gain = windowing.trajectory.change_gain(each.index, frequency)
                found[each.part.start + sensor] = -gain
            elif stream.what == "scale" and sensor == 0:
                found[each.part.start] = np.ones_like(frequency)
        if not found:
            continue
        places = np.array(list(found))
        responses = np.stack([*found.values()])
        in_residual = 1.0 + x[places] @ responses
        if sensor == 0:  # a residual is part of the column of the unit of length
            places = np.append(places, layout.accel_scale)
            responses = np.concatenate([responses, np.tile(in_residual / 3.0, (3, 1))])
        place, tilt, turn = _of_kinematics(windowing, frequency)
        own = grid.noise[sensor] ** 2 * grid.refine
        # Samples of a tracker that smooths hide its noise, a body that vibrates hides it too.
        hidden, shown = ((seen - own - tilt, place), (seen - own, turn))[sensor]
        power = np.maximum(hidden, shown) * weights[sensor] * one_sided(length) / length
        power *= (plan.noise_gains[sensor] * np.abs(np.fft.rfft(plain, length))) ** 2
        weighted = 3.0 * power * responses  # three axes have the same noise
        on_information[np.ix_(places, places)] += weighted @ responses.T
        on_score[places] += weighted @ in_residual


def _share_left(model: Model, x: Floats, frequency: Floats) -> Floats:
    """(2, F), share of the readings' noise, in power, after errors (n,) are removed.

    A mount that gives removes noise too. A share below a tenth says nothing about the noise.
    """
    dt = model.windowing.grid.dt
    turn = np.exp(-2j * np.pi * dt * np.outer(np.arange(7) - 3, frequency))
    left, means = np.ones((2, 3, len(frequency)), complex), model.windowing.grid.mean_reading
    for each, effect in model.layout.of(Reading):
        sensor = SENSORS.index(effect.sensor)
        response = effect.own_response(dt, means[sensor])
        left[sensor] -= np.tensordot(x[each.part], response, axes=1) @ turn
    return np.asarray(np.maximum((np.abs(left) ** 2).mean(axis=1), _LEAST_LEFT))


def _of_kinematics(windowing: Windowing, frequency: Floats) -> tuple[Floats, Floats, Floats]:
    """Noise of the kinematics in the residuals, as in :class:`NoiseSpectrum`, (F,) each.

    Returns:
        Of the accelerometer by the place and by gravity, which is seen tilted, (m/s²)²; of the
        gyroscope by the rotation, (rad/s)².
    """
    rotation, position = kinematic_noise(windowing.trajectory)
    dt, angular = windowing.grid.dt, (2.0 * np.pi * frequency) ** 2
    turned = np.full(len(frequency), rotation / 6.0)  # an angle fills two of nine elements' sum
    # The place is differentiated twice, the rotation once.
    tilt = STANDARD_GRAVITY**2 * turned
    return angular**2 * position / (3.0 * dt), tilt / dt, angular * turned / dt
