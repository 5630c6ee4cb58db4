"""Biases of the IMU, constant and wandering, which the published method takes for zero."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from imucalib_cli.study.load import load_parameters
from imucalib_cli.study.sweep import Part, Setup, Sweep, SweepParameters

if TYPE_CHECKING:
    from pathlib import Path

    from imucalib_cli.simulate.options import Vector
    from imucalib_cli.study.experiment import Study


@dataclass(frozen=True, kw_only=True)
class BiasParameters(SweepParameters):
    """As configs/studies/bias.yaml states them."""

    accel_bias: tuple[float, ...]
    gyro_bias: tuple[float, ...]
    accel_bias_walk: tuple[float, ...]
    gyro_bias_walk: tuple[float, ...]


class BiasStudy(Sweep[BiasParameters]):
    """One kind of bias at a time."""

    name: ClassVar[str] = "bias"
    note: ClassVar[str] = (
        "A bias has the norm stated and a direction of the seed's; a walk begins at zero. The "
        "bound knows of constant biases, not of their walk. The published method and matched, "
        "pose only, take biases to be zero."
    )

    def parts(self) -> list[Part]:
        """Constant biases, then walks."""
        config = self.config
        return [
            Part(name="accel", words="accelerometer bias m/s²", values=config.accel_bias),
            Part(name="gyro", words="gyroscope bias rad/s", values=config.gyro_bias),
            Part(
                name="accel-walk",
                words="accelerometer bias walk m/s²/√s",
                values=config.accel_bias_walk,
            ),
            Part(
                name="gyro-walk",
                words="gyroscope bias walk rad/s/√s",
                values=config.gyro_bias_walk,
            ),
        ]

    def change(self, setup: Setup, part: str, value: float, seed: int) -> Setup:
        """Another bias."""
        noise = setup.noise
        match part:
            case "accel":
                noise = replace(noise, accel_bias=_some_vector(value, seed))
            case "gyro":
                noise = replace(noise, gyro_bias=_some_vector(value, seed))
            case "accel-walk":
                noise = replace(noise, accel_bias_walk=value)
            case _:
                noise = replace(noise, gyro_bias_walk=value)
        return replace(setup, noise=noise)


def _some_vector(norm: float, seed: int) -> Vector:
    """Of uniform direction, the same for every norm."""
    direction = np.random.default_rng(seed).normal(size=3)
    x, y, z = norm * direction / np.linalg.norm(direction)
    return float(x), float(y), float(z)


def load(file: Path | None, *, quick: bool) -> Study:
    """The study with its parameters."""
    return BiasStudy(load_parameters(BiasParameters, "bias", file, quick=quick))
