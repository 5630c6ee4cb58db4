"""Statistics of a fit: normal matrices by sensor and frequency band, all that later steps need.

Windows overlap, so residuals of neighbouring windows are correlated, and the sensor's noise may be
coloured as well. With J the whitened rows and S the residuals' spectrum, the score J' e has the
covariance B = sum over frequencies of S(f) J(f)^H J(f). In a narrow band S is a level times the
mean response of the window's kernel, so the normal matrices of the bands are enough.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.estimate.windows import WindowPlan

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

PIECE: Final = 4096
"""Windows per transform: longer logs are averaged over pieces."""
_FIRST_BAND_BINS: Final = 4
"""Bins of the lowest band: fewer would leave nothing after the unknowns took their share."""
_BAND_RATIO: Final = 1.5
"""Of a band's edges: within it a kernel's response is nearly constant."""
_RESPONSE_FLOOR: Final = 1e-3
"""Kernel response below which frequencies carry no information and no weight."""
_LEAST_FREEDOM: Final = 0.25
"""Share of a band's freedom that is taken to remain, however many unknowns it determines."""


@dataclass(frozen=True, eq=False)
class Statistics:
    """Whitened normal matrices of [e J] about one point of linearisation."""

    normal: Floats
    """(2, bands, n + 1, n + 1): sum of [e J]^H [e J] by sensor and band."""
    response: Floats
    """(2, bands), mean of |K(f)|² in each band."""
    freedom: Floats
    """(2, bands), residual components in each band."""
    windows: int
    """With any weight."""

    @property
    def information(self) -> Floats:
        """(n, n), A = J'J."""
        return np.asarray(self.normal[:, :, 1:, 1:].sum(axis=(0, 1)))

    @property
    def score(self) -> Floats:
        """(n,), J'e."""
        return np.asarray(self.normal[:, :, 1:, 0].sum(axis=(0, 1)))

    def levels(self, step: Floats, covariance: Floats) -> Floats:
        """Noise level in each band, (2, bands), after a step; 1 is white noise of the given scale.

        Args:
            step: (n,).
            covariance: (n, n), of the solution, for what the unknowns took of each band.
        """
        x = np.concatenate([[1.0], step])
        power = np.einsum("p,sbpq,q->sb", x, self.normal, x)
        lost = np.einsum("sbpq,pq->sb", self.normal[:, :, 1:, 1:], covariance)
        left = np.maximum(self.freedom - lost, _LEAST_FREEDOM * self.freedom)
        return np.asarray(power / np.maximum(left * self.response, 1e-300))

    def score_covariance(self, levels: Floats) -> Floats:
        """B, (n, n), of the score J' e for noise of these levels."""
        return np.einsum("sb,sbpq->pq", levels * self.response, self.normal[:, :, 1:, 1:])

    def deviance(self, levels: Floats) -> float:
        """Twice the negative Whittle log-likelihood with each band's level profiled out."""
        heard = self.response > 0.03 * self.response.max(axis=1, keepdims=True)
        return float(np.sum(self.freedom[heard] * np.log(np.maximum(levels[heard], 1e-300))))


def statistics(
    plan: WindowPlan,
    centres: Indices,
    residuals: Floats,
    columns: Iterator[tuple[slice, Floats]],
    size: int,
    weights: Floats,
    scales: tuple[float, float],
) -> Statistics:
    """Accumulate the normal matrices over pieces of the log.

    Args:
        plan: Of the windows.
        centres: (W,), grid indices, ascending.
        residuals: (W, 6).
        columns: Of parts of the windows, (w, 6, n), in order.
        size: n.
        weights: (W,), robust weights in [0, 1].
        scales: Residual scale of a window, accelerometer m/s², gyroscope rad/s.
    """
    slots = (centres - centres[0]) // plan.hop
    length = min(PIECE, 1 << max(int(slots[-1]), 1).bit_length())
    bands = _bands(length)
    root = np.sqrt(weights)[:, None] * _whitening(plan, scales)
    normal = np.zeros((2, len(bands), size + 1, size + 1))
    buffer = np.zeros((6, size + 1, length))
    filled = -1
    for part, J in columns:
        both = np.concatenate([residuals[part, :, None], J], axis=2) * root[part, :, None]
        for piece in np.unique(slots[part] // length):
            if piece != filled:
                _add_piece(normal, buffer, bands, size)
                buffer[:] = 0.0
                filled = int(piece)
            inside = slots[part] // length == piece
            buffer[:, :, slots[part][inside] - piece * length] = np.moveaxis(both[inside], 0, 2)
    _add_piece(normal, buffer, bands, size)
    count = int(np.count_nonzero(weights))
    share = weights.sum() / length
    per_bin = _one_sided(length)
    freedom = np.array([3.0 * share * per_bin[band].sum() for band in bands])
    response = np.stack([_kernel_response(pair.average, plan.hop, length) for pair in _pairs(plan)])
    mean = np.stack([response[:, band].mean(axis=1) for band in bands], axis=1)
    return Statistics(normal, mean, np.stack([freedom, freedom]), count)


def _pairs(plan: WindowPlan):  # type: ignore[no-untyped-def]
    return plan.second_derivative, plan.first_derivative


def _whitening(plan: WindowPlan, scales: tuple[float, float]) -> Floats:
    gains = np.array(plan.noise_gains) / np.array(scales)
    return np.repeat(gains, 3)


def _add_piece(normal: Floats, buffer: Floats, bands: list[slice], size: int) -> None:
    if not buffer.any():
        return
    length = buffer.shape[2]
    for sensor in range(2):
        for axis in range(3):
            found = np.fft.rfft(buffer[3 * sensor + axis]) * np.sqrt(_one_sided(length) / length)
            for index, band in enumerate(bands):
                real = np.ascontiguousarray(found[:, band]).view(np.float64)
                normal[sensor, index] += real @ real.T


def _kernel_response(average: Floats, hop: int, length: int) -> Floats:
    """|K(f)|² of a kernel's weights, sampled every ``hop``: folded, on rfftfreq(length)."""
    correlation = np.correlate(average, average, mode="full")
    middle = len(average) - 1
    lags = np.arange(-(middle // hop), middle // hop + 1)
    f = np.fft.rfftfreq(length)
    folded = np.cos(2 * np.pi * np.outer(f, lags)) @ correlation[middle + lags * hop]
    return np.asarray(np.maximum(folded, _RESPONSE_FLOOR * folded.max()))


def _one_sided(length: int) -> Floats:
    """How often each bin of a real transform stands in the full one."""
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


def inverse_of(A: Floats) -> Floats:
    """Inverse of a positive matrix of mixed units; stays positive where A is singular."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
    values, vectors = np.linalg.eigh(A * np.outer(scale, scale))
    scaled = vectors * scale[:, None]
    return np.asarray((scaled / np.maximum(values, 1e-14 * values[-1])) @ scaled.T)


def squared_distance(d: Floats, C: Floats) -> float:
    """Square d' C^-1 d, for a covariance that may be singular and of mixed units."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(C), 1e-300))
    values, vectors = np.linalg.eigh(C * np.outer(scale, scale))
    return float(np.sum((vectors.T @ (d * scale)) ** 2 / np.maximum(values, 1e-9)))
