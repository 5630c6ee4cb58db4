"""imucalib from Python: ``import imucalib_cli as ic; ic.calibrate("log.mcap", urdf="robot.urdf")``.

Every error is an :class:`~imucalib_cli.errors.ImucalibError` of one line. Where its text names an
option of the command line, the argument has the same name: ``--imu-topic`` is ``imu_topic``.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import Struct, ValidationError, convert
from msgspec.structs import asdict

from imucalib_cli.errors import ChoiceError, ImucalibError, InputError, UntrustedError
from imucalib_cli.estimate.options import MatchedOptions, PaperOptions, PosePrior, WindowChoice
from imucalib_cli.jobs.calibrate import calibrate_recording
from imucalib_cli.jobs.input.from_arrays import streams_of
from imucalib_cli.jobs.input.recording import read_recording, recording_of
from imucalib_cli.jobs.input.request import (
    CalibrationRequest,
    ClockChoice,
    ExpectedImu,
    part_asked,
    unheard,
)
from imucalib_cli.logs.messages.columns import joint_columns
from imucalib_cli.logs.remote.file import path_or_url
from imucalib_cli.logs.unpacked import removing_copies
from imucalib_cli.process import one_thread
from imucalib_cli.results.fields import sections, summarise, verdict
from imucalib_cli.results.formats import FORMATS, refuse_untrusted
from imucalib_cli.results.requirement import Tolerance
from imucalib_cli.results.result import Result
from imucalib_cli.shown import as_html, printable
from imucalib_cli.signals.imu.data_sheet import load_imu_model
from imucalib_cli.signals.imu.units import Units

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.details import Details, WindowSeries
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.jobs.input.recording import Recording
    from imucalib_cli.jobs.input.request import Progress
    from imucalib_cli.logs.messages.columns import JointColumns
    from imucalib_cli.logs.reader import LogPath
    from imucalib_cli.signals.samples import Sensor

    StrPath = str | os.PathLike[str]

__all__ = [
    "Calibration",
    "ChoiceError",
    "ImucalibError",
    "InputError",
    "MatchedOptions",
    "PaperOptions",
    "PosePrior",
    "Result",
    "Tolerance",
    "Units",
    "UntrustedError",
    "WindowChoice",
    "calibrate",
    "calibrate_arrays",
]


class Calibration(Struct, frozen=True, kw_only=True, eq=False):
    """Pose of one IMU in its parent link, with all that is known of it."""

    result: Result
    """What ``imucalib run`` writes, as a typed tree."""
    estimate: Estimate
    """The same as arrays, with findings, and every unknown that was found."""
    start_ns: int
    """Stamp of second 0 of :attr:`residuals`, ns: add it to their ``t`` to get the stamps of the
    log, or of the arrays that were given."""

    @property
    def ok(self) -> bool:
        """Whether the pose may be used: every direction is determined, nothing contradicts it."""
        return self.result.status == "ok"

    @property
    def R(self) -> Floats:
        """(3, 3), R_parent_imu; some of it is a guess where :attr:`ok` is false."""
        return self.estimate.R_parent_imu

    @property
    def t(self) -> Floats:
        """(3,), t_parent_imu, m: place of the IMU in its parent."""
        return self.estimate.t_parent_imu

    @property
    def T(self) -> Floats:
        """(4, 4), T_parent_imu: takes points of the IMU's frame to the parent's."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.R, self.t
        return T

    @property
    def covariance(self) -> Floats | None:
        """(6, 6), m², m rad, rad²: tx ty tz rx ry rz in the parent frame, exp([phi]x) R.

        None where the method states none.
        """
        return self.estimate.covariance

    @property
    def time_offset(self) -> float:
        """IMU stamp - robot stamp of the same instant, s."""
        return self.estimate.time_offset

    @property
    def details(self) -> Details:
        """Series and curves behind the estimate, each computed when first read.

        Raises:
            InputError: It is by the published method, which keeps none.
        """
        if self.estimate.details is None:
            raise InputError("the published method keeps no series: use MatchedOptions")
        return self.estimate.details

    @property
    def residuals(self) -> WindowSeries:
        """What was measured and what the motion predicts over time.

        Raises:
            InputError: As :attr:`details`.
        """
        return self.details.windows

    def render(self, form: str, *, force: bool = False) -> str:
        """The result in a format of ``imucalib run --format``: yaml, json, urdf, tf, ...

        Args:
            form: Its name.
            force: Give a bare pose although it should not be trusted.

        Raises:
            ChoiceError: There is no such format.
            UntrustedError: The format is a bare pose, which should not be trusted.
        """
        if form not in FORMATS:
            raise ChoiceError(f"no format {form}: choose {', '.join(FORMATS)}")
        if FORMATS[form].is_bare_pose:
            refuse_untrusted(self.result, form, force=force)
        return FORMATS[form].render([self.result])

    def __str__(self) -> str:
        return summarise(self.result)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {printable(verdict(self.result))}>"

    def _repr_html_(self) -> str:
        left = 'style="text-align:left"'
        rows = [f"<caption {left}><b>{as_html(verdict(self.result))}</b></caption>"]
        for section in sections(self.result):
            title = ": ".join(filter(None, (section.title, section.formula)))
            rows.append(f'<tr><th colspan="2" {left}>{as_html(title)}</th>')
            rows += [
                f"<tr><td {left}>{as_html(field.label)}</td><td {left}>{as_html(field.text)}</td>"
                for field in section.fields
            ]
        return f"<table>{''.join(rows)}</table>"


