"""Studies that cannot run or go on, and files of Kalibr's that do not fit."""

from __future__ import annotations

import fcntl
import sys
from typing import TYPE_CHECKING
from unittest.mock import patch

import yaml

from tests.troubleshooting.provoke_results import result
from tests.troubleshooting.scene import Scene, Seen, provokes

if TYPE_CHECKING:
    from pathlib import Path


def study(scene: Scene, name: str = "noise") -> Seen:
    return scene.cli("study", name, "--quick", "-o", scene.path("study"))


def rows(scene: Scene, content: str) -> Path:
    """The file of that study."""
    scene.path("study").mkdir()
    file = scene.path("study") / "noise-quick.jsonl"
    file.write_text(content)
    return file


@provokes("study-needs")
def _(scene: Scene) -> Seen:
    with patch.dict(sys.modules, {"cv2": None}):
        return study(scene, "methods")


@provokes("study-rows")
def _(scene: Scene) -> Seen:
    rows(scene, "some notes\n")
    return study(scene)


@provokes("study-other")
def _(scene: Scene) -> Seen:
    rows(scene, '{"study": "noise", "imucalib": "0.0.1", "config": {}}\n')
    return study(scene)


@provokes("study-twice")
def _(scene: Scene) -> Seen:
    with rows(scene, "").open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        return study(scene)


def compare(scene: Scene, kalibr: Path) -> Seen:
    options = ["--kalibr", kalibr, "--urdf", scene.urdf(), "--camera-link", "camera_link"]
    return scene.cli("compare", result(scene), *options)


@provokes("compare-far")
def _(scene: Scene) -> Seen:
    upright = [[float(row == column) for column in range(4)] for row in range(4)]
    scene.path("kalibr.yaml").write_text(yaml.safe_dump({"cam0": {"T_cam_imu": upright}}))
    return compare(scene, scene.path("kalibr.yaml"))


@provokes("compare-not-kalibr")
def _(scene: Scene) -> Seen:
    scene.path("kalibr.yaml").write_text("cam0: {rostopic: /cam0/image_raw}\n")
    return compare(scene, scene.path("kalibr.yaml"))
