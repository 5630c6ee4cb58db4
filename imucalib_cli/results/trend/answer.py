"""The answer of trend: a tree from which text and JSON Schema come.

Fields are written in this order under these names. A text below a field is its description in the
JSON Schema. Differences are later - earlier, in the parent frame.
"""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from msgspec import Meta

from imucalib_cli.results.comparison.answers import RotationEntry, TranslationEntry, Within
from imucalib_cli.results.result import Matrix6, Quaternion, Tree, Vector3

Time = Annotated[datetime, Meta(tz=True)]
Moved = Literal["not moved", "moved", "drifting", "unknown"]
Order = Literal["recording time", "as given"]


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
    """Rotation vector likewise, about the parent's axes."""
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
