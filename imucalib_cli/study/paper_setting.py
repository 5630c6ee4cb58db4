"""What is not known to us of the published method: its window and what it drops."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, kw_only=True)
class PaperSetting:
    """A choice of both."""

    window: int
    """Samples."""
    exclusion: float
    """m/s², second difference over which a sample is dropped; 0 drops none."""

    @property
    def words(self) -> str:
        """For tables."""
        dropped = f"drops over {self.exclusion:.3g} m/s²" if self.exclusion else "drops none"
        return f"L {self.window}, {dropped}"


def paper_settings(windows: Sequence[int], exclusions: Sequence[float]) -> tuple[PaperSetting, ...]:
    """Every window, samples, with every exclusion, m/s²."""
    return tuple(PaperSetting(window=w, exclusion=e) for w, e in product(windows, exclusions))
