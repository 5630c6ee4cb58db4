"""Stretches of neighbouring samples that have a property in common."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import TypeVar

    from numpy.typing import NDArray

    from imucalib_cli.arrays import Bools, Indices

    S = TypeVar("S", bound=np.generic)


class Stretches(Struct, frozen=True, eq=False):
    """Stretches of rows in order, each from its first row to the one before its end."""

    first: Indices
    end: Indices

    def __len__(self) -> int:
        return len(self.first)

    def __iter__(self) -> Iterator[tuple[int, int]]:
        return zip(self.first.tolist(), self.end.tolist(), strict=True)

    @property
    def lengths(self) -> Indices:
        """Length of each, rows."""
        return self.end - self.first

    def where(self, which: Bools) -> Stretches:
        """Select some of them."""
        return Stretches(self.first[which], self.end[which])

    def mask(self, count: int) -> Bools:
        """(count,), True inside."""
        edges = np.zeros(count + 1, np.intp)
        np.add.at(edges, self.first, 1)
        np.add.at(edges, self.end, -1)
        return np.asarray(np.cumsum(edges[:-1]) > 0)


def all_hold(holds: Bools, first: Indices, count: int) -> Bools:
    """(W,), whether a mask (N,) is True at ``count`` samples from each of the given rows on."""
    failures = np.concatenate([[0], np.cumsum(~holds)])
    return np.asarray(failures[first + count] == failures[first])


def stretches_of(holds: Bools) -> Stretches:
    """Stretches in which a mask (N,) is True."""
    change = np.diff(np.concatenate([[0], holds.astype(np.int8), [0]]))
    return Stretches(np.flatnonzero(change == 1), np.flatnonzero(change == -1))


def thinned(rows: NDArray[S], most: int) -> NDArray[S]:
    """About ``most`` rows (N, ...), in 20 stretches evenly over the log; all if there are fewer."""
    if len(rows) <= most:
        return rows
    stretch = max(most // 20, 1)
    starts = np.linspace(0, len(rows) - stretch, 20).astype(np.intp)
    return rows[np.unique(starts[:, None] + np.arange(stretch))]
