"""imucalib from Python: as the command line, and arrays as logs; its page and notebook run."""

import json
import pickle
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

import imucalib_cli as ic
from imucalib_cli.jobs.input.recording import read_recording
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.logs.part import Part
from imucalib_cli.robot.rotations import quaternion_from_matrix
from tests.conftest import Imucalib, LogWriter
from tests.processes import python
from tests.slow import slow_after

ROOT = Path(__file__).resolve().parent.parent
SAMPLES = ROOT / "sample_data"
LOG, URDF = SAMPLES / "rihibot.mcap", SAMPLES / "rihibot.urdf"
ONE_NAN = np.where(np.arange(3 * 4997) == 22, np.nan, 1.0).reshape(-1, 3)
EXACT = ic.MatchedOptions(robot="exact", sensor_model="ideal")
AS_OPTIONS = ("--to", "20", "--robot", "exact", "--sensor-model", "ideal")
QUICK = ic.MatchedOptions(gravity="none", robot="exact", sensor_model="ideal")


@pytest.fixture(scope="module")
def arm() -> ic.Calibration:
    return ic.calibrate(LOG, urdf=URDF, end=20.0, estimator=EXACT)


@pytest.fixture(scope="module")
def streams() -> dict[str, Any]:
    """The same part of the log as arrays, s since its first stamp."""
    recording = read_recording(CalibrationRequest(logs=(LOG,), part=Part(end=20.0)))
    (imu,), ((joints,),) = recording.imus, recording.joints.values()
    return {
        "t": recording.clock.seconds(imu),
        "gyro": imu.gyro,
        "accel": imu.accel,
        "joint_t": recording.clock.seconds(joints),
        "joint_positions": joints.position,
        "joint_names": joints.names,
        "urdf": URDF,
        "imu_link": "imu_link",
        "estimator": EXACT,
    }


def test_api_call_equals_command_output(arm: ic.Calibration, imucalib: Imucalib) -> None:
    said = imucalib("run", LOG, "--urdf", URDF, "-q", "--format", "json", *AS_OPTIONS)
    assert arm.render("json") == said.out


def test_calibration_returns_from_another_process(arm: ic.Calibration) -> None:
    again = pickle.loads(pickle.dumps(arm))  # noqa: S301 - our own
    assert again.result == arm.result
    np.testing.assert_array_equal(again.residuals.gyro_residual, arm.residuals.gyro_residual)


def test_calibration_has_arrays_residuals_and_text(arm: ic.Calibration) -> None:
    assert arm.ok
    assert arm.T[:3, :3] == pytest.approx(arm.R)
    assert arm.T[:3, 3] == pytest.approx(arm.result.pose.t)
    assert quaternion_from_matrix(arm.R) == pytest.approx(arm.result.pose.rotation_xyzw)
    assert arm.covariance is not None
    assert arm.covariance.shape == (6, 6)
    assert arm.time_offset == pytest.approx(0.0125, abs=1e-4)
    assert arm.residuals is arm.details.windows
    assert arm.start_ns == 1_700_000_000_000_000_000
    assert str(arm).startswith("imu_link in wrist_3_link: ok\n")
    assert repr(arm).startswith("<Calibration ok: imu_link in wrist_3_link is known to")
    html = arm._repr_html_()
    assert html.startswith("<table>")
    assert html.endswith("</table>")
    assert "-22.496 ± 0.024 mm" in html


def test_names_are_escaped_in_html(arm: ic.Calibration) -> None:
    transform = msgspec.structs.replace(arm.result.transform, child="<script>alert(1)</script>")
    result = msgspec.structs.replace(arm.result, transform=transform)
    html = replace(arm, result=result)._repr_html_()
    assert "<script" not in html
    assert "&lt;script&gt;" in html


