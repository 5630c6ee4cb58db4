"""Configurations: what is read, what is refused, and that the URDF is the maker's UR10e."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.simulate.config import SystemConfig
from imucalib_cli.simulate.load import load_system, system_names
from imucalib_cli.simulate.simulate import stated
from imucalib_cli.simulate.urdf import urdf_text
from tests.simulate.simulate_samples import ROOT, configured

GONE = object()

# a, d, alpha of each joint, from the maker's table for UR10e
DH = [
    (0.0, 0.1807, np.pi / 2),
    (-0.6127, 0.0, 0.0),
    (-0.57155, 0.0, 0.0),
    (0.0, 0.17415, np.pi / 2),
    (0.0, 0.11985, -np.pi / 2),
    (0.0, 0.11655, 0.0),
]


def dh_flange(q: NDArray[np.float64]) -> NDArray[np.float64]:
    T = np.eye(4)
    for angle, (a, d, alpha) in zip(q, DH, strict=True):
        c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
        T = T @ np.array(
            [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        )
    return T


def test_urdf_matches_the_manufacturer_arm() -> None:
    model: Any = pin.buildModelFromXML(urdf_text(load_system("rihibot")))
    data = model.createData()
    rng = np.random.default_rng(0)
    for q in rng.uniform(-3, 3, (20, 6)):
        pin.framesForwardKinematics(model, data, q)
        flange = data.oMf[model.getFrameId("wrist_3_link")].homogeneous
        np.testing.assert_allclose(flange, dh_flange(q), atol=1e-12)
    assert sum(inertia.mass for inertia in model.inertias) == pytest.approx(29.104)
    assert model.existFrame("camera_link")


def test_only_builtin_systems_are_found() -> None:
    assert system_names() == ["barbot", "rihibot", "walker"]
    with pytest.raises(ChoiceError, match="choose barbot, rihibot, walker"):
        load_system("imu_grades")


def test_package_contains_configs_and_all_code() -> None:
    project = (ROOT / "pyproject.toml").read_text()
    init = (path.parent for path in (ROOT / "imucalib_cli").rglob("__init__.py"))
    folders = {".".join(path.relative_to(ROOT).parts) for path in init}
    listed = set(re.findall(r'^    "(imucalib_cli[.\w]*)",$', project, re.MULTILINE))
    assert listed == folders | {"imucalib_cli.configs"}
    assert '"imucalib_cli.configs" = "configs"' in project


def test_user_system_file_is_accepted(tmp_path: Path) -> None:
    change = {"duration": 7, "gravity": "1e-2"}
    system = load_system(configured(tmp_path, "barbot", lambda raw: raw.update(change)))
    assert isinstance(system, SystemConfig)
    assert system.duration == 7.0
    assert system.gravity == 0.01  # YAML reads 1e-2 as a word; we do not
    assert system.free_body == load_system("barbot").free_body


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"speed": 3}, "unknown key speed"),
        ({"imu": GONE}, "key imu is missing"),
        ({"duration": "long"}, "duration: 'long' does not fit"),
        ({"duration": True}, "duration: True does not fit"),
        ({"duration": float("inf")}, "duration: inf does not fit"),
        ({"duration": -1}, "must be positive"),
        ({"imu": [1, 2]}, "imu: expected keys and values"),
        ({"frames": [{"link": "a"}]}, "frames: keys parent, xyz, rpy are missing"),
        ({"free_body": GONE}, "state one of arm, free_body and legged"),
    ],
)
def test_config_errors_name_their_key(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    def apply(raw: dict[str, Any]) -> None:
        raw.update(change)
        for key, value in change.items():
            if value is GONE:
                del raw[key]

    with pytest.raises(InputError, match=words) as caught:
        load_system(configured(tmp_path, "barbot", apply))
    assert str(tmp_path / "mine.yaml") in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda arm: arm["moves"][3]["to_deg"].pop(), "need 6 numbers, one a joint"),
        (lambda arm: arm["moves"][3].update(seconds=0), "seconds must be positive"),
        (lambda arm: arm["joints"][2].update(parent="upperarm"), "one tree"),
    ],
)
def test_arm_that_cannot_be_is_refused(tmp_path: Path, change: Any, words: str) -> None:
    wrong = configured(tmp_path, "rihibot", lambda raw: change(raw["arm"]))
    with pytest.raises(InputError, match=words):
        load_system(wrong)


@pytest.mark.parametrize(
    ("content", "words"),
    [("a: [", "not YAML"), ("5", "no keys and values"), ("\xff", "not"), (None, "No such file")],
)
def test_files_without_a_system_are_refused(
    tmp_path: Path, content: str | None, words: str
) -> None:
    path = tmp_path / "mine.yaml"
    if content is not None:
        path.write_bytes(content.encode("latin-1"))
    with pytest.raises(InputError, match=words):
        load_system(path)


@pytest.mark.parametrize(("log", "name"), [("rihibot.mcap", "rihibot"), ("barbot.bag", "barbot")])
def test_sample_data_match_current_system_configs(log: str, name: str) -> None:
    folder, system = ROOT / "sample_data", load_system(name)
    truth = yaml.safe_load((folder / f"{name}.truth.yaml").read_text())
    assert truth["settings"]["system"] == json.loads(json.dumps(stated(system)))
    assert truth["transform"]["translation"] == list(system.imu.xyz)
    assert (folder / f"{name}.urdf").read_text() == urdf_text(system)
    assert (folder / log).stat().st_size <= 5_000_000
    with AnyReader([folder / log]) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
    assert counts[system.topics.imu] == truth["log"]["imu_messages"]
    assert counts[system.topics.robot] == truth["log"]["robot_messages"]
