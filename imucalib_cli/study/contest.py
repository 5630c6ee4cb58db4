"""Run the published method and ours on one recording, and compare their errors."""

from __future__ import annotations

import time
from dataclasses import asdict, fields, replace
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions, WindowChoice
from imucalib_cli.estimate.published.method import calibrate_paper
from imucalib_cli.results.pose import PoseError, pose_error
from imucalib_cli.study.recordings import streams_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.estimate.options import PaperOptions
    from imucalib_cli.simulate.recording import Recording
    from imucalib_cli.study.conditions import Pose
    from imucalib_cli.study.study import Row


def exact_system(gravity_norm: float) -> MatchedOptions:
    """The matched method for the exact robot, sensor and gravity (m/s², or none) of the studies.

    Unknown besides the pose are the biases, the vertical and the time offset.
    """
    return MatchedOptions(
        gravity="tilt" if gravity_norm > 0.0 else "none",
        gravity_norm=gravity_norm,
        gravity_std=0.0,
        sensor_model="ideal",
        robot="exact",
    )


def pose_only(gravity_norm: float) -> MatchedOptions:
    """The same with the unknowns of the published method."""
    return replace(
        exact_system(gravity_norm),
        time_offset=0.0,
        accel_bias_std=0.0,
        gyro_bias_std=0.0,
        gravity="fixed" if gravity_norm > 0.0 else "none",
    )


PUBLISHED: dict[str, Literal["l1", "components"]] = {
    "paper": "l1",
    "paper, components": "components",
}
"""The published method with one L1 sum per instant as residual, and with the six components: it is
not known which its authors square."""
OURS: dict[str, Callable[[float], MatchedOptions]] = {
    "matched, pose only": pose_only,
    "matched": exact_system,
}
"""With the published method's unknowns, and with all its own."""
METHODS = (*PUBLISHED, *OURS)

NO_ERRORS: Row = dict.fromkeys(part.name for part in fields(PoseError))
"""Columns of the errors of a method without an answer."""


def contest(
    methods: Sequence[str],
    recording: Recording,
    guess: Pose,
    settings: Sequence[PaperOptions],
    window: WindowChoice | None = None,
) -> Iterator[tuple[PaperOptions | None, Row]]:
    """Calibrate by methods: the published one from a guess in each of its settings, ours once.

    Yields:
        The setting, and a row: method, translation and rotation (norm, m; angle, rad), the paper's
        averages of them, time_offset (error, s), trusted, seconds, evaluations; without an answer
        ``failure`` is the reason and the errors are None.
    """
    imu, path = streams_of(recording)
    norm = float(np.linalg.norm(recording.gravity_world))
    for method in methods:
        if method in OURS:
            ours = replace(OURS[method](norm), window=window or WindowChoice())
            yield None, _row(method, recording, partial(calibrate_matched, imu, path, ours))
            continue
        for setting in settings:
            theirs = replace(
                setting,
                residual=PUBLISHED[method],
                gravity_norm=norm,
                R_initial=guess.R,
                t_initial=guess.t,
            )
            yield setting, _row(method, recording, partial(calibrate_paper, imu, path, theirs))


def _row(method: str, recording: Recording, calibrate: Callable[[], Estimate]) -> Row:
    begun = time.perf_counter()
    try:
        estimate = calibrate()
    except InputError as error:
        nothing: Row = dict.fromkeys(("time_offset", "seconds", "evaluations"))
        return NO_ERRORS | nothing | {"method": method, "trusted": False, "failure": str(error)}
    seconds = time.perf_counter() - begun
    apart = pose_error(
        estimate.R_parent_imu,
        estimate.t_parent_imu,
        recording.R_parent_imu,
        recording.t_parent_imu,
    )
    return {
        "method": method,
        **asdict(apart),
        "time_offset": estimate.time_offset - recording.noise.time_offset,
        "trusted": estimate.trusted,
        "seconds": seconds,
        "evaluations": estimate.notes.get("evaluations"),
        "failure": None,
    }
