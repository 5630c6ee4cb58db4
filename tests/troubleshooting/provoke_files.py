"""Files and options: what cannot be read, found, chosen, compared or written."""

import fcntl
import os
import re
import resource
import shutil
import signal
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import yaml

from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.recording import rows_kept
from imucalib_cli.simulate.urdf import urdf_text
from tests.conftest import LogWriter
from tests.jobs.driving import drive, with_a_camera_frame
from tests.jobs.robots import SHAPES, random_mount, record
from tests.jobs.robots import messages as robot_messages
from tests.jobs.walking import LEG, LONG, OTHER, ROBOT, TRUNK, log_of, walk, walk_on_two_legs
from tests.logs.logs_samples import vector
from tests.logs.logs_samples import write_log as write_messages
from tests.troubleshooting.provoke_recordings import on_the_base
from tests.troubleshooting.scene import (
    ARM,
    BODY,
    Edit,
    Provocation,
    Scene,
    Seen,
    joint,
    noisy,
    on_arm,
    provocation,
)
from tests.web_server import serving
from tools.mcap_file import Payload, write_payloads

LINK = '<link name="base_link" />'
NAMES = tuple(joint.name for joint in load_system(ARM).joints)


@provocation
def on_a_moving_base(scene: Scene, /, *options: str, urdf: bool = True, **log: Any) -> Seen:
    """An arm on a base that moves, without the IMU in its URDF."""
    shape, file = SHAPES["arm on a moving base"], scene.path("robot.urdf")
    file.write_text(shape.urdf())
    made = record(shape, scene.path("log"), mount=random_mount(3), seconds=12.0, **log)
    return scene.cli("run", made, *(("--urdf", file) if urdf else ()), *options)


def two_robots(scene: Scene) -> Seen:
    """Two alike, in namespaces."""
    shape, file = SHAPES["pan and tilt on a lift"], scene.path("robot.urdf")
    file.write_text(shape.urdf())
    said = [
        each
        for seed, space in enumerate(("/left", "/right"))
        for each in robot_messages(
            shape, mount=random_mount(4), namespace=space, seed=seed, seconds=12.0
        )
    ]
    said.sort(key=lambda each: each.log_ns)
    log = write_messages(scene.path("log"), said, "mcap2")
    options = ("--imu-topic", "/left/imu", "--parent", "tilt_link")
    return scene.cli("run", log, "--urdf", file, *options)


def planar_askew(scene: Scene) -> Seen:
    log, _ = drive(scene.folder, seconds=15.0)
    urdf = with_a_camera_frame(scene.folder, "0 0.6 0")
    return scene.cli("run", log, "--urdf", urdf, "--planar")


@provocation
def at(scene: Scene, name: str, prepare: Callable[[Path], object]) -> Seen:
    """`imucalib run` on a path where there is no sound log."""
    prepare(scene.path(name))
    return scene.run(scene.path(name))


@provocation
def spoilt(
    scene: Scene, /, change: Callable[[bytes], bytes], name: str = "log.mcap", **options: Any
) -> Seen:
    """The arm's log with other bytes."""
    log = scene.log(noisy(), name, **options)
    log.write_bytes(change(log.read_bytes()))
    return scene.run(log)


def cut(data: bytes) -> bytes:
    """The first part of a log, as a full disk leaves it."""
    return data[: int(0.8 * len(data))]


def several_recordings(scene: Scene) -> Seen:
    for name in ("a", "b"):
        shutil.copy(scene.writer(name).imu().joints().write(), scene.path(f"{name}.mcap"))
        shutil.rmtree(scene.path(name))
    return scene.run(scene.folder)


def unindexed(data: bytes) -> bytes:
    """A bag whose header marks it as never closed: the index begins at 0."""
    at = data.index(b"index_pos=") + len(b"index_pos=")
    index = int.from_bytes(data[at : at + 8], "little")
    return (data[:at] + bytes(8) + data[at + 8 :])[:index]


def with_zeros(data: bytes) -> bytes:
    """A log with damage in the middle."""
    middle = len(data) // 2
    return data[:middle] + bytes(64) + data[middle + 64 :]


def overlap(scene: Scene) -> Seen:
    other = scene.log(noisy(), "b.mcap", imu_topic="/imu/other")
    return scene.run(scene.log(noisy(), "a.mcap"), other, "--imu-topic", "/imu/data")


