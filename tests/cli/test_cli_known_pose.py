"""`--fix`, `--prior-std`, `--initial` and `--sensor-model`: from what is typed to what is asked."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from pathlib import Path

    from tests.cli.stand_in import Estimator
    from tests.conftest import Imucalib, LogWriter

INF = math.inf
ELSEWHERE = "-1 2 3 0 0 1.5707963267948966"


def test_a_pose_is_known_from_the_urdf(estimator: Estimator, run_arm: Imucalib) -> None:
    run_arm("--fix", "tx,rz")
    assert estimator.options.pose.std == (0.0, INF, INF, INF, INF, 0.0)
    np.testing.assert_array_equal(estimator.options.pose.t_parent_imu, [0.05, 0.0, 0.0])
    np.testing.assert_array_equal(estimator.options.pose.R_parent_imu, np.eye(3))


def test_a_fix_is_stronger_than_a_prior(estimator: Estimator, run_arm: Imucalib) -> None:
    run_arm("--prior-std", "2mm,ry=0.5deg", "--fix", "tz")
    assert estimator.options.pose.std == pytest.approx(
        (2e-3, 2e-3, 0.0, INF, math.radians(0.5), INF)
    )


def test_a_pose_told_goes_before_the_urdf(estimator: Estimator, run_arm: Imucalib) -> None:
    run_arm("--fix", "ty", "--initial", ELSEWHERE)
    np.testing.assert_array_equal(estimator.options.pose.t_parent_imu, [-1.0, 2.0, 3.0])
    quarter = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    np.testing.assert_allclose(estimator.options.pose.R_parent_imu, quarter, atol=1e-15)


def test_a_pose_told_is_needed_where_no_joint_tells_it(
    estimator: Estimator, log_writer: LogWriter, arm_urdf: Path, imucalib: Imucalib
) -> None:
    log = log_writer.imu(frame="elsewhere").joints().write()
    told = ("--urdf", arm_urdf, "--parent", "hand", "--prior-std", "1mm")
    assert 'give --initial "X Y Z R P Y"' in imucalib("run", log, *told, code=2).err
    assert not estimator.calls
    imucalib("run", log, *told, "--initial", ELSEWHERE)
    assert estimator.calls


def test_what_is_verified_cannot_be_what_is_known(
    estimator: Estimator, arm_log: Path, arm_urdf: Path, imucalib: Imucalib
) -> None:
    said = imucalib("verify", arm_log, "--urdf", arm_urdf, "--fix", "tx", code=2)
    assert "which is what verify is to check" in said.err
    assert not estimator.calls


def test_the_sensor_model_reaches_the_estimator(estimator: Estimator, run_arm: Imucalib) -> None:
    for model in ("ideal", "auto"):
        run_arm("--sensor-model", model)
        assert estimator.options.sensor_model == model
        assert estimator.options.pose is None


@pytest.mark.slow
def test_a_result_says_what_was_held(run_arm: Imucalib) -> None:
    """With the estimator itself, on a log that fits no pose: the answer is still what was held."""
    options = ("--format", "json", "--fix", "tx,ty,tz,rx,ry,rz", "--sensor-model", "ideal")
    document = json.loads(run_arm(*options, code=3).out)
    assert document["transform"]["translation"] == [0.05, 0.0, 0.0]
    np.testing.assert_array_equal(document["covariance"], np.zeros((6, 6)))
    told = document["provenance"]["options"]
    assert told["sensor_model"] == "ideal"
    assert (told["pose.std"], told["pose.t_parent_imu"]) == ("0 0 0 0 0 0", "0.05 0 0")
