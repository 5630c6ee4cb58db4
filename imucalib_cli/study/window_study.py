"""The window's length, which the paper calls small and does not tell."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from imucalib_cli.estimate.options import WindowChoice
from imucalib_cli.study.load import load_parameters
from imucalib_cli.study.sweep import Part, Setup, Sweep, SweepParameters

if TYPE_CHECKING:
    from pathlib import Path

    from imucalib_cli.study.experiment import Study


@dataclass(frozen=True, kw_only=True)
class WindowParameters(SweepParameters):
    """As configs/studies/window.yaml states them."""

    samples: tuple[int, ...]


class WindowStudy(Sweep[WindowParameters]):
    """The same length for all filters of a run, on both sides of each method."""

    name: ClassVar[str] = "window"
    note: ClassVar[str] = (
        "A window is L sample intervals; an even L is taken one longer, as the filters need it odd."
    )

    def parts(self) -> list[Part]:
        """Seconds, so that rates can be compared."""
        rate = self.config.imu_rate
        seconds = tuple(samples / rate for samples in self.config.samples)
        return [Part(name="window", words="window s", values=seconds)]

    def change(self, setup: Setup, part: str, value: float, seed: int) -> Setup:
        """Both methods at this window."""
        del part, seed
        samples = round(value * self.config.imu_rate)
        variants = dict.fromkeys(replace(v, window=samples) for v in setup.variants)
        return replace(setup, window=WindowChoice(samples=samples), variants=tuple(variants))


def load(file: Path | None, *, quick: bool) -> Study:
    """The study with its parameters."""
    return WindowStudy(load_parameters(WindowParameters, "window", file, quick=quick))
