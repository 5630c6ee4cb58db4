"""Covariance that knows noise is coloured by our own filters, and maybe by the sensor's too.

Windows overlap, so residuals of neighbouring windows are correlated, and least squares' own
covariance is far too small. With J the whitened rows, A = J'J and S the residuals' spectrum,
the covariance of the estimate is the sandwich

    A^-1 B A^-1,    B = sum over frequencies of S(f) J(f)^H J(f).

S is found per sensor in a few bands: within a band it is a number times the known response
|K(f)|² of the window's kernel. Each band's number is corrected for what the fit took out of it,
the band's part of the trace of the hat matrix, so that few windows do not mean a small sigma.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Indices = NDArray[np.intp]

PIECE = 4096
"""Windows per transform: longer logs are averaged over pieces."""
_BAND_RATIO = 2
_FIRST_BAND_BINS = 4
"""Bins of the lowest band: fewer would leave nothing after the correction."""
_RESPONSE_FLOOR = 1e-3
"""Kernel response below which frequencies carry no information and no weight."""
_LEAST_FREEDOM = 0.25
"""Share of a band's freedom that is taken to remain, however many unknowns it determines."""
_ROUNDING = 1e-14
"""Eigenvalue of a scaled information that is no longer more than rounding."""


@dataclass(frozen=True, eq=False)
class ScoreSpectrum:
    """Whitened rows and residuals on the even grid of windows, ready to transform."""

    J: Floats
    """(W, 6, P), rows of the free components: accelerometer, then gyroscope."""
    e: Floats
    """(W, 6), residuals."""
    slots: Indices
    """(W,), place of each window on the even grid of windows, ascending."""
    responses: tuple[Floats, Floats]
    """|K(f)|² of the accelerometer's and the gyroscope's kernel on rfftfreq(PIECE)."""

    @property
    def size(self) -> int:
        """Length of the transforms."""
        span = int(self.slots[-1] - self.slots[0]) + 1
        return min(PIECE, 1 << max(span - 1, 1).bit_length())

    def shape(self, sensor: int) -> Floats:
        """The kernel's response on the transform's frequencies."""
        response = np.interp(
            np.fft.rfftfreq(self.size), np.fft.rfftfreq(PIECE), self.responses[sensor]
        )
        return np.asarray(np.maximum(response, _RESPONSE_FLOOR))

    def pieces(self, rows: Indices) -> list[tuple[Indices, Indices]]:
        """Rows in stretches no longer than a transform, with their slots in it."""
        start, size = int(self.slots[0]), self.size
        number = (self.slots[rows] - start) // size
        return [
            (rows[number == index], self.slots[rows[number == index]] - start - int(index) * size)
            for index in np.unique(number)
        ]

    def noise_levels(self, inverse: Floats) -> Floats:
        """Level of the noise in each band, (2, bands); 1 is white noise of unit residuals.

        Args:
            inverse: (P, P), A^-1.
        """
        size, bands = self.size, _bands(self.size)
        levels = np.zeros((2, len(bands)))
        weight = _one_sided(size)
        everything = np.arange(len(self.slots))
        for sensor in range(2):
            part, shape = slice(3 * sensor, 3 * sensor + 3), self.shape(sensor)
            power, freedom = np.zeros(len(bands)), np.zeros(len(bands))
            for rows, slots in self.pieces(everything):
                J_f = _transform(self.J[rows, part], slots, size)
                e_f = _transform(self.e[rows, part], slots, size)
                lost = np.einsum("fip,fiq,pq->f", J_f.conj(), J_f, inverse, optimize=True).real
                for index, band in enumerate(bands):
                    w = weight[band] / shape[band]
                    full = 3.0 * weight[band].sum() * len(rows) / size
                    power[index] += float(w @ (np.abs(e_f[band]) ** 2).sum(axis=1))
                    freedom[index] += max(
                        full - float(weight[band] @ lost[band]), _LEAST_FREEDOM * full
                    )
            levels[sensor] = power / np.maximum(freedom, 1e-300)
        return levels

    def score_covariance(self, levels: Floats, rows: Indices | None = None) -> Floats:
        """B, the covariance of sum J' e, (P, P).

        Args:
            levels: Of noise_levels.
            rows: Windows to sum over; all by default.
        """
        size, bands = self.size, _bands(self.size)
        weight = _one_sided(size)
        P = self.J.shape[2]
        B = np.zeros((P, P))
        for sensor in range(2):
            part = slice(3 * sensor, 3 * sensor + 3)
            density = self.shape(sensor) * weight
            for index, band in enumerate(bands):
                density[band] *= levels[sensor, index]
            root = np.sqrt(density)[:, None, None]
            for piece, slots in self.pieces(np.arange(len(self.slots)) if rows is None else rows):
                scaled = (_transform(self.J[piece, part], slots, size) * root).reshape(-1, P)
                B += scaled.real.T @ scaled.real + scaled.imag.T @ scaled.imag
        return B

    def whiteness(self, levels: Floats) -> tuple[float, float]:
        """Loudest band over the median one, per sensor, of bands the kernel lets through."""
        ratios = []
        for sensor in range(2):
            shape = self.shape(sensor)
            heard = [
                level
                for level, band in zip(levels[sensor], _bands(self.size), strict=True)
                if np.median(shape[band]) > 0.1
            ]
            ratios.append(
                float(max(heard) / max(np.median(heard), 1e-300)) if len(heard) > 1 else 1.0
            )
        return ratios[0], ratios[1]


