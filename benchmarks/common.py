"""Shared parts of the benchmarks: arguments, tables that grow line by line, scores, logs."""

from __future__ import annotations

import argparse
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from tools.errors import nees

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from imucalib_cli.simulate.options import NoiseOptions


def arguments(doc: str | None, **options: Any) -> Any:
    """Parse the command line.

    Args:
        doc: Of the script; its first line is the help.
        options: Default of each option by name, which gives its type; a list takes several
            values. Or a dictionary of arguments for argparse.
    """
    parser = argparse.ArgumentParser(description=(doc or "").splitlines()[0])
    for name, option in options.items():
        given = dict(option) if isinstance(option, dict) else {"default": option}
        flags = given.pop("flags", ("--" + name.replace("_", "-"),))
        default = given.get("default")
        if isinstance(default, bool):
            given["action"] = "store_true"
        elif isinstance(default, list):
            given |= {"nargs": "+", "type": given.get("type", type(default[0]))}
        elif default is not None:
            given["type"] = type(default)
        parser.add_argument(*flags, **given)
    return parser.parse_args()


def table(*header: str) -> Callable[..., None]:
    """Print a header; the returned function prints a line of cells.

    A heading may end in the format of its cells, as in "mm|.3f"; texts stay as they are.
    """
    names, formats = zip(*(each.partition("|")[::2] for each in header), strict=True)

    def line(*cells: object) -> None:
        texts = (
            cell if isinstance(cell, str) else format(cell, form)
            for cell, form in zip(cells, formats, strict=True)
        )
        print(f"| {' | '.join(texts)} |", flush=True)

    print(f"| {' | '.join(names)} |", flush=True)
    print("|---" * len(header) + "|")
    return line


def parallel(
    function: Callable[..., Any], jobs: Sequence[tuple[Any, ...]], workers: int | None = None
) -> list[Any]:
    """Results of a function over tuples of its arguments, computed by several processes."""
    from imucalib_cli.process import prepare_to_compute

    with ProcessPoolExecutor(workers, initializer=prepare_to_compute) as pool:
        return list(pool.map(function, *zip(*jobs, strict=True)))


def timed(call: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    """Seconds of one call, by a clock."""
    start = clock()
    call()
    return clock() - start


def rms(errors: ArrayLike) -> float:
    """Root mean square of numbers (N,), or of the norms of vectors (N, n)."""
    return float(np.sqrt(np.mean(np.sum(np.atleast_2d(np.square(errors).T), axis=0))))


@dataclass
class Scores:
    """Errors of poses, and how they compare with the stated covariance."""

    errors: list[NDArray[np.float64]] = field(default_factory=list)
    """(6,) each, m and rad."""
    nees: list[float] = field(default_factory=list)
    """Squared error in units of the stated covariance: 6 where that is true."""
    trusted: int = 0

    def add(
        self, error: NDArray[np.float64], covariance: ArrayLike | None, *, trusted: bool
    ) -> None:
        """One estimate; without a covariance it does not count."""
        if covariance is not None:
            self.errors.append(error)
            self.nees.append(nees(error, np.asarray(covariance)))
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
