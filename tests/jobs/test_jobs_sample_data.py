"""The whole way, from the sample logs of a physics engine to their truth."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from imucalib_cli.cli.main import main

ROOT = Path(__file__).parents[2]
DATA = ROOT / "sample_data"
SYSTEMS = {
    "rihibot.mcap": ["--urdf", str(DATA / "rihibot.urdf")],
    "barbot.bag": ["--gravity", "none"],
}


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert main(["run", *arguments]) == 0
    document: dict[str, Any] = yaml.safe_load(capsys.readouterr().out)
    return document


@pytest.mark.parametrize("log", SYSTEMS)
def test_the_result_is_the_truth_within_its_sigma(
    log: str, capsys: pytest.CaptureFixture[str]
) -> None:
    document = run(capsys, str(DATA / log), *SYSTEMS[log])
    truth = yaml.safe_load((DATA / log).with_suffix(".truth.yaml").read_text())
    jsonschema.validate(document, yaml.safe_load((ROOT / "docs/result.schema.json").read_text()))
    transform = document["transform"]
    assert (transform["parent"], transform["child"]) == (
        truth["transform"]["parent"],
        truth["transform"]["child"],
    )
    shift = np.subtract(transform["translation"], truth["transform"]["translation"])
    found = Rotation.from_quat(transform["rotation_xyzw"])
    turn = (found * Rotation.from_quat(truth["transform"]["rotation_xyzw"]).inv()).as_rotvec()
    error = np.concatenate((shift, turn))
    squared = error @ np.linalg.solve(np.array(document["covariance"]), error)
    # chi² of 6 degrees of freedom exceeds 22.5 once in a thousand logs
    assert squared < 22.5
    assert np.linalg.norm(shift) < 5e-5
    # The frame is the accelerometer's: without gravity its axes are told by the motion alone, now
    # that the gyroscope's may be turned against them.
    assert np.linalg.norm(turn) < math.radians(1e-3 if log == "rihibot.mcap" else 5e-3)
    offset = document["time_offset"]
    assert abs(offset["seconds"] - truth["time_offset"]) < 4 * offset["std"] < 1e-4


def test_apply_puts_the_result_where_the_joint_was(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    result, before = tmp_path / "result.yaml", DATA / "rihibot.urdf"
    log = DATA / "rihibot.mcap"
    assert main(["run", str(log), "--urdf", str(before), "-q", "-o", str(result)]) == 0
    after = tmp_path / "calibrated.urdf"
    assert main(["apply", str(result), "--urdf", str(before), "-o", str(after)]) == 0
    pairs = zip(before.read_text().splitlines(), after.read_text().splitlines(), strict=True)
    changed = [(old, new) for old, new in pairs if old != new]
    assert len(changed) == 1
    assert "<origin" in changed[0][0]
    # the calibrated URDF is where the log says: nothing is left to correct
    document = run(capsys, str(log), "--urdf", str(after))
    assert document["diagnostics"]["nominal"]["distance_mm"] < 1e-6
    assert document["diagnostics"]["nominal"]["distance_deg"] < 1e-6
    # by way of stdin and stdout it is the same file
    stdin = io.TextIOWrapper(io.BytesIO(result.read_bytes()))
    monkeypatch.setattr("sys.stdin", stdin)
    assert main(["apply", "-", "--urdf", str(before)]) == 0
    assert capsys.readouterr().out == after.read_text()


def test_apply_without_a_joint_offers_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result, urdf = tmp_path / "result.yaml", tmp_path / "other.urdf"
    log = DATA / "barbot.bag"
    assert main(["run", str(log), "--gravity", "none", "-q", "-o", str(result)]) == 0
    urdf.write_text('<robot name="bar"><link name="bar_link"/></robot>')
    assert main(["apply", str(result), "--urdf", str(urdf)]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert '<joint name="imu_link_joint" type="fixed">' in err
    assert '<parent link="bar_link"/>' in err
