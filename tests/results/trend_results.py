"""Results of one mount over many days, drawn from a seed."""

from __future__ import annotations

from datetime import timedelta
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from imucalib_cli.results.codec import to_yaml
from tests.results.test_results_documents import R_TRUE, RECORDED, make_result

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from imucalib_cli.arrays import Floats
    from imucalib_cli.results.result import Result

HERE = np.array([0.1, 0.2, 0.3])
SIGMA = np.repeat([1e-4, 5e-5], 3)
"""m and rad, along the parent's axes."""


def covariances(rng: np.random.Generator, count: int) -> Floats:
    """(count, 6, 6), of the size of SIGMA, each with correlations of its own."""
    roots = rng.normal(size=(count, 6, 6)) / np.sqrt(6.0)
    spread = SIGMA * rng.uniform(0.5, 2.0, (count, 6))
    correlated = roots @ np.swapaxes(roots, 1, 2) + 0.3 * np.eye(6)
    return np.asarray(correlated * spread[:, :, None] * spread[:, None, :])


def drawn(
    seed: int, count: int, *, scatter: Any = (0.0, 0.0), moves: Iterable[tuple[int, Any]] = ()
) -> tuple[Floats, Floats]:
    """Poses (count, 6) off the true one, m and rad, and their covariances.

    Args:
        seed: Of the draws.
        count: Of recordings.
        scatter: Between recordings, 1 sigma of an axis, m and rad.
        moves: From which recording on, and by what (6,).
    """
    rng = np.random.default_rng([seed, count])
    C = covariances(rng, count)
    values = np.array([rng.multivariate_normal(np.zeros(6), each) for each in C])
    values += rng.normal(size=(count, 6)) * np.repeat(scatter, 3)
    for first, move in moves:
        values[first:] += move
    return values, C


def result(place: int, value: Floats, covariance: Floats, **more: Any) -> Result:
    """The result of a day's recording, at a pose off the true one."""
    turn = Rotation.from_rotvec(value[3:]) * R_TRUE
    given: dict[str, Any] = {
        "log": f"{place:064x}",
        "recorded": RECORDED + timedelta(days=place),
        **more,
    }
    return make_result(
        R_parent_imu=turn.as_matrix(), t_parent_imu=HERE + value[:3], covariance=covariance, **given
    )


def named(values: Floats, covariances: Floats, **more: Any) -> list[tuple[str, Result]]:
    """Results after their files' names, which are in no order."""
    days = (
        result(k, *each, **more) for k, each in enumerate(zip(values, covariances, strict=True))
    )
    return [(f"{(7 * k) % 97:02d}.yaml", each) for k, each in enumerate(days)]


def written(folder: Path, results: Iterable[tuple[str, Result]]) -> Path:
    """A folder with these files."""
    folder.mkdir(exist_ok=True)
    for name, each in results:
        (folder / name).write_text(to_yaml([each]), encoding="utf-8")
    return folder
