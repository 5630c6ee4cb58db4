"""What is known about a recording without calibrating, and how it is shown."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from msgspec import Struct, to_builtins
from msgspec.structs import replace

from imucalib_cli.layout import Table
from imucalib_cli.results.from_estimate import finding_entry

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from imucalib_cli.findings import Finding
    from imucalib_cli.layout import Block
    from imucalib_cli.logs.messages.table import Kind
    from imucalib_cli.logs.reader import Topic
    from imucalib_cli.signals.imu.stream_health import StampHealth
    from imucalib_cli.signals.imu.units import UnitGuess
    from imucalib_cli.signals.samples import Sensor

_READ_AS: dict[Kind, str] = {"imu": "IMU", "joints": "joints", "pose": "poses", "text": "text"}
_TOPIC = ("topic", "type", "read as", "messages", "seconds", "Hz")
_HEALTH = ("stream", "Hz", "jitter ms", "gaps", "longest s", "same", "bunched", "back", "zero")
"""Heads of the two tables."""


class Health(Struct, frozen=True, kw_only=True):
    """Stamps of one topic, or of one stream of it."""

    name: str
    """Topic, and frames or joints where it holds several streams."""
    header: StampHealth
    """Of the header stamps, or of the counter that stands in for them."""
    log: StampHealth
    counter: str | None = None
    """Topic whose messages have a counter of ms in place of a header stamp."""


class ImuFinding(Struct, frozen=True, kw_only=True):
    """One IMU: its values, and the link that carries it."""

    topic: str
    frame_id: str
    units: UnitGuess
    absent: tuple[Sensor, ...] = ()
    """Sensors that the log has only as NaN."""
    parent: str | None = None
    """Frame that a run would take as its parent."""
    world: str | None = None
    motion: tuple[str, ...] = ()
    """Topics of the parent's motion."""
    problem: str | None = None
    """Why it cannot be calibrated with these options."""
    needs_choice: bool = False
    """Whether an option solves the problem."""
    solved_by: str | None = None
    """That option, if there is only one, such as ``--parent``."""
    moves_like: tuple[str, ...] = ()
    """If the parent is not known: links that move as the IMU does."""
    still: bool = False
    """If the parent is not known: whether the IMU stands still while the robot moves."""
    base_imu: str | None = None
    """The IMU that measures how the base moves; perhaps this one."""
    parent_unnamed: bool = False
    """Whether the parent's poses name no frame, so that their topic names it."""

    @property
    def floats(self) -> bool:
        """Whether its accelerometer shows no gravity."""
        return self.units.accel_unit == "m/s², no gravity"


class JointFinding(Struct, frozen=True, kw_only=True):
    """Joints of one publisher."""

    topic: str
    names: tuple[str, ...]
    missing: tuple[str, ...] | None
    """Joints that are not in the URDF; None without a URDF."""


class PoseFinding(Struct, frozen=True, kw_only=True):
    """One edge of the frames' tree."""

    topic: str
    parent: str
    child: str
    is_static: bool