def calibrate(
    logs: StrPath | Sequence[StrPath],
    *,
    urdf: StrPath | None = None,
    imu_topic: str | None = None,
    joint_topics: Sequence[str] = (),
    pose_topics: Sequence[str] = (),
    parent: str | None = None,
    imu_link: str | None = None,
    base_imu: str | None = None,
    world: str | None = None,
    clock: ClockChoice = "auto",
    units: Units | None = None,
    csv_columns: Sequence[str] = (),
    joints: Sequence[str] = (),
    gyro_topic: str | None = None,
    accel_topic: str | None = None,
    start: float | None = None,
    end: float | None = None,
    description_topic: str | None = None,
    joint_prefix: str | None = None,
    estimator: MatchedOptions | PaperOptions | None = None,
    imu_model: StrPath | None = None,
    require: Tolerance | None = None,
    allow_remote_scan: bool = False,
    progress: Progress | None = None,
) -> Calibration:
    """Find where an IMU sits on the robot from a recording, as ``imucalib run`` does.

    Args:
        logs: One recording: a ROS 1 bag, a ROS 2 folder or db3, an MCAP, a CSV; its URL; or the
            files of a split one.
        urdf: The robot's URDF; without it the log's /robot_description or its own frames must
            give the motion.
        imu_topic: Which IMU, if the log has several; ``topic:frame`` if they share a topic.
        joint_topics: Joint states to use; default: all.
        pose_topics: Poses to use; default: found.
        parent: Link or frame that carries the IMU; default: the parent of its messages' frame.
        imu_link: The IMU's link in the URDF; default: its messages' frame.
        base_imu: Topic of the IMU on a moving base; default: found, if nothing else shows how the
            base moves.
        world: Frame that stands still; default: the root frame.
        clock: Stamps of the headers, or times of receipt.
        units: What the IMU's numbers mean; detected from the log.
        csv_columns: Columns of tables without a header.
        joints: Which numbers of messages without names are joints, such as
            ``"/arm:data[0:2]=pan,lift"``.
        gyro_topic: Gyroscope that is apart from its accelerometer; found.
        accel_topic: Its accelerometer; found.
        start: Use the log from here (--from): s of the log, or a stamp, s since 1970.
        end: Use the log up to here (--to).
        description_topic: Topic of the URDF in the log, where several fit.
        joint_prefix: What the log's joint names have before those of the URDF, or lack; found.
        estimator: Method and options.
        imu_model: Which IMU it is, a name of configs/imus or a YAML file: weak priors.
        require: Largest sigma to trust.
        allow_remote_scan: Download a remote log that cannot be read in parts.
        progress: Told what is being done and its share, 0 to 1 or None.

    Returns:
        The calibration, whether it may be trusted or not: see :attr:`Calibration.ok`.

    Raises:
        InputError: A file cannot be used.
        ChoiceError: Something must be chosen, such as the IMU.
        UntrustedError: Nothing moves in the log.
    """
    for name, value in (("start", start), ("end", end)):
        _check_type(name, value, (int, float))
    paths = [logs] if isinstance(logs, (str, os.PathLike)) else list(_texts("logs", logs, _PATH))
    request = _request(
        logs=tuple(_path_or_url("logs", path) for path in paths),
        urdf=urdf,
        imu_topics=_one("imu_topic", imu_topic),
        joint_topics=_texts("joint_topics", joint_topics),
        pose_topics=_texts("pose_topics", pose_topics),
        parent=parent,
        imu_link=imu_link,
        base_imu=base_imu,
        world=world,
        clock=clock,
        units=units,
        csv_columns=_texts("csv_columns", csv_columns),
        joint_columns=tuple(map(_joint_columns, _texts("joints", joints))),
        gyro_topics=_one("gyro_topic", gyro_topic),
        accel_topics=_one("accel_topic", accel_topic),
        part=part_asked(start, end),
        description_topics=_one("description_topic", description_topic),
        joint_prefix=joint_prefix,
        estimator=estimator,
        imu_model=imu_model,
        require=require,
        allow_remote_scan=allow_remote_scan,
    )
    with removing_copies():
        recording = read_recording(request, progress or unheard)
        if len(recording.imus) > 1:
            topics = ", ".join(imu.name for imu in recording.imus)
            raise ChoiceError(f"the log has several IMUs: choose one by imu_topic: {topics}")
        return _calibrated(recording, request, progress)


