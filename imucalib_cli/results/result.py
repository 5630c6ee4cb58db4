"""The frozen result of one IMU: the tree that defines codec, checks and JSON Schema.

Fields are written in this order with these names. The docstring of a field is its description in
the JSON Schema. SI units and radians unless a name says otherwise; quaternions are x y z w with
w >= 0. An unknown number is null.
"""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from msgspec import UNSET, Meta, UnsetType, field

from imucalib_cli.estimate.entries import (
    CorrectionEntry,
    CorrectionName,
    ImuModelEntry,
    Kind,
    ParameterEntry,
    Unobservable,
    WindowEntry,
)
from imucalib_cli.results.pose import UncertainPose
from imucalib_cli.robot.mount import NominalPose
from imucalib_cli.robot.rotations import matrix_from_quaternion
from imucalib_cli.tree import Tree, Vector3

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats

Scalar = bool | int | float | str | None
Status = Literal["ok", "untrusted"]
Vector3OrNull = Annotated[list[float | None], Meta(min_length=3, max_length=3)]
_NUMBER = {"type": "number"}
_WITH_W_AT_LEAST_0 = {"prefixItems": [_NUMBER, _NUMBER, _NUMBER, _NUMBER | {"minimum": 0}]}
Quaternion = Annotated[
    list[float],
    Meta(min_length=4, max_length=4, extra_json_schema=_WITH_W_AT_LEAST_0),
]
Range = Annotated[list[float], Meta(min_length=2, max_length=2)]
Matrix6 = Annotated[
    list[Annotated[list[float | None], Meta(min_length=6, max_length=6)]],
    Meta(min_length=6, max_length=6),
]
_Few = Meta(max_length=100)
_Row = Scalar | Annotated[list[Scalar | Annotated[list[Scalar], _Few]], _Few]
Value = Scalar | Annotated[list[_Row], Meta(max_length=10_000)]
"""Of a finding: numbers and texts, or lists of them up to three deep."""

SCHEMA: Literal[1] = 1
"""Version of the document; adding a key keeps it, changing one raises it."""


class Pose(Tree, frozen=True):
    """A pose in the three ways a result writes it."""

    translation: Vector3
    """m."""
    rotation_xyzw: Quaternion
    rotation_rpy: Vector3
    """rad, as URDF has it: Rz(yaw) Ry(pitch) Rx(roll)."""

    @property
    def R(self) -> Floats:
        """(3, 3)."""
        return matrix_from_quaternion(self.rotation_xyzw)

    @property
    def t(self) -> Floats:
        """(3,), m."""
        return np.array(self.translation)


class Transform(Tree, frozen=True):
    """T_parent_child: p_parent = R p_child + t. Null where the motion did not determine it."""

    parent: str
    child: str
    translation: Vector3OrNull
    """m."""
    rotation_xyzw: Quaternion | None
    rotation_rpy: Vector3 | None
    """rad, as URDF has it: Rz(yaw) Ry(pitch) Rx(roll)."""


class Std(Tree, frozen=True):
    """1 sigma along and about the parent's axes."""

    translation_mm: Vector3OrNull
    rotation_deg: Vector3OrNull


class TimeOffset(Tree, frozen=True):
    """IMU stamp - robot stamp of the same instant: t_robot = t_imu - seconds."""

    seconds: float
    std: float | None
    """null where it was not estimated."""


class Bias(Tree, frozen=True):
    """Of one sensor, IMU frame."""

    value: Vector3
    std: Vector3OrNull | None
    """null where it was not estimated."""


class Observable(Tree, frozen=True):
    """A direction of the pose that the motion determined although it left others open."""

    kind: Kind
    direction_parent: Vector3
    """Unit vector in the parent frame: along it, or about it."""
    value: float | None
    """Where the IMU is along it, m; null for rotation."""
    std: float
    """1 sigma, m or rad."""


class FindingEntry(Tree, frozen=True):
    """What was found out about the log, the robot or the result, with a code for programs."""

    code: str
    """Short and stable, such as stamps.bunched; text for a sentence without a code."""
    severity: Literal["note", "warning", "untrusted"]
    """untrusted makes the status untrusted; the others do not."""
    values: dict[str, Value]
    """The numbers, SI units and radians unless a name says otherwise, and names of topics, streams,
    joints and files; nan and inf are texts."""
    message: str
    """The finding in words."""


class NominalEntry(Tree, frozen=True):
    """The pose that the URDF (or /tf_static) has, and how far the found one is from it."""

    joint: str
    """The URDF's fixed joint; empty where no single joint says so."""
    translation: Vector3
    """m."""
    rotation_xyzw: Quaternion
    rotation_rpy: Vector3
    """rad."""
    distance_mm: float
    distance_deg: float


class ResidualRms(Tree, frozen=True):
    """Root mean square of the window residuals, parent axes."""

    accel: Vector3OrNull
    """m/s2."""
    gyro: Vector3OrNull
    """rad/s."""


class ResidualNormalised(Tree, frozen=True):
    """residual_rms over what the sensor's own white noise leaves in a window; 1 is noise alone."""

    accel: Vector3
    gyro: Vector3


