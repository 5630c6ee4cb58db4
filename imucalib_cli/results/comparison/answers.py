"""The answers of verify, diff, trend and compare: trees that define text and JSON Schema.

Fields are written in this order with these names. The docstring of a field is its description in
the JSON Schema. Differences are found - nominal (verify), second - first (diff), later -
earlier (trend) or Kalibr's - ours (compare), in the parent frame.
"""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING, Annotated, Literal

from msgspec import UNSET, Meta, UnsetType

from imucalib_cli.layout import csv_columns
from imucalib_cli.results.codec import json_schema
from imucalib_cli.results.result import (
    Matrix6,
    Pose,
    Quaternion,
    Range,
    Result,
    SourceFile,
    Status,
)
from imucalib_cli.tree import Tree, Vector3

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

Verdict = Literal["yes", "no", "unknown"]
"""Whether two poses agree."""
Size = Annotated[float, Meta(ge=0)]
Time = Annotated[datetime, Meta(tz=True)]
Moved = Literal["not moved", "moved", "drifting", "unknown"]
Order = Literal["recording time", "as given"]


class Within(Tree, frozen=True):
    """What is near enough."""

    translation_mm: float
    rotation_deg: float


class TestEntry(Tree, frozen=True):
    """Chi-squared of a difference against none, in what both poses know."""

    chi2: float | None
    """null where a sigma is zero."""
    degrees_of_freedom: int
    p_value: float
    """Chance that noise alone differs as much."""


class TranslationEntry(Tree, frozen=True, kw_only=True):
    """How far the translation differs, and how surely."""

    verdict: Verdict | UnsetType = UNSET
    """Of verify alone."""
    difference_mm: Size
    """Norm of the translation."""
    sigma_mm: float | None
    """1 sigma of it, such that difference + 2 sigma is the farther of between; null without
    covariance."""
    between_mm: Range | None
    """Nearest and farthest within two sigma."""
    vector_mm: Vector3
    """Parent frame."""
    std_mm: Vector3 | None
    """1 sigma along the parent's axes."""
    unknown_directions: list[Vector3]
    """Unit vectors along which nothing is known."""
    test: TestEntry | None


class RotationEntry(Tree, frozen=True, kw_only=True):
    """How far the rotation differs, and how surely."""

    verdict: Verdict | UnsetType = UNSET
    """Of verify alone."""
    difference_deg: Size
    """Geodesic angle."""
    sigma_deg: float | None
    """1 sigma of it, such that difference + 2 sigma is the farther of between; null without
    covariance."""
    between_deg: Range | None
    """Nearest and farthest within two sigma."""
    vector_deg: Vector3
    """Rotation vector, parent frame."""
    std_deg: Vector3 | None
    """1 sigma about the parent's axes."""
    unknown_directions: list[Vector3]
    """Unit vectors about which nothing is known."""
    test: TestEntry | None


class Significance(Tree, frozen=True):
    """Of the part that differs by more sigma."""

    of: Literal["translation", "rotation"]
    sigmas: float | None
    """Norm over its sigma; null where sigma is zero."""


class NominalPoseEntry(Tree, frozen=True):
    """The pose that is verified: of the URDF, or of the log's own frames."""

    joint: str
    """The URDF's fixed joint; empty where no single joint says so."""
    translation: Vector3
    """m."""
    rotation_xyzw: Quaternion
    rotation_rpy: Vector3
    """rad."""
    urdf: SourceFile | None
    """null where the pose is that of the log's own frames."""


class VerifyAnswer(Tree, frozen=True, rename={"nominal_pose": "told"}):
    """Whether a given pose is where a log, or a result, shows the IMU."""

    schema: Literal[1]
    comparison: Literal["verify"]
    verdict: Verdict
    """Text: YAML writers must quote yes and no."""
    reason: str
    """The verdict in a sentence with its figures, and what to do where there is something to do."""
    parent: str
    child: str
    within: Within
    translation: TranslationEntry
    rotation: RotationEntry
    significance: Significance | None
    nominal_pose: NominalPoseEntry
    found: Result
    ignored: tuple[str, ...] = ()
    """Components of the pose, along and about the parent's axes, that were not checked."""
    file: str | UnsetType = UNSET
    """Of the result; not there where a log was asked."""

    @property
    def about(self) -> str:
        """The file it is about; empty for a log."""
        return self.file or ""


class Side(Tree, frozen=True):
    """One of the two results."""

    file: str
    status: Status
    parent: str
    child: str
    imu: str
    """Topic."""
    logs: list[SourceFile]


