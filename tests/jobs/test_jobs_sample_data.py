"""The whole way, from the sample logs of a physics engine to their truth."""

import math
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats
from tests.conftest import Imucalib
from tools.errors import nees, pose_off

ROOT = Path(__file__).parents[2]
DATA = ROOT / "sample_data"
SYSTEMS = {
    "rihibot.mcap": ["--urdf", str(DATA / "rihibot.urdf")],
    "barbot.bag": ["--gravity", "none"],
}


def _error(document: Any, truth: Any) -> Floats:
    """(6,), of the pose, m and rad."""
    (R, t), (R_true, t_true) = (
        (Rotation.from_quat(each["rotation_xyzw"]).as_matrix(), np.array(each["translation"]))
        for each in (document["transform"], truth["transform"])
    )
    return pose_off(R, t, R_true, t_true)


@pytest.mark.parametrize("log", SYSTEMS)
def test_result_matches_truth_within_sigma(log: str, imucalib: Imucalib) -> None:
    document = yaml.safe_load(imucalib("run", DATA / log, *SYSTEMS[log]).out)
    truth = yaml.safe_load((DATA / log).with_suffix(".truth.yaml").read_text())
    jsonschema.validate(document, yaml.safe_load((ROOT / "docs/result.schema.json").read_text()))
    transform = document["transform"]
    assert (transform["parent"], transform["child"]) == (
        truth["transform"]["parent"],
        truth["transform"]["child"],
    )
    error = _error(document, truth)
    shift, turn = error[:3], error[3:]
    # chi² of 6 degrees of freedom exceeds 22.5 once in a thousand logs
    assert nees(error, np.array(document["covariance"])) < 22.5
    assert np.linalg.norm(shift) < 5e-5
    # The frame is the accelerometer's: without gravity its axes follow from the motion alone, now
    # that the gyroscope's may be turned against them.
    assert np.linalg.norm(turn) < math.radians(1e-3 if log == "rihibot.mcap" else 5e-3)
    offset = document["time_offset"]
    assert abs(offset["seconds"] - truth["time_offset"]) < 4 * offset["std"] < 1e-4


@pytest.mark.parametrize(("start", "end"), [(3.0, 5.0), (3.0, 5.5), (2.5, 5.5)])
def test_short_part_is_within_sigma(start: float, end: float, imucalib: Imucalib) -> None:
    """Its automatic window is not so short that noise of the joints looks like motion."""
    log, options = DATA / "rihibot.mcap", SYSTEMS["rihibot.mcap"]
    document = yaml.safe_load(imucalib("run", log, *options, "--from", start, "--to", end).out)
    truth = yaml.safe_load(log.with_suffix(".truth.yaml").read_text())
    off = _error(document, truth)
    assert nees(off, np.array(document["covariance"])) < 22.5
    assert np.linalg.norm(off[:3]) < 0.06


def test_applied_result_leaves_nothing_to_correct(tmp_path: Path, imucalib: Imucalib) -> None:
    result, before = tmp_path / "result.yaml", DATA / "rihibot.urdf"
    log = DATA / "rihibot.mcap"
    imucalib("run", log, "--urdf", before, "-q", "-o", result)
    after = tmp_path / "calibrated.urdf"
    said = imucalib("apply", "-", "--urdf", before, stdin=result.read_bytes())
    after.write_text(said.out)
    document = yaml.safe_load(imucalib("verify", result, "--urdf", after).out)
    assert document["translation"]["difference_mm"] < 1e-6
    assert document["rotation"]["difference_deg"] < 1e-6