def kernel_response(average: Floats, hop: int) -> Floats:
    """|K(f)|² of a kernel's weights, sampled every ``hop``: folded, on rfftfreq(PIECE)."""
    # Transforming the kernel's autocorrelation at the windows' own spacing folds it exactly.
    correlation = np.correlate(average, average, mode="full")
    middle = len(average) - 1
    lags = np.arange(-(middle // hop), middle // hop + 1)
    sampled = correlation[middle + lags * hop]
    f = np.fft.rfftfreq(PIECE)
    return np.asarray(np.cos(2 * np.pi * np.outer(f, lags)) @ sampled)


def _transform(values: Floats, slots: Indices, size: int) -> Complexes:
    """Unitary transform along time of rows at their slots, holes left zero."""
    dense = np.zeros((size, *values.shape[1:]))
    dense[slots] = values
    return np.asarray(np.fft.rfft(dense, axis=0) / np.sqrt(size))


def _one_sided(size: int) -> Floats:
    """How often each bin of a real transform stands in the full one."""
    weight = np.full(size // 2 + 1, 2.0)
    weight[0] = weight[-1] = 1.0
    return weight


def _bands(size: int) -> list[slice]:
    """Slices of frequency bins, each band twice as wide as the one below."""
    top = size // 2 + 1
    edges = [0, min(_FIRST_BAND_BINS, top)]
    while edges[-1] < top:
        edges.append(min(edges[-1] * _BAND_RATIO, top))
    if len(edges) > 2 and edges[-1] - edges[-2] < _FIRST_BAND_BINS:
        del edges[-2]
    return [slice(a, b) for a, b in itertools.pairwise(edges)]


def squared_distance(d: Floats, C: Floats) -> float:
    """Square d' C^-1 d, for a covariance that may be singular and of mixed units."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(C), 1e-300))
    values, vectors = np.linalg.eigh(C * np.outer(scale, scale))
    return float(np.sum((vectors.T @ (d * scale)) ** 2 / np.maximum(values, 1e-9)))


def inverse_of(A: Floats) -> Floats:
    """Inverse of a positive matrix of mixed units; stays positive where A is singular."""
    scale = 1.0 / np.sqrt(np.diag(A))
    values, vectors = np.linalg.eigh(A * np.outer(scale, scale))
    scaled = vectors * scale[:, None]
    return np.asarray((scaled / np.maximum(values, _ROUNDING * values[-1])) @ scaled.T)
