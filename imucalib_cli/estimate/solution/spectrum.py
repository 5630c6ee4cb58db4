"""Statistics of a fit: normal matrices by sensor and frequency band, all that later steps need.

Windows overlap, so residuals of neighbouring windows are correlated, and the sensor's noise may be
coloured as well. With J the whitened rows and S the residuals' spectrum, the score J' e has the
covariance B = sum over frequencies of S(f) J(f)^H J(f). In a narrow band S is a level times the
mean response of the window's kernel, so the normal matrices of the bands are enough.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.estimate.model.windows import WINDOWS_PER_LENGTH, runs
from imucalib_cli.estimate.solution.robust import SCALE_FLOOR

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from imucalib_cli.arrays import Bools, Floats, Indices
    from imucalib_cli.estimate.model.windows import WindowPlan

    Rows = Iterable[tuple[slice, Floats]]
    """Of parts of the windows, in order, (w, 6, n + 1)."""


PARTS: Final = 48
"""Parts of equal duration of a log, which are compared with each other."""
PIECE: Final = 4096
"""Windows per transform: longer logs are averaged over pieces."""
_FIRST_BAND_BINS: Final = 4
"""Bins of the lowest band, of which the unknowns take their share."""
_BAND_RATIO: Final = 1.5
"""Of a band's edges: within it a kernel's response is nearly constant."""
_PASSED: Final = 0.03
"""Share of the largest response from which a band counts: below, it is rounding and aliases."""
_LEAST_FREEDOM: Final = 0.25
"""Share of a band's freedom that remains however many unknowns it determines. Tuned."""
_SHOCK: Final = 10.0
"""Medians of the size of residuals from which one is a shock. Tuned."""


class Spectrum(Struct, frozen=True, kw_only=True, eq=False):
    """Density of one sensor's residuals, as noise of its samples."""

    frequency: Floats
    """(B,), Hz, middle of each band that the filters pass."""
    density: Floats
    """(B,), m/s²/√Hz or rad/s/√Hz, one-sided."""
    own: float
    """Density of the sensor's own white noise, by how far samples stand off their neighbours."""