def other_encoding(scene: Scene) -> Seen:
    said = Payload("/imu", "json", ("foxglove.Imu", "jsonschema", b"{}"), b"{}", 1)
    return scene.run(write_payloads(scene.path("log.mcap"), [said]))


def no_memory(scene: Scene) -> Seen:
    with patch("imucalib_cli.jobs.input.recording.open_log", side_effect=MemoryError):
        return scene.run("log.mcap")


def holds_too_much(scene: Scene) -> Seen:
    """As if the last tenth were too much."""
    log = scene.log(noisy())
    with (
        patch("imucalib_cli.logs.decoding.decode.MESSAGES_PER_BYTE", 0.0),
        patch("imucalib_cli.logs.decoding.decode.MESSAGES_ALWAYS", 4300),
    ):
        return scene.run(log)


@provocation
def urdf(scene: Scene, edit: Edit) -> Seen:
    """A sound log beside a URDF that is none."""
    scene.urdf(edit)
    return scene.run(scene.writer().imu().joints().write())


@provocation
def remote(scene: Scene, /, url: str = "", **behaviour: Any) -> Seen:
    """A log behind a URL, or else of a server with a fault."""
    log = scene.writer().imu().write()
    with (
        patch("imucalib_cli.logs.remote.http.PAUSE_S", 0.0),
        serving(log.parent, **behaviour) as web,
    ):
        seen = scene.cli("run", url or web.url(log.name))
        return replace(seen, err=seen.err.replace(web.address, "HOST"))


REMOTE: dict[str, Provocation] = {
    "remote-package": remote("s3://bucket/log.mcap"),
    "remote-whole": remote(ranges=False),
    "remote-missing": remote(status=404),
    "remote-denied": remote(status=403),
    "remote-no-host": remote("http://robot.invalid/log.mcap"),
    "remote-fails": remote(break_after=10),
    "remote-changed": remote(changes_after=1),
}

READING: dict[str, Provocation] = {
    "no-file": at("log.mcap", lambda _: None),
    "pipe": at("log.mcap", os.mkfifo),
    "empty": at("log.mcap", lambda path: path.touch()),
    "not-a-log": lambda scene: scene.run(scene.urdf()),
    "no-log-in-folder": at("recording", lambda path: path.mkdir()),
    "several-recordings": several_recordings,
    "cut-short": spoilt(cut),
    "cut-short-bag": spoilt(cut, "log.bag"),
    "cut-short-db3": spoilt(cut, "log.db3"),
    "unindexed": spoilt(unindexed, "log.bag", compression="none"),
    "damaged-chunk": spoilt(with_zeros, compression="none"),
    "two-recordings": lambda scene: scene.run(
        scene.log(noisy(), "a.mcap"), scene.log(noisy(), "b.mcap")
    ),
    "overlap-of-files": overlap,
    "other-encoding": other_encoding,
    "no-memory": no_memory,
    "holds-too-much": holds_too_much,
    "xacro": urdf(
        lambda text: text.replace(
            "<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ', 1
        ).replace(LINK, LINK + '<xacro:arm prefix="left_"/>')
    ),
    "not-xml": urdf(lambda text: text.replace("</robot>", "")),
    "not-a-urdf": urdf(lambda _: '<sdf version="1.7"><model name="arm"/></sdf>'),
    "doctype": urdf(
        lambda text: text.replace("<robot", '<!DOCTYPE robot [<!ENTITY a "b">]><robot', 1)
    ),
    "undefined-link": urdf(lambda text: text.replace(LINK, "")),
    "two-roots": urdf(lambda text: text.replace(LINK, LINK + '<link name="table"/>')),
    "urdf-millimetres": urdf(joint("elbow_joint", "-0.6127 0 0", "-612700 0 0")),
}


def messages(make: Callable[[LogWriter], LogWriter], *arguments: object) -> Provocation:
    """`imucalib run` without a URDF on four seconds of messages."""
    return lambda scene: scene.cli("run", make(scene.writer()).write(), *arguments)


@provocation
def arm_messages(
    scene: Scene,
    *arguments: object,
    make: Callable[[LogWriter], LogWriter] = lambda log: log,
    frame: str = "imu_link",
    names: tuple[str, ...] = NAMES,
) -> Seen:
    """The same with the arm's URDF, on an IMU, the arm's joints and what ``make`` adds."""
    log = make(scene.writer().imu(frame=frame).joints(names=names))
    return scene.run(log.write(), *arguments)


