"""The rates of the log, which did not reach us for the paper's."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from imucalib_cli.study.load import load_parameters
from imucalib_cli.study.sweep import Part, Setup, Sweep, SweepParameters

if TYPE_CHECKING:
    from pathlib import Path

    from imucalib_cli.study.experiment import Study


@dataclass(frozen=True, kw_only=True)
class RateParameters(SweepParameters):
    """As configs/studies/rate.yaml states them."""

    together: tuple[float, ...]
    robot: tuple[float, ...]


class RateStudy(Sweep[RateParameters]):
    """Both streams faster or slower, and the robot's slower than the IMU's."""

    name: ClassVar[str] = "rate"
    note: ClassVar[str] = (
        "The noise densities are the same at every rate, so the bound is too, nearly. The "
        "published method smooths the IMU with as many samples as it derives the kinematics with, "
        "as its authors do, and takes the nearest sample of the IMU."
    )

    def parts(self) -> list[Part]:
        """Both rates alike, and the robot's alone."""
        return [
            Part(name="together", words="rate of IMU and robot Hz", values=self.config.together),
            Part(
                name="robot",
                words=f"robot's rate Hz, IMU at {self.config.imu_rate:g}",
                values=self.config.robot,
            ),
        ]

    def change(self, setup: Setup, part: str, value: float, seed: int) -> Setup:
        """Another recording of the same motion."""
        del seed
        imu_rate = value if part == "together" else self.config.imu_rate
        return replace(setup, physics=replace(setup.physics, imu_rate=imu_rate, robot_rate=value))


def load(file: Path | None, *, quick: bool) -> Study:
    """The study with its parameters."""
    return RateStudy(load_parameters(RateParameters, "rate", file, quick=quick))
