"""Covariance that knows noise is coloured by our own filters, and maybe by the sensor's too.

Windows overlap, so residuals of neighbouring windows are correlated, and least squares' own
covariance is far too small. With J the whitened rows, A = J'J and S the residuals' spectrum,
the covariance of the estimate is the sandwich

    A^-1 ( sum over frequencies of S(f) J(f)^H J(f) ) A^-1.

S is found per sensor in a few bands: within a band it is a number times the known response
|K(f)|² of the window's kernel. Each band's number is corrected for what the fit took out of it,
the trace of the band's part of the hat matrix, so that few windows do not mean a small sigma.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

_PIECE = 4096
"""Windows per transform: longer logs are averaged over pieces."""
_BAND_RATIO = 2.0
_FIRST_BAND_BINS = 4
"""Bins of the lowest band: fewer would leave nothing after the correction."""
_RESPONSE_FLOOR = 1e-3
"""Kernel response below which frequencies carry no information and no weight."""


@dataclass(frozen=True, eq=False)
class Sandwich:
    """Covariance of all tangent components, and what the noise looked like."""

    covariance: Floats
    """(P, P)."""
    colour: float
    """Largest ratio of a band's noise level to the level of white noise; 1 for white."""


def spectral_sandwich(
    J: Floats,
    e: Floats,
    slots: NDArray[np.intp],
    responses: tuple[Floats, Floats],
    prior_information: Floats,
) -> Sandwich:
    """Covariance of the least-squares solution from rows and residuals.

    Args:
        J: (W, 6, P), whitened and weighted rows of free components: accelerometer, gyroscope.
        e: (W, 6), residuals, likewise.
        slots: (W,), position of each window on the even grid of windows, ascending.
        responses: |K(f)|² of the two sensors' kernels, functions of frequency as arrays on
            np.fft.rfftfreq(_PIECE).
        prior_information: (P,), of the priors, which carry no window noise.

    Returns:
        Covariance in the units of J's components.
    """
    parameters = J.shape[2]
    A = np.einsum("wij,wik->jk", J, J) + np.diag(prior_information)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
    inverse = np.linalg.pinv(A * np.outer(scale, scale), rcond=1e-13, hermitian=True)
    inverse = inverse * np.outer(scale, scale)
    B = np.diag(prior_information).astype(np.float64)
    colour = 1.0
    pieces = _pieces(slots)
    size = min(_PIECE, _next_power_of_two(int(slots[-1] - slots[0]) + 1))
    frequencies = np.fft.rfftfreq(size)
    bands = _bands(size)
    for sensor in range(2):
        response = np.interp(frequencies, np.fft.rfftfreq(_PIECE), responses[sensor])
        shape = np.maximum(response, _RESPONSE_FLOOR)
        part = slice(3 * sensor, 3 * sensor + 3)
        power = np.zeros(len(frequencies))
        gram = np.zeros((len(bands), parameters, parameters))
        shaped = np.zeros_like(gram)
        used = np.zeros(len(frequencies))
        for rows, offset in pieces:
            J_f = _transform(J[rows, part], slots[rows] - offset, size)
            e_f = _transform(e[rows, part][:, :, None], slots[rows] - offset, size)[:, :, 0]
            weight = _one_sided(size)
            fill = len(rows) / size
            power += (np.abs(e_f) ** 2).sum(axis=1) / shape * weight
            used += 3.0 * weight * fill
            for index, band in enumerate(bands):
                block = J_f[band].reshape(-1, parameters)
                scaled = block * np.sqrt(np.repeat(weight[band], 3))[:, None]
                gram[index] += np.real(scaled.conj().T @ (scaled / np.repeat(shape[band], 3)[:, None]))
                tinted = scaled * np.sqrt(np.repeat(shape[band], 3))[:, None]
                shaped[index] += np.real(tinted.conj().T @ tinted)
        levels = np.zeros(len(bands))
        for index, band in enumerate(bands):
            freedom = used[band].sum() - float(np.sum(inverse * gram[index]))
            levels[index] = power[band].sum() / max(freedom, 0.25 * used[band].sum())
        B += np.einsum("b,bjk->jk", levels, shaped)
        informative = [np.median(response[band]) > 0.1 for band in bands]
        known = levels[np.array(informative)]
        if len(known) > 1 and known.min() > 0:
            colour = max(colour, float(known.max() / np.median(known)))
    return Sandwich(inverse @ B @ inverse, colour)


def _transform(values: Floats, slots: NDArray[np.intp], size: int) -> Complexes:
    """Unitary transform along time of rows at their slots, holes left zero."""
    dense = np.zeros((size, *values.shape[1:]))
    dense[slots] = values
    return np.asarray(np.fft.rfft(dense, axis=0) / np.sqrt(size))


def _one_sided(size: int) -> Floats:
    weight = np.full(size // 2 + 1, 2.0)
    weight[0] = 1.0
    if size % 2 == 0:
        weight[-1] = 1.0
    return weight


def _bands(size: int) -> list[slice]:
    """Slices of frequency bins, each band twice as wide as the one below."""
    edges = [0, _FIRST_BAND_BINS]
    while edges[-1] < size // 2 + 1:
        edges.append(int(np.ceil(edges[-1] * _BAND_RATIO)))
    edges[-1] = size // 2 + 1
    if len(edges) > 2 and edges[-1] - edges[-2] < _FIRST_BAND_BINS:
        del edges[-2]
    return [slice(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)]


def _pieces(slots: NDArray[np.intp]) -> list[tuple[NDArray[np.intp], int]]:
    """Rows of each stretch of at most _PIECE slots, with the stretch's first slot."""
    start = int(slots[0])
    number = (slots - start) // _PIECE
    return [
        (np.flatnonzero(number == index), start + int(index) * _PIECE)
        for index in np.unique(number)
    ]


def _next_power_of_two(value: int) -> int:
    return 1 << max(value - 1, 1).bit_length()
