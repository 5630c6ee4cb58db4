"""Samples in memory as the streams of a log."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.logs.log import LogData
from imucalib_cli.logs.streams import NS_PER_SECOND, ImuStream, JointStream, PoseStream

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from imucalib_cli.arrays import Floats

_LONGEST = 1e9
"""s between the first stamp and the last: more cannot be seconds."""


def streams_of(
    *,
    t: ArrayLike,
    gyro: ArrayLike,
    accel: ArrayLike,
    pose_t: ArrayLike | None,
    positions: ArrayLike | None,
    quaternions_xyzw: ArrayLike | None,
    joint_t: ArrayLike | None,
    joint_positions: ArrayLike | None,
    joint_names: Sequence[str],
    frame: str,
    world: str,
) -> tuple[LogData, int]:
    """Streams on topics ``imu``, ``joints`` and ``poses``, and what to add to their stamps, ns.

    Their shapes and units are those of :func:`imucalib_cli.api.calibrate_arrays`.

    Raises:
        InputError: Shapes do not fit, or a value is no finite number.
        ChoiceError: Something is missing.
    """
    names = tuple(joint_names)
    poses = _given(pose_t=pose_t, positions=positions, quaternions_xyzw=quaternions_xyzw)
    joints = _given(joint_t=joint_t, joint_positions=joint_positions, joint_names=names or None)
    if not poses and not joints:
        raise ChoiceError(
            "nothing gives the motion of the robot: give pose_t, positions and quaternions_xyzw, "
            "or joint_t, joint_positions, joint_names and urdf"
        )
    given = {"t": t, "pose_t": pose_t, "joint_t": joint_t}
    times = {name: _numbers(name, values) for name, values in given.items() if values is not None}
    first = min(float(each.min()) for each in times.values())
    last = max(float(each.max()) for each in times.values())
    if last - first > _LONGEST:
        raise InputError(
            f"{', '.join(times)}: {last - first:.3g} s from first to last: give seconds"
        )
    # start at exactly 1 s: a stamp of zero counts as a broken clock
    start = np.floor(first) - 1.0
    stamps = {
        name: np.round((seconds - start) * NS_PER_SECOND).astype(np.int64)
        for name, seconds in times.items()
    }

    def stamped(topic: str, name: str) -> dict[str, Any]:
        return {"topic": topic, "header_ns": stamps[name], "log_ns": stamps[name]}

    data = LogData()
    data.imus["imu"] = ImuStream(
        frame_id=frame,
        gyro=_numbers("gyro", gyro, len(stamps["t"]), 3),
        accel=_numbers("accel", accel, len(stamps["t"]), 3),
        **stamped("imu", "t"),
    )
    if joints:
        shape = len(stamps["joint_t"]), len(names)
        position = _numbers("joint_positions", joint_positions, *shape)
        stream = JointStream(names=names, position=position, **stamped("joints", "joint_t"))
        data.joints["joints"] = (stream,)
    if poses:
        count = len(stamps["pose_t"])
        turns = _numbers("quaternions_xyzw", quaternions_xyzw, count, 4)
        norms = np.linalg.norm(turns, axis=1, keepdims=True)
        if not norms.all():
            raise InputError("quaternions_xyzw: one is zero, which is not a rotation")
        pose = PoseStream(
            parent=world,
            child="",
            position=_numbers("positions", positions, count, 3),
            quaternion_xyzw=turns / norms,
            **stamped("poses", "pose_t"),
        )
        data.poses["poses"] = (pose,)
    return data, int(start) * NS_PER_SECOND


def _given(**arguments: object) -> bool:
    """Whether arguments that belong together are given; ChoiceError if only some are."""
    missing = [name for name, value in arguments.items() if value is None]
    if missing and len(missing) < len(arguments):
        raise ChoiceError(
            f"{', '.join(arguments)} belong together: {' and '.join(missing)} "
            f"{'is' if len(missing) == 1 else 'are'} missing"
        )
    return not missing


def _numbers(name: str, values: Any, *shape: int) -> Floats:
    """Values as float64 of a shape; without one, of one axis and not empty.

    Raises:
        InputError: They are of another shape, or not all of them are finite numbers.
    """
    if np.ma.isMaskedArray(values):
        raise InputError(f"{name}: is a masked array: leave the masked rows out")
    try:
        raw = np.asarray(values)
        if raw.dtype.kind not in "fiuO":
            raise InputError(f"{name}: cannot be read as numbers: it holds {raw.dtype}")
        array = raw.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: cannot be read as numbers: {error}") from error
    if not (array.shape == shape if shape else array.ndim == 1 and array.size):
        wanted = shape or "(N,) with N > 0"
        raise InputError(f"{name}: has the shape {array.shape}, expected {wanted}")
    if not np.isfinite(array).all():
        raise InputError(f"{name}: has values that are not finite numbers: leave those rows out")
    return array
