"""Results without a log: one with any change, and those of one mount over many days."""

import math
from collections.abc import Iterable
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats
from imucalib_cli.estimate.checks.segments import Consistency
from imucalib_cli.estimate.entries import (
    CorrectionEntry,
    ImuModelEntry,
    SensorCheckEntry,
    Unobservable,
    WindowEntry,
)
from imucalib_cli.estimate.estimate import Estimate, ResidualSummary
from imucalib_cli.findings import TEXT, untrusted
from imucalib_cli.results.codec import to_yaml
from imucalib_cli.results.from_estimate import result_of, scalars
from imucalib_cli.results.result import Provenance, RecordingEntry, Result, SourceFile, Topics
from imucalib_cli.robot.mount import NominalPose

RECORDED = datetime(2026, 5, 4, 9, 15, 2, 250_000, tzinfo=timezone.utc)
R_TRUE = Rotation.from_euler("xyz", [0.1, -0.4, 2.9])
UP = Unobservable(kind="translation", direction_parent=[0.0, 0.0, 1.0], std=None, motion="tilt it")
ROLL = Unobservable(kind="rotation", direction_parent=[1.0, 0.0, 0.0], std=0.3, motion="roll it")

DOUBTS = (untrusted(TEXT, text="it wobbles"),)


def make_estimate(**changes: Any) -> Estimate:
    rng = np.random.default_rng(4)
    root = rng.normal(scale=1e-4, size=(6, 6))
    estimate = Estimate(
        method="matched",
        R_parent_imu=R_TRUE.as_matrix(),
        t_parent_imu=np.array([-0.0225, 0.1, 1e-5]),
        covariance=root @ root.T,
        time_offset=-0.042,
        time_offset_std=1e-5,
        accel_bias=np.array([0.1, -0.2, 0.3]),
        accel_bias_std=np.array([1e-3, 2e-3, 3e-3]),
        gyro_bias=np.zeros(3),
        gyro_bias_std=None,
        gravity_world=np.array([0.0, 0.0, -9.80665]),
        window=WindowEntry(samples=51, seconds=0.1, reason="encoder noise 2e-5 rad"),
        residuals=ResidualSummary(
            accel_rms=np.full(3, 0.02),
            gyro_rms=np.full(3, 1e-3),
            windows_used=1000,
            windows_dropped=3,
            samples_replaced=2,
            gaps=1,
            accel_normalised=np.full(3, 1.1),
            gyro_normalised=np.array([0.9, 1.0, 1.1]),
        ),
        corrections={
            "accel_scale": CorrectionEntry(value=[1.0, 1.01, 1.0], std=[1e-4] * 3),
            "clock_drift": CorrectionEntry(value=[2e-5], std=[1e-7]),
        },
        consistency=Consistency(
            folds=12,
            fold_std=np.linspace(1e-4, 6e-4, 6),
            halves_difference=np.linspace(-3e-4, 2e-4, 6),
            halves_sigmas=1.2,
            segment_chi2=0.9,
            segment_sigmas=-0.4,
            whiteness=(1.0, 1.3),
        ),
        imu_check=ImuModelEntry(
            name="bmi088",
            rate=200.0,
            accel=SensorCheckEntry(expected=0.02, measured=0.1, in_windows=0.03, bias_prior=0.4),
            gyro=SensorCheckEntry(expected=2e-3, measured=1e-3, in_windows=None, bias_prior=None),
        ),
        notes={"chi2": float("nan"), "count": 3, "flag": True},
    )
    return replace(estimate, **changes)


def make_result(
    *,
    estimate: Estimate | None = None,
    parent: str = "wrist_3_link",
    child: str = "imu_link",
    topic: str = "/imu/data",
    log: str = "0",
    options: dict[str, Any] | None = None,
    recorded: datetime | None = RECORDED,
    **changes: Any,
) -> Result:
    """A result of what an estimator found, or of make_estimate with changes."""
    return result_of(
        estimate or make_estimate(**changes),
        parent=parent,
        child=child,
        nominal=NominalPose(
            joint="imu_joint", R_parent_imu=np.eye(3), t_parent_imu=np.array([0.0, 0.1, 0.0])
        ),
        provenance=Provenance(
            tool="imucalib",
            version="0.1.0",
            files=[SourceFile(path="a b.mcap", sha256=(log * 64)[:64])],
            urdf=SourceFile(path="robot.urdf", sha256="f" * 64),
            topics=Topics(imu=topic, motion=["/joint_states"]),
            world="base_link",
            clock="header",
            options=scalars(options or {"max_offset": 1.0, "tilt_std": math.inf}),
            recording=RecordingEntry(
                start=recorded,
                duration=60.0,
                imu_samples=30_000,
                imu_rate=500.0,
                motion_samples=7_500,
            ),
        ),
    )


def edited(tree: Any, place: str, value: Any) -> Any:
    """The tree with another value at a place in it, such as ``transform.child``."""
    key, _, inner = place.partition(".")
    value = edited(getattr(tree, key), inner, value) if inner else value
    return structs.replace(tree, **{key: value})


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