class Inspection(Struct, frozen=True, kw_only=True):
    """Everything known about a recording without calibrating."""

    files: tuple[str, ...]
    topics: tuple[Topic, ...]
    health: tuple[Health, ...]
    clock: str
    imus: tuple[ImuFinding, ...]
    joints: tuple[JointFinding, ...]
    poses: tuple[PoseFinding, ...]
    urdf: str | None
    findings: tuple[Finding, ...]
    command: str | None
    """To run next; None if no command would work."""
    placeholders: str
    """Placeholders in the commands that the user must replace."""
    more_commands: tuple[str, ...] = ()
    """Commands for further IMUs."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings in words."""
        return tuple(finding.message for finding in self.findings)

    def as_json(self) -> str:
        """Everything, as JSON-ready data."""
        imus = tuple(replace(imu, units=replace(imu.units, findings=())) for imu in self.imus)
        content = to_builtins(replace(self, findings=(), imus=imus))
        for topic, entry in zip(self.topics, content["topics"], strict=True):
            del entry["definition"]
            entry["columns"] = topic.columns and str(topic.columns)
            entry["read_as"] = tuple(topic.kinds)
        content |= {"findings": _entries(self.findings), "warnings": self.warnings}
        for imu, entry in zip(self.imus, content["imus"], strict=True):
            units = imu.units
            entry["units"] |= {"findings": _entries(units.findings), "warnings": units.warnings}
        return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"

    def blocks(self) -> Iterator[Block]:
        """Everything, as lines and tables for people."""
        yield f"log       {', '.join(self.files)}"
        if self.urdf is not None:
            yield f"urdf      {self.urdf}"
        yield ""
        yield Table(_TOPIC, tuple(map(_topic_row, self.topics)), frozenset(_TOPIC[3:]))
        if self.health:
            yield ""
            yield f"stamps    {self._stamps()} would be used"
            kind = "log" if self.clock == "log" else "header"
            health = tuple(_health_row(each, kind) for each in self.health)
            yield Table(_HEALTH, health, frozenset(_HEALTH[1:]))
        yield ""
        yield from self._imu_lines()
        yield from self._motion_lines()
        yield from (f"{each.severity.value:<10}{each.message}" for each in self.findings)
        yield ""
        if self.command is None:
            yield "There is nothing to run on this log; see above."
        else:
            replace = f" (replace {self.placeholders})" if self.placeholders else ""
            yield f"Run{replace}:"
            yield f"    {self.command}"
            yield from (f"    {command}" for command in self.more_commands)

    def _stamps(self) -> str:
        """The stamps that a run takes, of messages without a header too."""
        counters = dict.fromkeys(each.counter for each in self.health if each.counter)
        if self.clock == "log" or not counters:
            return f"{self.clock} stamps"
        of = f"the counter tick, ms, of {', '.join(counters)}"
        only = all(each.counter for each in self.health)
        return f"{of}, which has no header stamp," if only else f"header stamps, and {of},"

    def _imu_lines(self) -> Iterator[str]:
        if not self.imus:
            yield "imu       none: no sensor_msgs/Imu with messages"
        for imu in self.imus:
            units = imu.units
            accel = f"accel at rest {units.accel_at_rest:.4g} ({units.accel_unit})"
            gyro = f"gyro up to {units.gyro_largest:.3g} ({units.gyro_unit})"
            both = {"accel": accel, "gyro": gyro}
            both |= {sensor: f"{sensor} all NaN" for sensor in imu.absent}
            yield f"imu       {imu.topic}, frame '{imu.frame_id}': {', '.join(both.values())}"
            moved = f"moved in {imu.world} by {', '.join(imu.motion)}"
            if imu.base_imu == imu.topic:
                moved = "measures how it moves"
            yield f"          {imu.problem or f'carried by {imu.parent}, {moved}'}"

    def _motion_lines(self) -> Iterator[str]:
        for joint in self.joints:
            yield f"joints    {joint.topic}: {', '.join(joint.names)}"
            if joint.missing:
                yield f"          not in the URDF: {', '.join(joint.missing)}"
        for pose in self.poses:
            static = " (static)" if pose.is_static else ""
            child = pose.child or "(no child frame)"
            yield f"pose      {pose.topic}: {child} in {pose.parent}{static}"


def _entries(findings: Iterable[Finding]) -> list[object]:
    return [to_builtins(finding_entry(finding)) for finding in findings]


def _topic_row(topic: Topic) -> tuple[str, ...]:
    seconds = (topic.end_ns - topic.start_ns) * 1e-9
    rate = f"{(topic.count - 1) / seconds:.1f}" if topic.count > 1 and seconds > 0 else "-"
    read_as = ", ".join(_READ_AS[kind] for kind in topic.kinds) or "-"
    kind = topic.type or topic.encoding
    return topic.name, kind, read_as, str(topic.count), f"{seconds:.1f}", rate


def _health_row(each: Health, kind: str) -> tuple[str, ...]:
    health = each.log if kind == "log" else each.header
    return (
        each.name,
        f"{health.rate_hz:.1f}",
        f"{health.jitter * 1e3:.2f}",
        str(health.gaps),
        f"{health.longest_gap:.3f}",
        *map(str, (health.duplicates, health.bursts, health.backwards, health.zeros)),
    )