class DiffAnswer(Tree, frozen=True):
    """Whether a mount has moved between two results."""

    schema: Literal[1]
    comparison: Literal["diff"]
    verdict: Literal["moved", "not moved", "unknown"]
    reason: str
    """The verdict in a sentence with its figures."""
    parent: str
    child: str
    within: Within | None
    """null: significance was asked for."""
    translation: TranslationEntry
    rotation: RotationEntry
    significance: Significance | None
    test: TestEntry | None
    """Of translation and rotation together, in what both results know."""
    covariance: Matrix6 | None
    """Of the difference: m2, m rad, rad2."""
    warnings: list[str]
    first: Side
    second: Side

    @property
    def about(self) -> str:
        """The file it is about."""
        return self.second.file


class TrendRecording(Tree, frozen=True, kw_only=True):
    """One result of the mount."""

    file: str
    start: Time | None
    """When it was recorded, UTC; null where the result does not know."""
    duration: float | None
    """s."""
    mount: Annotated[int, Meta(ge=1)] | None
    """Number in mounts, from 1 on; null where the recording is odd, and in a drift."""
    odd: bool
    translation: Vector3
    """m, parent frame."""
    rotation_xyzw: Quaternion
    shift_mm: Vector3
    """From the first of mounts, or from where a drift begins, along the parent's axes."""
    turn_deg: Vector3
    """Rotation vector from there, about the parent's axes."""
    std_mm: Vector3
    """1 sigma, as the result states it: without the scatter between recordings."""
    std_deg: Vector3


class MountEntry(Tree, frozen=True, kw_only=True):
    """A pose that several recordings in a row agree on."""

    first: str
    """File."""
    last: str
    recordings: int
    translation: Vector3
    """m."""
    rotation_xyzw: Quaternion
    rotation_rpy: Vector3
    """rad, as URDF has it: Rz(yaw) Ry(pitch) Rx(roll)."""
    covariance: Matrix6
    """6x6, m2, m rad, rad2, of the weighted mean, with the scatter between recordings; zero where
    every result holds the component."""


class ChangeEntry(Tree, frozen=True, kw_only=True):
    """A recording after which the mount has another pose."""

    after: str
    """File of the last recording before it."""
    before: str
    """File of the first recording after it."""
    after_start: Time | None
    before_start: Time | None
    translation: TranslationEntry
    rotation: RotationEntry
    evidence: float
    """Fall of the Bayesian information criterion by the change; from 20 on it is believed."""
    place_probability: float
    """That the change lies between these two recordings, rather than between two others of the same
    mounts."""
    other_urdf: bool
    """Whether the results from here on were made with another URDF."""


class OddEntry(Tree, frozen=True, kw_only=True):
    """A recording that agrees with none of its neighbours."""

    file: str
    start: Time | None
    translation: TranslationEntry
    """Off the mount around it."""
    rotation: RotationEntry
    evidence: float
    """Fall of the Bayesian information criterion where it is left out."""


class DriftEntry(Tree, frozen=True, kw_only=True):
    """A steady change, which explains the recordings better than steps do."""

    per: Literal["day", "recording"]
    translation_mm: Vector3
    translation_std_mm: Vector3
    rotation_deg: Vector3
    """Rotation vector."""
    rotation_std_deg: Vector3
    translation: TranslationEntry
    """Of all of it: last recording - first."""
    rotation: RotationEntry
    evidence: float
    """Fall of the Bayesian information criterion against a mount that stands still."""


class UnusedResult(Tree, frozen=True):
    """A result that is not used."""

    file: str
    reason: str


class Scatter(Tree, frozen=True):
    """1 sigma of a component from recording to recording, beyond what the results state."""

    translation_mm: float
    rotation_deg: float


class TrendAnswer(Tree, frozen=True, kw_only=True):
    """Whether the mount of one IMU has moved over many recordings."""

    schema: Literal[1]
    comparison: Literal["trend"]
    verdict: Moved
    reason: str
    """The verdict in a sentence with its figures."""
    parent: str
    child: str
    imu: str
    """Topic."""
    order: Order
    """Of the recordings: by recording time where every result knows it."""
    within: Within | None
    """What is no alarm; null: every change that is decisive is one."""
    scatter: Scatter | None
    """null where there are too few recordings to tell."""
    mounts: list[MountEntry]
    changes: list[ChangeEntry]
    odd: list[OddEntry]
    drift: DriftEntry | None
    recordings: list[TrendRecording]
    left_out: list[UnusedResult]
    warnings: list[str]


class Averaged(Tree, frozen=True):
    """The published comparison's metric: signs cancel in it."""

    metric: str
    translation_mm: float
    rotation_deg: float


class Distance(Tree, frozen=True):
    """How far one pose is from another."""

    distance_mm: float
    angle_deg: float
    """Geodesic."""
    averaged: Averaged