def prefixed(scene: Scene) -> Seen:
    """The arm's log with names that the URDF has without prefixes."""
    return scene.run(scene.log(noisy(), joint_prefix="left_", frame_prefix="robot1/"))


@provocation
def described(scene: Scene, said: dict[str, Edit]) -> Seen:
    """The arm's joints with descriptions of robots by their topics, and no URDF."""
    log = scene.writer().imu().joints(names=NAMES)
    for topic, edit in said.items():
        log.text(topic, edit(urdf_text(load_system(ARM))))
    return scene.cli("run", log.write())


def description_unusable(scene: Scene) -> Seen:
    """A body that is tracked, beside a description that was cut short."""
    described = scene.writer().text("/robot_description", "<robot").write()
    log = scene.log(noisy(BODY), imu_frame="bar_link")
    return scene.cli("run", log, described, "--gravity", "none")


def frames_mixed(scene: Scene) -> Seen:
    recording = noisy()
    early = recording.imu.t < 16.0
    first = replace(recording, imu=rows_kept(recording.imu, early))
    last = replace(recording, imu=rows_kept(recording.imu, ~early), robot=())
    return scene.run(scene.log(first, "a.mcap"), scene.log(last, "b.mcap", imu_frame="imu"))


def force_reversed(imu: Any) -> Any:
    """An accelerometer that points down at rest."""
    f = imu.linear_acceleration
    return replace(imu, linear_acceleration=vector((-f.x, -f.y, -f.z)))


def about_z(imu: Any) -> Any:
    """An IMU that is mounted a quarter turn from where its frame is."""
    both = imu.angular_velocity, imu.linear_acceleration
    w, f = (vector((-each.y, each.x, each.z)) for each in both)
    return replace(imu, angular_velocity=w, linear_acceleration=f)


def later(imu: Any) -> Any:
    """Stamps of another clock."""
    stamp = replace(imu.header.stamp, sec=imu.header.stamp.sec + 1)
    return replace(imu, header=replace(imu.header, stamp=stamp))


@provocation
def walking(
    scene: Scene,
    *arguments: str,
    topics: tuple[str, ...] = (LEG,),
    frame: str = "",
    change: Callable[[Any], Any] = lambda message: message,
    described: bool = True,
) -> Seen:
    """A log of a robot on legs, its trunk's IMU, perhaps changed, joints and these topics."""
    text = ROBOT.urdf()
    urdf = scene.path("robot.urdf")
    urdf.write_text(text.replace("trunk_imu", frame) if frame else text)
    walked = walk(LONG)
    raw = [replace(each, topic="/imu/raw") for each in walked if each.topic == TRUNK]
    said = tuple(
        replace(each, message=change(each.message)) if each.topic == TRUNK else each
        for each in sorted([*walked, *raw], key=lambda each: each.log_ns)
    )
    log = log_of(scene.folder, TRUNK, "/joint_states", *topics, said=said)
    return scene.run(log, *arguments) if described else scene.cli("run", log, *arguments)


@provocation
def two_legs(scene: Scene, edit: Edit = lambda text: text) -> Seen:
    """Such a log with an IMU on another leg too, and the robot's URDF, perhaps spoilt."""
    scene.path("robot.urdf").write_text(edit(ROBOT.urdf()))
    topics = (TRUNK, LEG, OTHER, "/joint_states")
    log = log_of(scene.folder, *topics, said=walk_on_two_legs(LONG))
    return scene.run(log, "--parent", f"{OTHER}=FR_calf_link")


