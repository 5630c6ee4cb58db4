"""What the residuals of a fit say of unknowns it did not have: one step, no new fit (Rao 1948)."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate.covariance import inverse_of
from imucalib_cli.estimate.uncertainty import bounded_priors, gram, score_spectrum

if TYPE_CHECKING:
    from imucalib_cli.estimate.fit import Fit

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]


class ScoreTest:
    """Steps that further tangent components would take, with their covariance under noise."""

    def __init__(self, fit: Fit, further: Indices) -> None:
        """Prepare what all steps share.

        Args:
            fit: A solution.
            further: Tangent components that may be asked for.
        """
        self._base = np.flatnonzero(fit.unknowns.free)
        self._every = np.union1d(self._base, further)
        spectrum = score_spectrum(fit, self._every, fit.scales)
        prior = (fit.unknowns.prior_information + bounded_priors())[self._every]
        self._information = gram(spectrum.J) + np.diag(prior)
        self._score = spectrum.J.reshape(-1, len(self._every)).T @ spectrum.e.reshape(-1)
        # The noise is what is left with all of them free: a fault is no part of it.
        inverse = inverse_of(self._information)
        left = spectrum.e - spectrum.J @ (inverse @ self._score)
        levels = replace(spectrum, e=left).noise_levels(inverse)
        # Where the data say nothing the prior alone bounds a step, and is as uncertain.
        self._noise = spectrum.score_covariance(levels) + np.diag(prior)

    def step(self, part: Indices) -> tuple[Floats, Floats]:
        """Where some components would go if they were free, and the covariance of that.

        Args:
            part: (P,), tangent components, of those that may be asked for.

        Returns:
            (P,) and (P, P).
        """
        known = np.searchsorted(self._every, np.concatenate([self._base, part]))
        inverse = inverse_of(self._information[np.ix_(known, known)])
        last = slice(len(known) - len(part), None)
        step = -(inverse @ self._score[known])[last]
        covariance = inverse @ self._noise[np.ix_(known, known)] @ inverse
        return step, np.asarray(covariance[last, last])