def test_joint_positions_give_the_result_of_their_log(
    arm: ic.Calibration, streams: dict[str, Any]
) -> None:
    found = ic.calibrate_arrays(**streams)
    assert (found.T == arm.T).all()
    assert found.covariance == pytest.approx(arm.covariance, rel=1e-12, abs=0)
    assert (found.residuals.accel_residual == arm.residuals.accel_residual).all()
    assert found.start_ns == 0
    assert found.result.provenance.files == []
    assert "from arrays: imu with joints" in str(found)


@pytest.mark.parametrize("epoch", slow_after(1, [-1e3, 0.3, 1.7e9]))
def test_stamps_may_have_any_epoch(
    arm: ic.Calibration, streams: dict[str, Any], epoch: float
) -> None:
    later = {name: streams[name] + epoch for name in ("t", "joint_t")}
    found = ic.calibrate_arrays(**{**streams, **later})
    assert found.t == pytest.approx(arm.t, abs=1e-6)
    first = found.start_ns * 1e-9 + found.residuals.t[0]
    assert first == pytest.approx(epoch + arm.residuals.t[0], abs=1e-5)
    recorded = found.result.recorded_at
    assert (recorded is None) == (epoch < 1e9)
    assert recorded is None or recorded.timestamp() == pytest.approx(epoch, abs=0.1)


def test_poses_give_the_result_of_their_log() -> None:
    log = ic.calibrate(SAMPLES / "barbot.bag", parent="bar_link", estimator=QUICK, end=15.0)
    bar = read_recording(CalibrationRequest(logs=(SAMPLES / "barbot.bag",), part=Part(end=15.0)))
    (imu,) = bar.imus
    (edge,) = (each for each in bar.sources.edges if not each.is_static)
    arrays: dict[str, Any] = {
        "t": bar.clock.seconds(imu),
        "gyro": imu.gyro,
        "accel": imu.accel,
        "pose_t": edge.track.t,
        "positions": edge.track.values[:, :3],
        "quaternions_xyzw": -2.0 * edge.track.values[:, 3:],  # of any length and sign
        "estimator": QUICK,
    }
    found = ic.calibrate_arrays(**arrays)
    np.testing.assert_allclose(found.T, log.T, rtol=0, atol=1e-9)
    assert (found.result.parent, found.result.child) == ("body", "imu")
    with pytest.raises(ic.ChoiceError, match="name it by parent"):
        ic.calibrate_arrays(**arrays, urdf=SAMPLES / "barbot.urdf")


