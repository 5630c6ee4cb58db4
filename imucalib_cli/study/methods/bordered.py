"""Least squares with a band matrix, of unknowns along time, and a few dense columns.

J'J of a spline's control points is a band as wide as the support of one segment. Unknowns that
affect all data, such as a mount or a bias, add a border. The band is factored by LAPACK (scipy) and
the border eliminated by its Schur complement, so time and memory are proportional to the length of
the log.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cho_solve_banded, cholesky_banded

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats, Indices


class Rows(NamedTuple):
    """Groups of whitened rows, one for each instant, and their derivatives."""

    segment: Indices
    """(N,), first control point of each group, ascending."""
    r: Floats
    """(N, rows), residuals: data less prediction."""
    local: Floats
    """(N, rows, order * width), prediction by the control points; may be empty, as the next."""
    border: Floats
    """(N, rows, B), by the dense unknowns."""
    columns: Indices
    """(B,), which they are."""


class BorderedNormal:
    """J'J and J'r, accumulated block by block."""

    def __init__(self, controls: int, width: int, order: int, borders: int) -> None:
        """Begin with no data: numbers of control points and of dense unknowns (borders).

        A control point has ``width`` components; ``order`` of them act together.
        """
        self.controls, self.width, self.order, self.borders = controls, width, order, borders
        # The band is in the lower form of scipy.linalg.cholesky_banded.
        self.band = np.zeros((order * width, controls * width))
        self.edge = np.zeros((controls, width, borders))
        self.corner = np.zeros((borders, borders))
        self.right, self.right_border = np.zeros((controls, width)), np.zeros(borders)

    def add(self, rows: Rows) -> None:
        """Add rows."""
        segment, r, local, border, columns = rows
        starts = np.flatnonzero(np.diff(segment, prepend=-1))
        first = segment[starts]
        turned = np.swapaxes(local, 1, 2)
        blocks = np.add.reduceat(turned @ local, starts, axis=0)
        size = self.order * self.width
        for i in range(size):
            for j in range(i + 1):
                # Column j of the block of segment s is column s * width + j of the matrix.
                self.band[i - j, first * self.width + j] += blocks[:, i, j]
        crossed = np.add.reduceat(turned @ border, starts, axis=0)
        pulled = np.add.reduceat(np.einsum("nrc,nr->nc", local, r), starts, axis=0)
        for k in range(self.order):
            part = slice(k * self.width, (k + 1) * self.width)
            self.edge[(first + k)[:, None], :, columns] += np.swapaxes(crossed[:, part], 1, 2)
            self.right[first + k] += pulled[:, part]
        flat = border.reshape(-1, len(columns))
        self.corner[np.ix_(columns, columns)] += flat.T @ flat
        self.right_border[columns] += flat.T @ r.ravel()

    def add_border(self, J: Floats, r: Floats) -> None:
        """Add rows in dense unknowns alone: J (rows, borders), r (rows,), whitened."""
        self.corner += J.T @ J
        self.right_border += J.T @ r

    def hold(self, columns: list[int]) -> None:
        """Hold dense unknowns at their values."""
        self.edge[:, :, columns] = 0.0
        self.corner[columns, :] = 0.0
        self.corner[:, columns] = 0.0
        self.corner[columns, columns] = 1.0
        self.right_border[columns] = 0.0

    def step(self, damping: float) -> tuple[Floats, Floats, float]:
        """Solve (J'J + damping diag J'J) d = J'r.

        Returns:
            d of the control points (controls, width), of the dense unknowns (borders,), and the
            decrease of the squared residual that the linear model promises.

        Raises:
            numpy.linalg.LinAlgError: The data do not determine an unknown.
        """
        band = self.band.copy()
        # Segments without data get a tiny weight, so that the factor exists.
        band[0] += damping * band[0] + 1e-12 * band[0].mean()
        factor = cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False)
        n = self.controls * self.width
        edge = self.edge.reshape(n, self.borders)
        sides = np.column_stack([self.right.reshape(n), edge])
        solved = cho_solve_banded((factor, True), sides, overwrite_b=True, check_finite=False)
        corner = self.corner + damping * np.diag(np.diag(self.corner)) - edge.T @ solved[:, 1:]
        reduced = self.right_border - edge.T @ solved[:, 0]
        # Scaled to a unit diagonal: metres, radians and seconds differ by orders of magnitude.
        scale = 1.0 / np.sqrt(np.maximum(np.diag(corner), np.finfo(float).tiny))
        chol = cho_factor(corner * np.outer(scale, scale), check_finite=False)
        border = scale * cho_solve(chol, scale * reduced)
        local = solved[:, 0] - solved[:, 1:] @ border
        promised = float(self.right.reshape(n) @ local + self.right_border @ border)
        return local.reshape(self.controls, self.width), border, promised