def calibrate_arrays(
    *,
    t: ArrayLike,
    gyro: ArrayLike,
    accel: ArrayLike,
    pose_t: ArrayLike | None = None,
    positions: ArrayLike | None = None,
    quaternions_xyzw: ArrayLike | None = None,
    joint_t: ArrayLike | None = None,
    joint_positions: ArrayLike | None = None,
    joint_names: Sequence[str] = (),
    urdf: StrPath | None = None,
    parent: str | None = None,
    imu_link: str | None = None,
    world: str | None = None,
    units: Units | None = None,
    estimator: MatchedOptions | PaperOptions | None = None,
    imu_model: StrPath | None = None,
    require: Tolerance | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Find where an IMU sits on the robot from samples in memory.

    The motion is given by poses of the parent link; or by joint positions with a URDF; or by both,
    where the poses are those of the URDF's root, an arm on a moving base. The streams may have any
    rates and stamps, which need not be regular.

    Args:
        t: (N,), s, of the IMU's samples; stamps of all streams share one epoch, any.
        gyro: (N, 3), rad/s, IMU axes.
        accel: (N, 3), m/s², IMU axes; at rest it points up.
        pose_t: (M,), s.
        positions: (M, 3), m, in the world.
        quaternions_xyzw: (M, 4), R_world_parent; need not be normalised.
        joint_t: (K,), s.
        joint_positions: (K, J), rad or m.
        joint_names: Of the J columns, as in the URDF.
        urdf: The robot's URDF.
        parent: Link that carries the IMU; with joints the one that holds imu_link in the URDF.
        imu_link: The IMU's link in the URDF, or what to call it.
        world: Frame that stands still.
        units: As for :func:`calibrate`.
        estimator: As for :func:`calibrate`.
        imu_model: As for :func:`calibrate`.
        require: As for :func:`calibrate`.
        progress: As for :func:`calibrate`.

    Returns:
        As :func:`calibrate`.

    Raises:
        InputError: Shapes do not fit, a value is no finite number, or the URDF cannot be used.
        ChoiceError: An argument is missing.
        UntrustedError: Nothing moves.
    """
    data, epoch_ns = streams_of(
        t=t,
        gyro=gyro,
        accel=accel,
        pose_t=pose_t,
        positions=positions,
        quaternions_xyzw=quaternions_xyzw,
        joint_t=joint_t,
        joint_positions=joint_positions,
        joint_names=_texts("joint_names", joint_names),
        frame=imu_link or "imu",
        world=world or "world",
    )
    if data.joints and urdf is None:
        raise ChoiceError("joint positions cannot be used without the robot's chain: give urdf")
    if not data.joints and urdf is not None and parent is None:
        raise ChoiceError("poses without joints are those of the IMU's parent: name it by parent")
    request = _request(
        logs=(),
        urdf=urdf,
        parent=parent or ("body" if urdf is None else None),
        imu_link=imu_link,
        world=world,
        clock="header",
        units=units,
        estimator=estimator,
        imu_model=imu_model,
        require=require,
    )
    return _calibrated(recording_of(data, request, epoch_ns=epoch_ns), request, progress)


def _request(
    *,
    urdf: StrPath | None,
    units: Units | None,
    estimator: MatchedOptions | PaperOptions | None,
    imu_model: StrPath | None,
    **given: Any,
) -> CalibrationRequest:
    for name in ("parent", "imu_link", "base_imu", "world", "joint_prefix"):
        _check_type(name, given.get(name), (str,))
    _check_type("units", units, (Units,))
    _check_type("estimator", estimator, (MatchedOptions, PaperOptions))
    _check_type("require", given["require"], (Tolerance,))
    options = estimator or MatchedOptions()
    _check_values("clock", given["clock"], ClockChoice)
    pose = options.pose if isinstance(options, MatchedOptions) else None
    for name, group in (("units", units), ("estimator", options), ("estimator.pose", pose)):
        if group is not None:
            _check_values(name, asdict(group), type(group))
    return CalibrationRequest(
        urdf=None if urdf is None else _path_or_url("urdf", urdf),
        units=units or Units(),
        estimator=options,
        imu=None if imu_model is None else _expected(imu_model, options),
        details=True,
        **given,
    )


def _expected(imu_model: StrPath, options: MatchedOptions | PaperOptions) -> ExpectedImu:
    """An IMU by its data sheet, with priors of the biases that the options leave free."""
    stds: dict[Sensor, float] = {}
    if isinstance(options, MatchedOptions):
        stds = {"accel": options.accel_bias_std, "gyro": options.gyro_bias_std}
    priors = tuple(sensor for sensor, std in stds.items() if np.isinf(std))
    return ExpectedImu(model=load_imu_model(_path("imu_model", imu_model)), priors=priors)


def _calibrated(
    recording: Recording, request: CalibrationRequest, progress: Progress | None
) -> Calibration:
    with one_thread():
        outcome = calibrate_recording(recording, request, progress or unheard)
    for failure in outcome.failures:
        raise failure
    (only,) = outcome.calibrated
    start_ns = recording.clock.origin_ns + recording.epoch_ns
    return Calibration(result=only.result, estimate=only.estimate, start_ns=start_ns)


_PATH = (str, os.PathLike)


def _check_type(name: str, value: object, kinds: tuple[type, ...]) -> None:
    """Raise ChoiceError where an argument is neither None nor of some types."""
    if value is not None and not isinstance(value, kinds):
        wanted = " or ".join(kind.__name__ for kind in kinds)
        raise ChoiceError(f"{name} is of the type {type(value).__name__}: give {wanted}")


def _check_values(name: str, value: object, kind: Any) -> None:
    """Raise ChoiceError where an argument, or a field of one, is not one of its type's values."""
    try:
        convert(value, kind)
    except ValidationError as error:
        raise ChoiceError(f"{name}: {error}") from error


def _joint_columns(text: str) -> JointColumns:
    try:
        return joint_columns(text)
    except ValueError as error:
        raise ChoiceError(f"joints {error}") from error


def _one(name: str, value: str | None) -> tuple[str, ...]:
    return () if value is None else _texts(name, [value])


def _texts(name: str, values: Any, kinds: tuple[type, ...] = (str,)) -> tuple[Any, ...]:
    """A sequence of texts as a tuple; ChoiceError where it is something else."""
    _check_type(name, values, (list, tuple))
    for value in values or ():
        _check_type(name, value, kinds)
    return tuple(values or ())


def _path_or_url(name: str, value: Any) -> LogPath:
    _path(name, value)
    return path_or_url(os.fspath(value))


def _path(name: str, value: Any) -> Path:
    """A path that names something; ChoiceError where it does not."""
    _check_type(name, value, _PATH)
    text = os.fspath(value)
    if not isinstance(text, str) or not text or "\0" in text:
        raise ChoiceError(f"{name} is no path: {text!r}")
    return Path(text)