class Tangent(Tree, frozen=True):
    """Along and about the parent's axes."""

    translation_mm: Vector3
    rotation_deg: Vector3


class Halves(Tree, frozen=True):
    """Pose by the second half of the log less pose by the first."""

    translation_mm: Vector3
    """Along the parent's axes."""
    rotation_deg: Vector3
    """About the parent's axes."""
    sigmas: float
    """Root mean square of the difference in sigmas; 1 is chance."""


class Whiteness(Tree, frozen=True):
    """Loudest band of the residuals' spectrum over the median band; 1 is white."""

    accel: float
    gyro: float


class ConsistencyEntry(Tree, frozen=True):
    """How well the parts of the log agree; null where it is too short to be cut."""

    folds: int
    """Contiguous segments of the log."""
    fold_std: Tangent
    """Standard deviation of the pose by leaving each segment out in turn (jackknife)."""
    halves: Halves
    segment_chi2: float
    """Scatter of the segments over what noise explains; 1 is noise alone."""
    whiteness: Whiteness


class BetweenLogs(Tree, frozen=True):
    """Scatter of one component of the pose between logs, 1 sigma: more than noise within a log."""

    translation_mm: float
    """The likely value."""
    translation_mm_95: Range
    """Between these it is, with 95 %."""
    rotation_deg: float
    rotation_deg_95: Range


class CombinedLog(Tree, frozen=True):
    """One of several logs that were solved together."""

    name: str
    """Of the file of its statistics, or of the log."""
    files: list[str]
    """Of the log."""
    distance: Tangent
    """Its pose less that of all the others."""
    distance_mm: float
    distance_deg: float
    sigmas: float
    """Size of that distance in standard deviations, the scatter between logs included; six
    components together: 2.4 is usual."""
    disagrees: bool
    """Whether neither chance nor the scatter of the others explains it."""
    time_offset: float
    """s."""
    accel_bias: Vector3
    """m/s2, IMU frame."""
    gyro_bias: Vector3
    """rad/s, IMU frame."""
    gravity_world: Vector3
    """m/s2."""


class LeftOut(Tree, frozen=True):
    """A log that was not used."""

    name: str
    reason: str


class CombinedEntry(Tree, frozen=True):
    """Several logs solved together.

    time_offset and the biases of the result are the means of the logs', and their std is how far
    that of one log is from it.
    """

    logs: list[CombinedLog]
    between_logs: BetweenLogs
    left_out: list[LeftOut]


class Diagnostics(Tree, frozen=True, kw_only=True):
    """The evidence. What has a default is not in results of earlier versions."""

    method: Literal["matched", "paper"]
    unobservable: list[Unobservable]
    observable: list[Observable] = field(default_factory=list)
    """Where something is unobservable: what the motion determined nevertheless."""
    findings: list[FindingEntry] = field(default_factory=list)
    """distrust and warnings are the messages of these: of severity untrusted, and of the others."""
    distrust: list[str]
    warnings: list[str]
    sigma_source: Literal["noise", "segments"]
    """noise; segments in results of earlier versions, whose sigma was widened by the scatter of
    parts of the log."""
    corrections: dict[CorrectionName, CorrectionEntry] = field(default_factory=dict)
    """Errors of the sensor or the clocks, by name, that clearly exceed their sigma and are
    corrected; the time offset is the gyroscope's, in the middle of the log."""
    parameters: list[ParameterEntry] = field(default_factory=list)
    """Every unknown other than the pose."""
    nominal: NominalEntry | None
    window: WindowEntry
    residual_rms: ResidualRms
    residual_normalised: ResidualNormalised | None = None
    """null where the method does not tell."""
    consistency: ConsistencyEntry | None = None
    imu_model: ImuModelEntry | None = None
    """null where none was named."""
    combined: CombinedEntry | None = None
    """null where the result is of one log."""
    windows_used: int
    windows_dropped: int
    samples_replaced: int
    gaps: int
    notes: dict[str, Scalar]
    """Further diagnostics by name, for the record."""


class RemoteEntry(Tree, frozen=True):
    """A file behind a URL, as its server described it."""

    bytes: int | None
    """Size; null where the server does not tell."""
    version: str | None
    """Entity tag, or time of the last change; null where the server tells neither."""


class SourceFile(Tree, frozen=True):
    """A file that was read."""

    path: str
    """As the user named it; a URL without user, password and query. Of a URDF that the log holds,
    its topic."""
    sha256: Annotated[str, Meta(pattern="^[0-9a-f]{64}$")] | None
    """Hexadecimal, of the file's bytes; null for a remote file of which only parts were read."""
    remote: RemoteEntry | UnsetType = UNSET
    """Only of a file behind a URL."""

    @property
    def identity(self) -> str:
        """The same text for files of the same content, as far as the content is known."""
        if self.sha256 is not None:
            return f"sha256 {self.sha256}"
        if self.remote is UNSET:
            return self.path
        return f"{self.path} {self.remote.bytes} bytes, version {self.remote.version}"


