"""Joint positions as encoders read them: with noise, and in steps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from imucalib_cli.study.load import load_parameters
from imucalib_cli.study.sweep import Part, Setup, Sweep, SweepParameters

if TYPE_CHECKING:
    from pathlib import Path

    from imucalib_cli.study.experiment import Study


@dataclass(frozen=True, kw_only=True)
class EncoderParameters(SweepParameters):
    """As configs/studies/encoder.yaml states them."""

    noise: tuple[float, ...]
    step: tuple[float, ...]


class EncoderStudy(Sweep[EncoderParameters]):
    """Noise of the kinematics, which enters the regressors and not the readings alone."""

    name: ClassVar[str] = "encoder"
    note: ClassVar[str] = (
        "The bound is that of perfect encoders: noise of the kinematics can only raise it. The "
        "matched filters choose their window from the log."
    )

    def parts(self) -> list[Part]:
        """Noise, and quantisation."""
        return [
            Part(name="noise", words="encoder noise rad", values=self.config.noise),
            Part(name="step", words="encoder step rad", values=self.config.step),
        ]

    def change(self, setup: Setup, part: str, value: float, seed: int) -> Setup:
        """Other encoders."""
        del seed
        if part == "noise":
            return replace(setup, noise=replace(setup.noise, encoder_noise=value))
        return replace(setup, noise=replace(setup.noise, encoder_step=value))


def load(file: Path | None, *, quick: bool) -> Study:
    """The study with its parameters."""
    return EncoderStudy(load_parameters(EncoderParameters, "encoder", file, quick=quick))