CHOICES: dict[str, Provocation] = {
    "no-imu": lambda scene: scene.run(scene.writer().joints().text().write()),
    "imus-together": two_legs(),
    "imus-disagree": two_legs(joint("FR_hip", 'rpy="0 0 0"', 'rpy="0 0.02 0.02"')),
    "base-imu": walking(),
    "base-imu-not-there": walking("--base-imu", "/imu/trank"),
    "base-imu-no-urdf": walking("--base-imu", TRUNK, described=False),
    "base-imu-alone": walking("--base-imu", TRUNK, "--imu-topic", TRUNK),
    "base-imu-published": walking("--method", "paper"),
    "base-imu-twice": walking(topics=("/imu/raw",)),
    "base-imu-unplaced": walking("--base-imu", TRUNK, frame="other"),
    "base-imu-down": walking(change=force_reversed),
    "base-imu-turned": walking(change=about_z),
    "base-imu-late": walking(change=later),
    "base-imu-still": lambda scene: scene.run(
        scene.writer().imu(gyro=0.01).imu("/imu/2").joints(names=NAMES).write(),
        *("--base-imu", "/imu/data"),
    ),
    "no-motion-topic": lambda scene: scene.run(scene.writer().imu().text().write()),
    "topic-not-there": arm_messages("--imu-topic", "/imu"),
    "topic-of-another-type": arm_messages("--imu-topic", "/joint_states"),
    "no-urdf": messages(lambda log: log.imu().joints(names=NAMES)),
    "no-joint-states": lambda scene: scene.run(scene.writer().imu().tf("map", "base_link").write()),
    "joint-missing": arm_messages(names=(*NAMES[:5], "wrist_4_joint")),
    "joint-prefix-missing": arm_messages(names=tuple(f"left{name}" for name in NAMES)),
    "joint-prefix": prefixed,
    "joint-prefix-unsure": arm_messages(
        names=tuple(f"{arm}_{name}" for arm in ("left", "right") for name in NAMES)
    ),
    "joint-prefix-wrong": arm_messages("--joint-prefix", "right_"),
    "frame-prefix": prefixed,
    "description": lambda scene: scene.cli("run", scene.log(noisy(), robot_description=True)),
    "description-unusable": description_unusable,
    "descriptions": described(
        {
            "/left/robot_description": lambda text: text,
            "/right/robot_description": lambda text: text.replace("rihibot", "other"),
        }
    ),
    "urdf-unused": lambda scene: scene.run(
        scene.log(noisy(BODY), imu_frame="bar_link"), "--gravity", "none"
    ),
    "frame-not-in-urdf": arm_messages(frame="imu"),
    "moves-like": lambda scene: scene.run(scene.log(noisy(), imu_frame="imu")),
    "still-unnamed": lambda scene: scene.run(scene.log(on_the_base(), imu_frame="imu")),
    "base-unread": on_a_moving_base(base_topic="/mocap"),
    "base-unread-poor": on_a_moving_base("--parent", "upper", base_topic="/mocap"),
    "planar-arm": on_arm(noisy, "--planar"),
    "planar-askew": planar_askew,
    "planar-no-height": lambda scene: scene.cli(
        "run", drive(scene.folder, seconds=15.0)[0], "--planar"
    ),
    "frames-apart": lambda scene: scene.cli(
        "run", scene.writer().imu().tf("map", "body").tf("hand", "imu_link", moving=False).write()
    ),
    "chain-missing": on_a_moving_base(urdf=False),
    "robots-two": two_robots,
    "parent-twice": arm_messages("--parent", "wrist_3_link", "--parent", "wrist_2_link"),
    "parent-of-no-imu": arm_messages("--parent", "/imu/other=wrist_3_link"),
    "imu-of-no-frame": arm_messages(
        "--imu-topic", "/imu/data:tool1", make=lambda log: log.imu(frame="tool0")
    ),
    "part-empty": arm_messages("--from", "10"),
    "frame-empty": arm_messages(frame=""),
    "parent-misspelt": arm_messages("--parent", "wrist_3"),
    "parent-is-imu": arm_messages("--parent", "imu_link"),
    "joint-twice": arm_messages(
        make=lambda log: log.joints("/controller/joint_states", names=NAMES)
    ),
    "several-imus-one-link": arm_messages(
        "--imu-link", "imu_link", make=lambda log: log.imu("/imu/other")
    ),
    "several-poses": messages(lambda log: log.imu().poses("/mocap/hand").poses("/mocap/table")),
    "which-frame": messages(lambda log: log.imu().tf("map", "base").tf("base", "hand")),
    "no-such-frame": messages(lambda log: log.imu().tf("map", "base"), "--parent", "hand"),
    "separate-trees": messages(
        lambda log: log.imu().tf("map", "base").tf("room", "hand"),
        *("--parent", "hand", "--world", "map"),
    ),
    "never-moves": arm_messages("--parent", "base_link"),
    "pose-told-twice": messages(
        lambda log: log.imu().tf("map", "hand").tf("odom", "hand"), "--parent", "hand"
    ),
    "frames-mixed": frames_mixed,
}