class Topics(Tree, frozen=True):
    """What was read of the log."""

    imu: str
    motion: list[str]
    """Topics that say how the parent link moves."""


class RecordingEntry(Tree, frozen=True):
    """When the IMU was recorded, for how long, and with how many samples."""

    start: Annotated[datetime, Meta(tz=True)] | None
    """Date and time of the first sample, UTC; null where no stamp of the log tells the date."""
    duration: Annotated[float, Meta(ge=0)]
    """s, from the first sample that was used to the last."""
    imu_samples: int
    """In the log."""
    imu_rate: float
    """Hz, of samples that follow each other without a gap."""
    motion_samples: int
    """Messages that say how the parent link moves."""


class Provenance(Tree, frozen=True):
    """Where a result came from: enough to make it again."""

    tool: Literal["imucalib"]
    version: str
    files: list[SourceFile]
    urdf: SourceFile | None
    topics: Topics
    world: str
    """Frame that gravity_world is expressed in."""
    clock: str
    """Which stamps were used: header or log."""
    options: dict[str, Scalar]
    part: Range | UnsetType = UNSET
    """From and to, seconds of the log, where only a part of it was used (--from, --to)."""

    @property
    def log_identity(self) -> tuple[str, ...]:
        """The same value for results of the same log, or of the same part of it."""
        part = () if self.part is UNSET else (f"part {self.part}",)
        return (*sorted(file.identity for file in self.files), *part)

    @property
    def robot(self) -> str | None:
        """The same text for URDFs of the same content; None without a URDF."""
        return None if self.urdf is None else self.urdf.identity

    recording: RecordingEntry | None = None
    """null in results of earlier versions."""

    def shares_data_with(self, other: Provenance) -> bool:
        """Whether two results use the same samples, as overlapping parts of a log do."""
        if {file.identity for file in self.files}.isdisjoint(file.identity for file in other.files):
            return False
        if self.part is UNSET or other.part is UNSET:
            return True
        return self.part[0] < other.part[1] and other.part[0] < self.part[1]


class Result(Tree, frozen=True, kw_only=True):
    """Pose of one IMU in its parent link.

    Covariances are in the order tx ty tz rx ry rz, parent frame, rotation perturbed as
    exp([phi]x) R.
    """

    schema: Literal[1]
    status: Status
    """untrusted: something was not determined or contradicts the result; see
    diagnostics.unobservable and diagnostics.distrust."""
    transform: Transform
    partial: Pose | UnsetType = UNSET
    """Only where transform has nulls: all values, which are valid only if the values in the
    undetermined directions, which are guesses, are right."""
    covariance: Matrix6 | None
    """6x6, m2, m rad, rad2; null where the method states none."""
    std: Std | None
    time_offset: TimeOffset
    accel_bias: Bias
    """m/s2."""
    gyro_bias: Bias
    """rad/s."""
    gravity_world: Vector3
    """m/s2, in the world frame; zero where there is none."""
    diagnostics: Diagnostics
    provenance: Provenance

    @property
    def parent(self) -> str:
        """Link that carries the IMU."""
        return self.transform.parent

    @property
    def child(self) -> str:
        """The IMU's frame."""
        return self.transform.child

    @property
    def imu_topic(self) -> str:
        """Of the log."""
        return self.provenance.topics.imu

    @property
    def recorded_at(self) -> datetime | None:
        """Start of the recording, UTC; None where it is unknown."""
        recording = self.provenance.recording
        return None if recording is None else recording.start

    @property
    def mount(self) -> tuple[str, str, str]:
        """Parent, child and topic: the same for results of one mount."""
        return self.parent, self.child, self.imu_topic

    @property
    def pose(self) -> Pose:
        """The pose; the conditional one where some of it is not determined."""
        if self.partial is not UNSET:
            return self.partial
        shown: Any = self.transform  # has no nulls then, which the reader checks
        return Pose(shown.translation, shown.rotation_xyzw, shown.rotation_rpy)

    @property
    def nominal(self) -> NominalPose | None:
        """The same pose by the URDF or the log's own frames."""
        said = self.diagnostics.nominal
        if said is None:
            return None
        R, t = matrix_from_quaternion(said.rotation_xyzw), np.array(said.translation)
        return NominalPose(joint=said.joint, R_parent_imu=R, t_parent_imu=t)

    @property
    def uncertain_pose(self) -> UncertainPose:
        """The pose with its covariance, if no number of it is missing."""
        covariance = np.array(self.covariance, dtype=np.float64)  # nan where there is none
        unknown: dict[Kind, list[Vector3]] = {"translation": [], "rotation": []}
        for each in self.diagnostics.unobservable:
            unknown[each.kind].append(each.direction_parent)
        return UncertainPose(
            parent=self.parent,
            child=self.child,
            R=self.pose.R,
            t=self.pose.t,
            covariance=covariance if np.isfinite(covariance).all() else None,
            unknown_translation=np.reshape(unknown["translation"], (-1, 3)),
            unknown_rotation=np.reshape(unknown["rotation"], (-1, 3)),
        )
