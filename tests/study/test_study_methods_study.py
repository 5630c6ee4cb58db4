"""The comparison of methods: rows against errors computed here, tables against their rows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucalib_cli.simulate.camera.view import camera_mount
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.recording import Recording
from imucalib_cli.study.fresh_process import Cost
from imucalib_cli.study.method_runs import Answer, Condition, Pose
from imucalib_cli.study.recordings import clean_recording
from imucalib_cli.study.studies.methods import (
    ENTRANTS,
    MethodsCriteria,
    MethodsStudy,
    Quoted,
    enter,
    given,
    row_of,
)
from imucalib_cli.study.tables import Row, in_best_setting, mean_error
from tests.study.study_samples import study as quick

NOISY = "ADIS16495 with biases"


@pytest.fixture(scope="module")
def study() -> MethodsStudy:
    small: MethodsStudy = quick(
        "methods",
        duration=14.0,
        imu_rate=100.0,
        robot_rate=100.0,
        paper_windows=(5,),
        paper_exclusions=(0.0,),
        paper_residuals=("l1", "components"),
    )
    return small


@pytest.fixture(scope="module")
def clean(study: MethodsStudy) -> Recording:
    return clean_recording(study.system, study.physics, study.camera)


def cost(value: Answer | None, failure: str | None = None) -> Cost[Answer]:
    return Cost(value, 1.0, 0.5, 2e6, 1e8, failure)


def test_errors_refer_to_the_camera_imu_transform(clean: Recording) -> None:
    turn = Rotation.from_rotvec([0.0, 0.02, 0.0]).as_matrix()
    parent = Answer(
        frame="parent",
        T_frame_imu=Pose(
            turn @ clean.R_parent_imu, clean.t_parent_imu + np.array([0.003, 0.0, -0.004])
        ),
        time_offset=None,
        evaluations=1,
    )
    _, R, p = camera_mount(clean.system, "camera_optical_frame")
    camera = replace(
        parent,
        frame="camera",
        T_frame_imu=Pose(R.T @ parent.T_frame_imu.R, R.T @ (parent.T_frame_imu.t - p)),
    )
    by_frame = [row_of(cost(answer), clean) for answer in (parent, camera)]
    for row in by_frame:
        assert row["translation"] == pytest.approx(0.005)
        assert row["rotation"] == pytest.approx(0.02)
    assert by_frame[0] == pytest.approx(by_frame[1])
    failed = row_of(cost(None, "why"), clean)
    assert failed["failure"] == "why"
    assert failed["translation"] is None


@pytest.mark.slow
def test_every_method_gives_a_result(study: MethodsStudy, clean: Recording) -> None:
    pytest.importorskip("cv2")
    data = given(corrupt(clean, study.condition_of({"condition": NOISY}).sensors, 0), study, 0)
    assert data.spline.accel_bias_walk > 0.0
    for name, entrant in ENTRANTS.items():
        answer = enter(name, study.paper_settings[0], data)
        row = row_of(cost(answer), clean)
        # A method without biases has the error that they cause.
        limit = 1e-3 if "biases" in entrant.unknowns else 0.02
        assert float(row["translation"] or 1.0) < limit, name


def rows_of(errors: dict[str, float]) -> list[Row]:
    return [
        {
            "condition": "c",
            "method": method,
            "seed": seed,
            "setting": setting,
            "translation": errors.get(method, 1.0) * (2.0 if setting == "b" else 1.0),
            "rotation": errors.get(method, 1.0),
            "averaged_translation": 0.0,
            "averaged_rotation": 0.0,
            "bound_translation": 0.5,
            "bound_rotation": 0.5,
            "seconds": 1.0,
            "cpu_seconds": 1.0,
            "memory": 1e6,
            "held": 1e8,
            "failure": None,
        }
        for method in ENTRANTS
        for seed in range(2)
        for setting in (("a", "b") if method == "paper" else (None,))
    ]


def test_tables_show_the_best_setting_and_judge_claims(study: MethodsStudy) -> None:
    rows = rows_of({"paper": 0.5, "hand-eye + RANSAC (Liang)": 0.4})
    paper = [row for row in rows if row["method"] == "paper"]
    assert {row["setting"] for row in in_best_setting(paper, mean_error())} == {"a"}
    rows[-1] |= {"failure": "needs OpenCV", "translation": None}
    quote = Quoted(condition="c", method="Q (quoted)", translation="9", rotation="8", seconds="7")
    criteria = MethodsCriteria(conditions=("c",), liang_rotation_deg=5.0)
    judged = replace(study, conditions=(Condition(name="c"),), quoted=(quote,), claims=criteria)
    table, claims = judged.tables(rows)
    by_name = {row[0]: dict(zip(table.header, row, strict=True)) for row in table.rows}
    assert by_name["paper (a)"]["translation mm"] == "500 ± 0"
    assert by_name["paper (a)"]["over bound"] == "1"
    assert by_name["B-spline batch, corners"]["over bound"] == "-"
    assert by_name["ours"]["answers"] == "2 of 2"
    assert by_name["Q (quoted)"]["translation mm"] == "9"
    assert table.note.endswith("hand-eye + RANSAC, tuned: needs OpenCV.")
    assert table.rows[-2][-1] == "1 of 2"
    # The paper, in translation then rotation, against splines, Liang twice, and the quote.
    verdicts = [row[2] for row in claims.rows]
    assert verdicts[:8] == ["met", "not met", "met", "not met"] * 2
    assert verdicts[-1] == "met"
    unjudged = replace(judged, claims=replace(criteria, conditions=()))
    _, none = unjudged.tables(rows)
    assert none.rows == ()
