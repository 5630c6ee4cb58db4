"""A robot that drives on a plane: which components are unobservable, and the options for them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from imucalib_cli.estimate.options import MatchedOptions, PosePrior
from imucalib_cli.jobs.calibrate import calibrate
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.jobs.verify import verify_recording
from imucalib_cli.results.codec import read_results
from imucalib_cli.results.formats import FORMATS
from imucalib_cli.results.requirement import Tolerance
from imucalib_cli.results.result import Result
from tests.conftest import Imucalib
from tests.jobs.driving import TRUE_T, drive, with_a_camera_frame

FREE = np.inf
HELD = PosePrior(std=(FREE, FREE, 0.0, FREE, FREE, FREE))
LOOSE = PosePrior(std=(FREE, FREE, 5e-3, FREE, FREE, FREE))
NEAR = Tolerance(translation=0.02, rotation=0.02)


@pytest.fixture(scope="module")
def log_and_urdf(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Odometry as of a tracker: noisy in all six directions, of which the body moves in three."""
    return drive(tmp_path_factory.mktemp("drive"), seconds=40.0, pose_noise=1e-3, seed=1)


def request_for(log_and_urdf: tuple[Path, Path], pose: PosePrior | None) -> CalibrationRequest:
    log, urdf = log_and_urdf
    return CalibrationRequest(logs=(log,), urdf=urdf, estimator=MatchedOptions(pose=pose))


def run(log_and_urdf: tuple[Path, Path], pose: PosePrior | None = None) -> Result:
    (result,) = calibrate(request_for(log_and_urdf, pose)).results
    return result


def test_unobservable_height_is_reported_with_advice(log_and_urdf: tuple[Path, Path]) -> None:
    result = run(log_and_urdf)
    assert result.status == "untrusted"
    (lost,) = result.diagnostics.unobservable
    np.testing.assert_allclose(lost.direction_parent, [0.0, 0.0, 1.0], atol=0.01)
    assert "--fix tz holds it at the URDF's value, --prior-std tz=5mm" in lost.motion
    # the undetermined component has its nominal value where a number is needed
    words = FORMATS["tf"].render([result]).split()
    assert float(words[words.index("--z") + 1]) == pytest.approx(0.08, abs=1e-5)
    assert result.transform.translation[2] is None


@pytest.mark.parametrize("pose", [HELD, LOOSE])
def test_prior_on_unobservable_height_is_not_contradicted(
    log_and_urdf: tuple[Path, Path], pose: PosePrior
) -> None:
    """Noise of the poses in roll and pitch looks like information on tz, and is none."""
    result = run(log_and_urdf, pose)
    assert result.status == "ok"
    assert result.std is not None
    sigma = np.maximum(np.array(result.std.translation_mm, dtype=np.float64) / 1e3, 1e-6)
    apart = np.array(result.pose.translation) - TRUE_T
    assert np.all(np.abs(apart)[:2] < 4.0 * sigma[:2])
    if pose is HELD:
        assert result.pose.translation[2] == 0.08


def test_verify_can_ignore_the_height(log_and_urdf: tuple[Path, Path]) -> None:
    def verdict(pose: PosePrior | None = None, **options: Any) -> str:
        request = request_for(log_and_urdf, pose)
        (answer,), _ = verify_recording(request, NEAR, **options)
        return answer.verdict

    ignored = frozenset({2})
    assert verdict() == "unknown"
    assert verdict(ignored=ignored) == "yes"
    assert verdict(HELD, ignored=ignored) == "yes"
    # 10 mm off in x and y, as the drawing is
    request = request_for(log_and_urdf, None)
    near = replace(NEAR, translation=5e-3)
    (answer,), _ = verify_recording(request, near, ignored=ignored)
    assert answer.verdict == "no"
    assert answer.ignored == ("tz",)
    assert "not checked: tz" in answer.reason


def test_planar_option_fixes_the_height(
    log_and_urdf: tuple[Path, Path], imucalib: Imucalib
) -> None:
    log, urdf = log_and_urdf
    (result,) = read_results(imucalib("run", log, "--urdf", urdf, "--planar").out, "stdout")
    assert result.pose.translation[2] == 0.08
    near = ["--within", "20mm,1deg"]
    imucalib("verify", log, "--urdf", urdf, "--planar", *near)


def test_planar_fixes_height_for_any_upright_axis(
    log_and_urdf: tuple[Path, Path], tmp_path: Path, imucalib: Imucalib
) -> None:
    rpy = f"{-np.pi / 2} 0 {-np.pi / 2}"  # of optical frames: y points down
    urdf = with_a_camera_frame(tmp_path, rpy)
    command = [str(log_and_urdf[0]), "--urdf", str(urdf), "--planar"]
    (result,) = read_results(imucalib("run", *command).out, "stdout")
    assert result.parent == "camera"
    R = Rotation.from_euler("xyz", [float(each) for each in rpy.split()])
    assert result.pose.translation[1] == pytest.approx(-0.08, abs=1e-12)
    np.testing.assert_allclose(R.apply(result.pose.t), TRUE_T, atol=1e-3)
    assert "not checked: ty" in imucalib("verify", *command, "--within", "20mm,1deg").out