def edited(path: Path, pattern: str, new: str) -> Path:
    """A result with something changed by hand."""
    text, count = re.subn(pattern, new, path.read_text(), count=1)
    assert count == 1
    path.write_text(text)
    return path


@provocation
def applied(scene: Scene, content: str) -> Seen:
    """`imucalib apply` of a file that is no result."""
    scene.path("result.yaml").write_text(content)
    return scene.cli("apply", scene.path("result.yaml"), "--urdf", scene.urdf())


def verified(*arguments: object, edit: Edit = lambda text: text, **options: str) -> Provocation:
    """`imucalib verify` on the arm."""
    return lambda scene: scene.cli(
        "verify", scene.log(noisy(), **options), "--urdf", scene.urdf(edit), *arguments
    )


@provocation
def compared(scene: Scene, *edits: tuple[str, str], seed: int = 4) -> Seen:
    """`imucalib diff` of two results, the second one edited."""
    a, b = scene.result("a.yaml"), scene.result("b.yaml", seed=seed)
    for pattern, new in edits:
        edited(b, pattern, new)
    return scene.cli("diff", a, b)


@provocation
def followed(scene: Scene, *edits: tuple[int, str, str], count: int = 4) -> Seen:
    """`imucalib trend` of results of several logs, some edited."""
    results = [scene.result(f"{k}.yaml", seed=3 + k) for k in range(count)]
    for place, pattern, new in edits:
        edited(results[place], pattern, new)
    return scene.cli("trend", *results, "--format", "csv")


def diff_unpaired(scene: Scene) -> Seen:
    a, b = scene.result("a.yaml"), scene.result("b.yaml", seed=4)
    first = a.read_text()
    second = edited(edited(a, "child: imu_link", "child: other"), "imu: /imu/data", "imu: /other")
    a.write_text(first + "---\n" + second.read_text())
    return scene.cli("diff", a, b)


def apply_two_results(scene: Scene) -> Seen:
    both = "---\n".join(scene.result(f"{seed}.yaml", seed=seed).read_text() for seed in (3, 4))
    return applied(both)(scene)


def apply_no_joint(scene: Scene) -> Seen:
    result = edited(scene.result(), "child: imu_link", "child: imu")
    return scene.cli("apply", result, "--urdf", scene.urdf())


def kinematics_of_another_urdf(scene: Scene) -> Seen:
    scene.urdf(joint("elbow_joint", 'xyz="-0.6127', 'xyz="-0.6087'))
    result = scene.result()
    return scene.cli("apply", result, "--urdf", scene.urdf(), "--kinematics")


def kinematics_of_two(scene: Scene) -> Seen:
    scene.urdf(joint("elbow_joint", 'xyz="-0.6127', 'xyz="-0.6087'))
    one = edited(scene.result("one.yaml"), "child: imu_link", "child: imu")
    other = scene.result("other.yaml", seed=4)
    urdf = scene.path("robot.urdf")
    return scene.cli("apply", one, other, "--urdf", urdf, "--kinematics", "--add")


@provocation
def written(scene: Scene, name: str, prepare: Callable[[Scene], object] = lambda _: None) -> Seen:
    """`imucalib run -o` to that name in the folder, where something may lie."""
    log = scene.log(noisy())
    prepare(scene)
    return scene.run(log, "-o", scene.path(name))


def output_full(scene: Scene) -> Seen:
    log = scene.log(noisy())
    scene.urdf()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))
    try:
        return scene.run(log, "-o", scene.path("result.yaml"))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)


def a_foreign_result(scene: Scene) -> None:
    scene.path("results").mkdir()
    scene.path("results/log.imu_link.yaml").write_text("something else")