class BandSums:
    """Sums of X^H X over the frequencies of each band, sensor by sensor, for rows X in windows."""

    def __init__(self, slots: Indices, size: int) -> None:
        """For ``size`` channels; slots (W,) are places on the even grid of windows, ascending."""
        self._slots = slots
        self.length = _transform_length(slots)
        self._bands = _bands(self.length)
        self.sums = np.zeros((2, len(self._bands), size, size))
        self._buffer = np.zeros((6, size, self.length))
        self._filled: int | None = None

    def add(self, part: slice, rows: Floats) -> None:
        """Take the rows (w, 6, size) of some windows; parts come in order."""
        slots = self._slots[part]
        for piece, inside in runs(slots // self.length):
            if piece != self._filled:
                self._transform()
                self._filled = piece
            at = slots[inside] - piece * self.length
            self._buffer[:, :, at] = np.moveaxis(rows[inside], 0, 2)

    def finished(self) -> Floats:
        """(2, bands, size, size)."""
        self._transform()
        self._filled = None
        return self.sums * (2.0 / self.length)

    def _transform(self) -> None:
        if self._filled is None:
            return
        for row, values in enumerate(self._buffer):
            found = np.fft.rfft(values)
            found[:, [0, -1]] *= math.sqrt(0.5)  # these two bins are alone, all others pairs
            for index, band in enumerate(self._bands):
                flat = np.ascontiguousarray(found[:, band]).view(np.float64)
                self.sums[row // 3, index] += flat @ flat.T
        self._buffer[:] = 0.0

    def response(self, kernel: Floats, hop: int) -> Floats:
        """(bands,), mean of K(f)² of a symmetric kernel that is sampled every ``hop``."""
        correlation = np.correlate(kernel, kernel, mode="full")
        middle = len(correlation) // 2
        lags = np.arange(-(middle // hop), middle // hop + 1)
        f = np.fft.rfftfreq(self.length)
        folded = np.cos(2 * np.pi * np.outer(f, lags)) @ correlation[middle + lags * hop]
        return np.array([folded[band].mean() for band in self._bands])

    def freedom(self, windows: float) -> Floats:
        """(bands,), residual components of a sensor in each band."""
        per_bin = 3.0 * windows / self.length * one_sided(self.length)
        return np.array([per_bin[band].sum() for band in self._bands])


class Statistics(Struct, frozen=True, eq=False):
    """Whitened normal matrices of [e J] about one point of linearisation."""

    normal: Floats
    """(2, bands, n + 1, n + 1): sum of [e J]^H [e J] by sensor and band."""
    response: Floats
    """(2, bands), mean of |K(f)|² in each band."""
    freedom: Floats
    """(bands,), residual components of either sensor in each band."""
    uncalibrated_parts: Floats
    """(PARTS, n + 1, n + 1): of parts of the log, over bands and sensors, always of [e J]."""
    windows: float
    """Their number by weights."""
    calibration: Floats
    """(n + 1, n + 1), T, where ``normal`` is of [e J] T'."""
    noise_score: Floats
    """(n,), the part of J'e from noise of readings, which is in column and residual alike."""

    @property
    def information(self) -> Floats:
        """(n, n), A = J'J."""
        return np.asarray(self.normal[:, :, 1:, 1:].sum(axis=(0, 1)))

    @property
    def score(self) -> Floats:
        """(n,), J'e."""
        return np.asarray(self.normal[:, :, 1:, 0].sum(axis=(0, 1)) - self.noise_score)

    def calibrated(self, T: Floats, noise_score: Floats) -> Statistics:
        """Statistics of [e J] T', with the noise's part of their score."""
        return replace(
            self,
            normal=congruence(self.normal, T),
            calibration=T,
            noise_score=noise_score,
        )

    def levels(self, step: Floats, covariance: Floats) -> Floats:
        """Noise level in each band, (2, bands), after a step (n,); alike if the noise is white.

        The covariance (n, n) of the solution says how much the unknowns took of each band.
        """
        x = np.concatenate([[1.0], step])
        power = np.einsum("p,sbpq,q->sb", x, self.normal, x)
        lost = np.einsum("sbpq,pq->sb", self.normal[:, :, 1:, 1:], covariance)
        left = np.maximum(self.freedom - lost, _LEAST_FREEDOM * self.freedom)
        return np.asarray(power / np.maximum(left * self.response, 1e-300))

    def score_covariance(self, levels: Floats) -> Floats:
        """B, (n, n), of the score J' e for noise of these levels."""
        weights = levels * self.response
        return np.asarray(np.einsum("sb,sbpq->pq", weights, self.normal[:, :, 1:, 1:]))

    @property
    def passed(self) -> Bools:
        """(2, bands), whether the window's kernel lets a band through."""
        return np.asarray(self.response > _PASSED * self.response.max(axis=1, keepdims=True))

    def whiteness(self, levels: Floats) -> tuple[float, float]:
        """Loudest band over the median one, accelerometer and gyroscope; 1 is white."""
        accel, gyro = (
            float(each[passed].max() / max(float(np.median(each[passed])), 1e-300))
            for each, passed in zip(levels, self.passed, strict=True)
        )
        return accel, gyro


def congruence(matrices: Floats, T: Floats) -> Floats:
    """T A T' of matrices A (..., n, n); most rows of T are those of the identity."""
    rows = np.flatnonzero((np.eye(len(T)) != T).any(axis=1))
    found = matrices.copy()
    found[..., rows, :] = T[rows] @ matrices
    found[..., rows] = found @ T[rows].T
    return np.asarray(found)


def statistics(
    plan: WindowPlan, centres: Indices, rows: Rows, windows: float, size: int
) -> Statistics:
    """Sum the normal matrices of whitened rows [e J], of size n + 1, over the log.

    ``centres`` (W,) are grid indices, ascending; ``windows`` is their number by weights.
    """
    bands = BandSums(_slots(centres, plan.hop), size)

    def through_bands() -> Iterator[tuple[slice, Floats]]:
        for part, each in rows:
            bands.add(part, each)
            yield part, each

    parts = part_matrices(centres, through_bands(), size)
    response = np.stack([bands.response(pair.average, plan.hop) for pair in plan.filters])
    return Statistics(
        normal=bands.finished(),
        response=np.maximum(response, 1e-3 * response.max(axis=1, keepdims=True)),
        freedom=bands.freedom(windows),
        uncalibrated_parts=parts,
        windows=windows,
        calibration=np.eye(size),
        noise_score=np.zeros(size - 1),
    )


def part_numbers(centres: Indices) -> Indices:
    """(W,), number of the part of the log of each window, ascending."""
    return np.asarray((centres - centres[0]) * PARTS // (centres[-1] - centres[0] + 1))


def part_matrices(centres: Indices, rows: Rows, size: int) -> Floats:
    """Normal matrices (PARTS, n + 1, n + 1) of [e J] of the parts of the log."""
    numbers, sums = part_numbers(centres), np.zeros((PARTS, size, size))
    for part, both in rows:
        for index, inside in runs(numbers[part]):
            flat = both[inside].reshape(-1, size)
            sums[index] += flat.T @ flat
    return sums


def deviance(plan: WindowPlan, centres: Indices, residuals: Floats) -> float:
    """Twice the negative Whittle log-likelihood of residuals (W, 6), m/s² and rad/s, per window.

    Each band's level is profiled out; a constant that all models of a log share is left out.
    ``centres`` (W,) are grid indices, ascending, and may be thinned evenly.
    """
    hop = int(np.gcd.reduce(np.diff(centres)))
    sums = BandSums((centres - centres[0]) // hop, 1)
    held = np.concatenate([_bounded(residuals[:, :3]), _bounded(residuals[:, 3:])], axis=1)
    sums.add(slice(0, len(centres)), held[:, :, None])
    power, freedom = sums.finished()[:, :, 0, 0], sums.freedom(len(centres))
    total = 0.0
    for sensor, pair in enumerate(plan.filters):
        response = sums.response(pair.average, hop)
        passed = response > _PASSED * response.max()
        least = SCALE_FLOOR[sensor] ** 2 / float(pair.average @ pair.average)
        level = power[sensor, passed] / (freedom * response)[passed] + least
        total += float(freedom[passed] @ np.log(level))
    return total / len(centres)


def band_frequencies(plan: WindowPlan, centres: Indices, dt: float) -> Floats:
    """(bands,), Hz, middle of each band of :func:`statistics`; ``dt`` of the grid, s."""
    length = _transform_length(_slots(centres, plan.hop))
    f = np.fft.rfftfreq(length, plan.hop * dt)
    return np.array([f[band].mean() for band in _bands(length)])


def _slots(centres: Indices, hop: int) -> Indices:
    """(W,), places on the even grid of windows; long gaps, over which nothing agrees, shortened."""
    slots = (centres - centres[0]) // hop
    return np.cumsum(np.minimum(np.diff(slots, prepend=slots[:1]), 2 * WINDOWS_PER_LENGTH))


def _transform_length(slots: Indices) -> int:
    return min(PIECE, 1 << max(int(slots[-1]), 1).bit_length())


def _bounded(residuals: Floats) -> Floats:
    """Residuals with shocks, which no model describes, held at a multiple of the median."""
    size = np.linalg.norm(residuals, axis=1)
    most = _SHOCK * float(np.median(size))
    return np.asarray(residuals * np.minimum(1.0, most / np.maximum(size, 1e-300))[:, None])


def one_sided(length: int) -> Floats:
    """Multiplicity of each bin of a real transform in the full one."""
    weight = np.full(length // 2 + 1, 2.0)
    weight[0] = weight[-1] = 1.0
    return weight


def _bands(length: int) -> list[slice]:
    """Slices of frequency bins, each band wider than the one below."""
    top = length // 2 + 1
    edges = [0, min(_FIRST_BAND_BINS, top)]
    while edges[-1] < top:
        edges.append(min(max(int(edges[-1] * _BAND_RATIO), edges[-1] + _FIRST_BAND_BINS), top))
    if len(edges) > 2 and edges[-1] - edges[-2] < _FIRST_BAND_BINS:
        del edges[-2]
    return [slice(a, b) for a, b in itertools.pairwise(edges)]