def test_untrusted_pose_needs_force_to_render(arm: ic.Calibration) -> None:
    bad = replace(arm, result=msgspec.structs.replace(arm.result, status="untrusted"))
    assert not bad.ok
    with pytest.raises(ic.UntrustedError, match="so no urdf"):
        bad.render("urdf")
    assert bad.render("urdf", force=True) == arm.render("urdf")
    with pytest.raises(ic.ChoiceError, match="no format sdf: choose yaml, json, urdf"):
        arm.render("sdf")
    published = replace(arm, estimate=replace(arm.estimate, details=None))
    with pytest.raises(ic.InputError, match="keeps no series"):
        _ = published.residuals


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"gyro": np.zeros((4, 3))}, r"gyro: has the shape \(4, 3\), expected \(4997, 3\)"),
        ({"t": np.zeros(0)}, r"t: has the shape \(0,\), expected \(N,\) with N > 0"),
        ({"t": 1e9 * np.arange(4997)}, "from first to last: give seconds"),
        ({"accel": "fast"}, "accel: cannot be read as numbers"),
        ({"accel": ONE_NAN}, "accel: has values that are not finite numbers"),
        ({"joint_t": None}, "joint_t is missing"),
        ({"urdf": None}, "cannot be used without the robot's chain: give urdf"),
        ({"joint_t": None, "joint_positions": None, "joint_names": ()}, "nothing gives the motion"),
        ({"joint_names": ("a",)}, r"joint_positions: has the shape \(2501, 6\)"),
        ({"joint_names": tuple("abcdef")}, "shoulder_pan_joint"),
        ({"imu_link": None}, "--parent"),
        # arguments of another type
        ({"joint_names": list(range(2))}, None),
        ({"urdf": b"robot.urdf"}, None),
        ({"urdf": "robot\0.urdf"}, None),
        ({"urdf": ""}, None),
        ({"imu_model": 3}, None),
        ({"parent": 3}, None),
        ({"imu_link": 5}, None),
        ({"units": "mm"}, None),
        ({"estimator": "paper"}, None),
        ({"estimator": ic.MatchedOptions}, None),
        # values that their types do not have
        ({"estimator": ic.MatchedOptions(gravity="up")}, r"estimator: .*'up'.*gravity"),  # type: ignore[arg-type]
        ({"estimator": ic.MatchedOptions(degree=0)}, "estimator: .*degree"),
        ({"estimator": ic.MatchedOptions(pose=ic.PosePrior(std=(0, 0)))}, "estimator.pose: .*std"),
        ({"units": ic.Units(accel="feet")}, "units: .*'feet'.*accel"),  # type: ignore[arg-type]
        ({"require": "1mm,0.1deg"}, None),
        ({"t": np.ma.masked_less(np.arange(100.0), 3.0)}, None),
        ({"gyro": np.zeros((100, 3), dtype=complex)}, None),
        ({"parent": "nope\n\x1b[31m"}, None),
    ],
    ids=lambda each: str(each)[:60],
)
def test_invalid_arrays_give_one_line_errors(
    streams: dict[str, Any], change: dict[str, Any], words: str | None
) -> None:
    with pytest.raises(ic.ImucalibError, match=words) as caught:
        ic.calibrate_arrays(**streams | change)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("logs", [None, 3, b"log.mcap", "", [], [3], "a\0.mcap"])
def test_log_is_one_path_or_several(logs: Any) -> None:
    with pytest.raises(ic.ImucalibError):
        ic.calibrate(logs)


def test_one_of_several_imus_must_be_named(log_writer: LogWriter, arm_urdf: Path) -> None:
    log = log_writer.imu("/a").imu("/b").joints().write()
    with pytest.raises(ic.ChoiceError, match="choose one by imu_topic: /a, /b"):
        ic.calibrate([log], urdf=arm_urdf)


def test_import_does_not_load_numpy() -> None:
    code = (
        f"import sys; sys.path.insert(0, {str(ROOT)!r}); import imucalib_cli; "
        "assert not {'numpy', 'typing'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-I", "-S", "-c", code], check=True)
    assert not hasattr(ic, "nothing")
    for name in ic.__all__:
        assert getattr(ic, name) is not None


@pytest.mark.slow
def test_the_examples_of_the_page_run() -> None:
    page = (ROOT / "docs" / "python.md").read_text("utf-8")
    code = "\n".join(re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL))
    done = python("-W", "error", "-c", code, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert "give --urdf" in done.stdout.splitlines()[-1]


def test_notebook_is_stored_without_outputs() -> None:
    notebook = json.loads((ROOT / "docs" / "example.ipynb").read_text("utf-8"))
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert len(code) > 3
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in code)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # of the notebook's machinery, which is not ours
def test_the_notebook_runs() -> None:
    nbformat: Any = pytest.importorskip("nbformat")
    nbclient: Any = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    notebook = nbformat.read(ROOT / "docs" / "example.ipynb", as_version=4)
    nbclient.NotebookClient(
        notebook, timeout=300, resources={"metadata": {"path": str(ROOT / "docs")}}
    ).execute()
    outputs = [each for cell in notebook.cells for each in cell.get("outputs", ())]
    kinds = [kind for each in outputs for kind in each.get("data", {})]
    assert "text/html" in kinds
    assert kinds.count("image/png") == 4
    assert not [each for each in outputs if each.output_type == "stream" and each.name == "stderr"]
