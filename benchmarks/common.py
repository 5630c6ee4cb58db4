"""What the benchmarks share: tables that grow line by line, scores of poses, IMU grades."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from imucalib_cli.simulate.options import NoiseOptions


def table(*header: str) -> Callable[..., None]:
    """Print a header; what is returned prints a line of cells."""

    def line(*cells: object) -> None:
        print(f"| {' | '.join(map(str, cells))} |", flush=True)

    line(*header)
    print("|---" * len(header) + "|")
    return line


def rms(errors: ArrayLike) -> float:
    """Root mean square of numbers (N,), or of the norms of vectors (N, n)."""
    return float(np.sqrt(np.mean(np.sum(np.atleast_2d(np.square(errors).T), axis=0))))


@dataclass
class Scores:
    """Errors of poses, and how they compare with what is stated."""

    errors: list[NDArray[np.float64]] = field(default_factory=list)
    """(6,) each, m and rad."""
    nees: list[float] = field(default_factory=list)
    """Squared error in units of the stated covariance: 6 where that is true."""
    trusted: int = 0

    def add(self, error: NDArray[np.float64], covariance: ArrayLike, *, trusted: bool) -> None:
        """One estimate."""
        self.errors.append(error)
        self.nees.append(float(error @ np.linalg.solve(covariance, error)))
        self.trusted += trusted

    @property
    def mm(self) -> float:
        """Root mean square."""
        return 1e3 * rms(np.array(self.errors)[:, :3])

    @property
    def degrees(self) -> float:
        """Root mean square."""
        return float(np.degrees(rms(np.array(self.errors)[:, 3:])))

    @property
    def honesty(self) -> str:
        """Mean of the NEES and its standard error."""
        spread = np.std(self.nees) / np.sqrt(len(self.nees))
        return f"{np.mean(self.nees):.2f} ± {spread:.2f}"


def rihibot_log(folder: Path, seconds: float | None, imu: str) -> tuple[Path, Path]:
    """RiHIBot at 500 Hz with an IMU of a grade: its log and its URDF."""
    from imucalib_cli.simulate.load import load_grade, load_system
    from imucalib_cli.simulate.options import PhysicsOptions
    from imucalib_cli.simulate.simulate import simulate

    log, urdf = folder / "0.mcap", folder / "robot.urdf"
    physics = PhysicsOptions(imu_rate=500, robot_rate=500, duration=seconds)
    simulate(load_system("rihibot"), log, physics=physics, noise=load_grade(imu), urdf=urdf)
    return log, urdf


def grade(name: str, **changes: object) -> NoiseOptions:
    """An IMU grade with changes; its bias walks off, so that the bound holds exactly."""
    from imucalib_cli.simulate.load import load_grade

    noise = replace(load_grade(name), accel_bias_walk=0.0, gyro_bias_walk=0.0)
    return replace(noise, **changes)  # type: ignore[arg-type]
