"""Topics, frames and links that are not there, or that leave a choice."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from tests.troubleshooting.scene import Scene, Seen, noisy, provokes, row, with_imu

if TYPE_CHECKING:
    from tests.conftest import LogWriter

_ROWS = ("t", "stamp", "received", "gyro", "accel")
NAMES = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)


def arm(scene: Scene, *, frame: str = "imu_link", names: tuple[str, ...] = NAMES) -> LogWriter:
    """An IMU and the arm's joints."""
    return scene.writer().imu(frame=frame).joints(names=names)


@provokes("no-imu")
def _(scene: Scene) -> Seen:
    return scene.run(scene.writer().joints().text().write())


@provokes("no-motion-topic")
def _(scene: Scene) -> Seen:
    return scene.run(scene.writer().imu().text().write())


@provokes("topic-not-there")
def _(scene: Scene) -> Seen:
    return scene.run(arm(scene).write(), "--imu-topic", "/imu")


@provokes("topic-of-another-type")
def _(scene: Scene) -> Seen:
    return scene.run(arm(scene).write(), "--imu-topic", "/joint_states")


@provokes("no-urdf")
def _(scene: Scene) -> Seen:
    return scene.cli("run", arm(scene).write())


@provokes("no-joint-states")
def _(scene: Scene) -> Seen:
    return scene.run(scene.writer().imu().tf("map", "base_link").write())


@provokes("joint-missing")
def _(scene: Scene) -> Seen:
    return scene.run(arm(scene, names=(*NAMES[:5], "wrist_4_joint")).write())


@provokes("joint-prefix-missing")
def _(scene: Scene) -> Seen:
    return scene.run(arm(scene, names=tuple(f"left_{name}" for name in NAMES)).write())


@provokes("joint-prefix-extra")
def _(scene: Scene) -> Seen:
    scene.urdf(lambda text: text.replace('joint name="', 'joint name="left_'))
    return scene.run(arm(scene).write())


@provokes("frame-not-in-urdf")
def _(scene: Scene) -> Seen:
    return scene.run(arm(scene, frame="imu").write())


@provokes("frame-empty")
def _(scene: Scene) -> Seen:
    return scene.run(arm(scene, frame="").write())


@provokes("parent-misspelt")
def _(scene: Scene) -> Seen:
    return scene.run(arm(scene).write(), "--parent", "wrist_3")


@provokes("parent-is-imu")
def _(scene: Scene) -> Seen:
    return scene.run(arm(scene).write(), "--parent", "imu_link")


@provokes("joint-twice")
def _(scene: Scene) -> Seen:
    log = arm(scene).joints("/controller/joint_states", names=NAMES).write()
    return scene.run(log)


@provokes("several-imus-one-link")
def _(scene: Scene) -> Seen:
    return scene.run(arm(scene).imu("/imu/other").write(), "--imu-link", "imu_link")


@provokes("several-poses")
def _(scene: Scene) -> Seen:
    log = scene.writer().imu().poses("/mocap/hand").poses("/mocap/table").write()
    return scene.cli("run", log)


@provokes("which-frame")
def _(scene: Scene) -> Seen:
    log = scene.writer().imu().tf("map", "base").tf("base", "hand").write()
    return scene.cli("run", log)


@provokes("no-such-frame")
def _(scene: Scene) -> Seen:
    return scene.cli("run", scene.writer().imu().tf("map", "base").write(), "--parent", "hand")


@provokes("separate-trees")
def _(scene: Scene) -> Seen:
    log = scene.writer().imu().tf("map", "base").tf("room", "hand").write()
    return scene.cli("run", log, "--parent", "hand", "--world", "map")


@provokes("never-moves")
def _(scene: Scene) -> Seen:
    return scene.run(arm(scene).write(), "--parent", "base_link")


@provokes("pose-told-twice")
def _(scene: Scene) -> Seen:
    log = scene.writer().imu().tf("map", "hand").tf("odom", "hand").write()
    return scene.cli("run", log, "--parent", "hand")


@provokes("frames-mixed")
def _(scene: Scene) -> Seen:
    recording = noisy("rihibot")
    first, last = (
        with_imu(recording, **{name: getattr(recording.imu, name)[part] for name in _ROWS})
        for part in (slice(0, row(16.0)), slice(row(16.0), None))
    )
    last = replace(last, robot=())
    logs = scene.log(first, "a.mcap"), scene.log(last, "b.mcap", imu_frame="imu")
    return scene.run(*logs)