class FramePoses(Tree, frozen=True):
    """One pose of the IMU in both frames."""

    T_camera_imu: Pose
    T_parent_imu: Pose


class OurPose(Tree, frozen=True):
    """The result of imucalib."""

    file: str
    T_camera_imu: Pose
    T_parent_imu: Pose
    from_nominal: Distance | None
    error: Distance | None
    """Off the truth, in the frame that the pose was estimated in."""
    time_offset: float | None
    """s, IMU stamp - robot stamp."""


class KalibrPose(Tree, frozen=True):
    """The result of Kalibr."""

    file: str
    camera: str
    T_camera_imu: Pose
    T_parent_imu: Pose
    from_nominal: Distance | None
    error: Distance | None
    """Off the truth, in the frame that the pose was estimated in."""
    timeshift_cam_imu: float | None
    """s, IMU stamp - camera stamp."""


class TruthPose(Tree, frozen=True):
    """What is true about a simulated log."""

    file: str
    T_camera_imu: Pose | None
    T_parent_imu: Pose
    time_offset: float | None
    timeshift_cam_imu: float | None


class TimeShifts(Tree, frozen=True):
    """Of the IMU's stamps: ours against the robot's, Kalibr's against the camera's."""

    difference_ms: float
    """Kalibr's timeshift_cam_imu - our time_offset: robot stamp - camera stamp of the same instant,
    if both are right."""
    sigma_ms: float | None
    """Of ours; null where it has none."""
    camera_offset_ms: float
    """Camera stamp - robot stamp of the same instant, if both are right: - difference_ms."""
    imucalib_error_ms: float | None
    """Our time_offset - the true one; null without a truth."""
    kalibr_error_ms: float | None
    """Kalibr's timeshift_cam_imu - the true one; null without a truth that knows the camera."""


class KalibrAnswer(Tree, frozen=True):
    """A result of ours and one of Kalibr, in the camera's frame and in the parent link's."""

    schema: Literal[1]
    comparison: Literal["kalibr"]
    status: Status
    """Of our result."""
    reason: str
    """The figures in a sentence."""
    parent: str
    child: str
    camera_link: str
    """The camera's optical frame."""
    urdf: str
    translation: TranslationEntry
    rotation: RotationEntry
    test: TestEntry | None
    """Of translation and rotation together. All sigmas are ours: Kalibr's file has none."""
    time: TimeShifts | None
    """null where Kalibr estimated no time shift."""
    warnings: list[str]
    imucalib: OurPose
    kalibr: KalibrPose
    nominal: FramePoses | None
    """What the URDF says."""
    truth: TruthPose | None


def as_csv(answers: Sequence[VerifyAnswer | DiffAnswer]) -> str:
    """One row for each answer; unknown values are empty."""
    columns: dict[str, Callable[[VerifyAnswer | DiffAnswer], object]] = {
        "file": lambda answer: answer.about,
        "first": lambda answer: answer.first.file if isinstance(answer, DiffAnswer) else "",
        "parent": lambda answer: answer.parent,
        "child": lambda answer: answer.child,
        "verdict": lambda answer: answer.verdict,
        "distance_mm": lambda answer: answer.translation.difference_mm,
        "distance_sigma_mm": lambda answer: answer.translation.sigma_mm,
        "angle_deg": lambda answer: answer.rotation.difference_deg,
        "angle_sigma_deg": lambda answer: answer.rotation.sigma_deg,
        "reason": lambda answer: answer.reason,
    }
    return csv_columns(columns, ((answer,) for answer in answers))


def schema_of(which: Literal["result", "comparison"]) -> str:
    """JSON Schema of what ``run`` writes, or of the answers of the commands that compare."""
    several = "With --format json several IMUs give an array of these objects, with YAML a stream."
    if which == "result":
        return json_schema(
            "imucalib result, schema 1",
            "Pose of one IMU in its parent link. Adding a key keeps the schema number, changing "
            "one raises it. SI units and radians unless a key says otherwise; quaternions are "
            "x y z w with w >= 0; covariances are in the order tx ty tz rx ry rz, parent frame, "
            f"rotation perturbed as exp([phi]x) R. {several}",
            Result,
        )
    return json_schema(
        "imucalib verify, diff, trend and compare, schema 1",
        "Answer for one IMU. Adding a key keeps the schema number, changing one raises it. "
        "Differences are found - nominal (verify), second - first (diff) or Kalibr's - ours "
        f"(compare), in the parent frame. {several}",
        VerifyAnswer,
        DiffAnswer,
        TrendAnswer,
        KalibrAnswer,
    )
