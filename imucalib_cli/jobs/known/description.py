"""The URDF that a log holds: what robot_state_publisher says on /robot_description."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.findings import Finding, note, warning
from imucalib_cli.robot.names import in_namespace, prefixes, renamed
from imucalib_cli.robot.urdf import parse_robot

if TYPE_CHECKING:
    from collections.abc import Iterable

    from imucalib_cli.jobs.input.request import CalibrationRequest
    from imucalib_cli.logs.log import LogData
    from imucalib_cli.robot.urdf import Robot


def described_robot(
    data: LogData, request: CalibrationRequest
) -> tuple[Robot | None, tuple[Finding, ...]]:
    """The robot of the log's own description; None where it has none that can be used.

    Of several it is the one to which the log's joints and frames belong.

    Raises:
        ChoiceError: Several descriptions fit.
        InputError: That of the topic which the user named is no URDF.
    """
    candidates: dict[str, tuple[Robot, str]] = {}
    findings: list[Finding] = []
    for topic, texts in data.texts.items():
        for text in texts:
            try:
                robot = parse_robot(text.encode(), Path(topic))
            except InputError as error:
                if request.description_topics:
                    raise
                findings.append(warning("robot.description_unusable", reason=str(error)))
            else:
                candidates.setdefault(robot.sha256, (robot, topic))
    if not candidates:
        return None, tuple(findings)
    scores = {key: _score(robot, data) for key, (robot, _) in candidates.items()}
    best = [candidates[key] for key, score in scores.items() if score == max(scores.values())]
    topics = [topic for _, topic in best]
    near = in_namespace(topics, [imu.topic for imu in data.imus.values()])
    if len(near) == 1 and topics.count(near[0]) == 1:
        best = [best[topics.index(near[0])]]
    if len(best) > 1:
        raise ChoiceError(_several(best), option="--description-topic")
    chosen, topic = best[0]
    values = {"topic": topic, "robot": chosen.name, "sha256": chosen.sha256}
    return chosen, (*findings, note("robot.described", **values))


def _score(robot: Robot, data: LogData) -> int:
    """Names of the log that are joints and links of a robot."""
    streams = [stream for some in data.joints.values() for stream in some]
    joints = {name for stream in streams for name in stream.names}
    frames = {imu.frame_id for imu in data.imus.values()}
    return _known(joints, robot.moving_joints) + _known(frames, robot.links)


def _known(names: set[str], known: Iterable[str]) -> int:
    known = set(known)
    by_prefix = (len(renamed(names, known, prefix)) for prefix in prefixes(names, known))
    return len(names & known) + max(by_prefix, default=0)


def _several(best: list[tuple[Robot, str]]) -> str:
    topics = list(dict.fromkeys(topic for _, topic in best))
    if len(topics) > 1:
        listed = ", ".join(f"{topic} (robot '{robot.name}')" for robot, topic in best)
        return (
            f"several robot descriptions fit the log: {listed}: choose one --description-topic, "
            "or the IMU of one robot with --imu-topic"
        )
    return (
        f"{topics[0]} has {len(best)} different robot descriptions that fit the log: save the "
        "right one as a file and give --urdf"
    )