_MOVED = (r"translation: \[-0\.02\d+", "translation: [-0.0245")
RESULTS: dict[str, Provocation] = {
    "yaml-alias": applied("a: &a [*a]\n"),
    "yaml-deep": applied("a: " + "[" * 100),
    "yaml-twice": applied("schema: 1\nschema: 1\n"),
    "verify-no": verified("--within", "1mm,0.1deg"),
    "verify-between": verified("--within", "4.38mm,5deg"),
    "verify-untrusted": verified(
        edit=joint("elbow_joint", 'axis xyz="0 0 1"', 'axis xyz="0 0 -1"')
    ),
    "verify-no-pose": verified("--parent", "wrist_3_link", imu_frame="imu"),
    "verify-no-urdf": lambda scene: scene.cli(
        *("verify", scene.log(noisy(BODY), imu_frame="imu")),
        *("--parent", "bar_link", "--gravity", "none"),
    ),
    "diff-moved": compared(_MOVED),
    "diff-same-log": compared(seed=3),
    "diff-unpaired": diff_unpaired,
    "diff-parents": compared(("parent: wrist_3_link", "parent: flange")),
    "trend-moved": followed(*((k, *_MOVED) for k in (2, 3))),
    "trend-odd-last": followed((3, *_MOVED)),
    "trend-at-once": followed(),
    "trend-unknown-time": followed((1, "start: .*", "start: null"), count=2),
    "covariance-edited": compared((r"(covariance:[^,]*,) [^,]*", r"\1 1.0")),
    "not-a-result": applied("arm: rihibot\n"),
    "apply-two-results": apply_two_results,
    "apply-no-joint": apply_no_joint,
    "kinematics-other-urdf": kinematics_of_another_urdf,
    "kinematics-two": kinematics_of_two,
    "kinematics-in-place": lambda scene: scene.cli(
        "apply", scene.result(), "--urdf", scene.urdf(), "--kinematics", "--in-place"
    ),
    "untrusted-format": on_arm(noisy, "--format", "urdf", "--require", "0.001mm"),
    "output-is-input": written("log.mcap"),
    "output-folder": written("missing/result.yaml"),
    "output-full": output_full,
    "output-twice": lambda scene: scene.cli(
        *("simulate", "barbot", "-o", scene.path("same.mcap"), "--urdf", scene.path("same.mcap"))
    ),
    "output-is-log": written(
        "other.mcap", lambda scene: shutil.copy(scene.path("log.mcap"), scene.path("other.mcap"))
    ),
    "output-is-urdf": written(
        "other.urdf", lambda scene: shutil.copy(scene.urdf(), scene.path("other.urdf"))
    ),
    "output-empty": on_arm(noisy, "-o", ""),
    "output-numbered": written("results", a_foreign_result),
    "output-older": lambda scene: scene.run(scene.path("missing.mcap"), "-o", scene.result()),
    "output-protected": written(
        "result.yaml", lambda scene: scene.path("result.yaml").touch(mode=0o444)
    ),
}


def study(scene: Scene, name: str = "noise") -> Seen:
    return scene.cli("study", name, "--quick", "-o", scene.path("study"))


def study_needs(scene: Scene) -> Seen:
    with patch.dict(sys.modules, {"cv2": None}):
        return study(scene, "methods")


@provocation
def rows_of_study(scene: Scene, content: str, *, locked: bool = False) -> Seen:
    """A study whose file holds that already."""
    scene.path("study").mkdir()
    with scene.path("study/noise-quick.jsonl").open("w") as file:
        file.write(content)
        file.flush()
        if locked:
            fcntl.flock(file, fcntl.LOCK_EX)
        return study(scene)


@provocation
def compared_with_kalibr(scene: Scene, content: str) -> Seen:
    """`imucalib compare` with that file of Kalibr's."""
    scene.path("kalibr.yaml").write_text(content)
    options = ["--kalibr", scene.path("kalibr.yaml"), "--camera-link", "camera_link"]
    return scene.cli("compare", scene.result(), "--urdf", scene.urdf(), *options)


UPRIGHT = [[float(row == column) for column in range(4)] for row in range(4)]
STUDIES: dict[str, Provocation] = {
    "study-needs": study_needs,
    "study-rows": rows_of_study("some notes\n"),
    "study-other": rows_of_study('{"study": "noise", "imucalib": "0.0.1", "config": {}}\n'),
    "study-twice": rows_of_study("", locked=True),
    "compare-far": compared_with_kalibr(yaml.safe_dump({"cam0": {"T_cam_imu": UPRIGHT}})),
    "compare-not-kalibr": compared_with_kalibr("cam0: {rostopic: /cam0/image_raw}\n"),
}
