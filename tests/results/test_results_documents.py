"""The documents against the published schema, against themselves, and against bad input."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imucalib_cli.errors import InputError, UntrustedError
from imucalib_cli.estimate.estimate import (
    Consistency,
    Correction,
    Estimate,
    Residuals,
    UnobservableDirection,
    Window,
)
from imucalib_cli.estimate.imu_check import ImuCheck, SensorCheck
from imucalib_cli.findings import Severity, note, texts, untrusted, warning
from imucalib_cli.results.calibration import (
    Calibration,
    Nominal,
    Provenance,
    SourceFile,
    Tolerance,
    distance_to,
)
from imucalib_cli.results.document import finding_entry, to_document
from imucalib_cli.results.formats import render
from imucalib_cli.results.reader import from_document, read_calibrations
from imucalib_cli.results.requirement import require
from imucalib_cli.results.summary import summarise
from imucalib_cli.results.text import to_json, to_yaml

ROOT = Path(__file__).parents[2]
SCHEMA = json.loads((ROOT / "docs/result.schema.json").read_text())

R_TRUE = Rotation.from_euler("xyz", [0.1, -0.4, 2.9])
UP = UnobservableDirection(
    kind="translation", direction_parent=np.array([0.0, 0.0, 1.0]), std=None, motion="tilt it"
)
ROLL = UnobservableDirection(
    kind="rotation", direction_parent=np.array([1.0, 0.0, 0.0]), std=0.3, motion="roll it"
)


def make_calibration(**changes: Any) -> Calibration:
    rng = np.random.default_rng(4)
    root = rng.normal(scale=1e-4, size=(6, 6))
    estimate = Estimate(
        method="matched",
        R_parent_imu=R_TRUE.as_matrix(),
        t_parent_imu=np.array([-0.0225, 0.1, 1e-5]),
        covariance=root @ root.T,
        time_offset=-0.042,
        time_offset_std=1e-5,
        accel_bias=np.array([0.1, -0.2, 0.3]),
        accel_bias_std=np.array([1e-3, 2e-3, 3e-3]),
        gyro_bias=np.zeros(3),
        gyro_bias_std=None,
        gravity_world=np.array([0.0, 0.0, -9.80665]),
        window=Window(samples=51, seconds=0.1, reason="encoder noise 2e-5 rad"),
        residuals=Residuals(
            accel_rms=np.full(3, 0.02),
            gyro_rms=np.full(3, 1e-3),
            windows_used=1000,
            windows_dropped=3,
            samples_replaced=2,
            gaps=1,
            accel_normalised=np.full(3, 1.1),
            gyro_normalised=np.array([0.9, 1.0, 1.1]),
        ),
        corrections=(
            Correction(name="accel_scale", value=np.array([1.0, 1.01, 1.0]), std=np.full(3, 1e-4)),
            Correction(name="clock_drift", value=np.array([2e-5]), std=np.array([1e-7])),
        ),
        consistency=Consistency(
            folds=12,
            fold_std=np.linspace(1e-4, 6e-4, 6),
            halves_difference=np.linspace(-3e-4, 2e-4, 6),
            halves_sigmas=1.2,
            segment_chi2=0.9,
            whiteness=(1.0, 1.3),
        ),
        imu_check=ImuCheck(
            name="bmi088",
            rate=200.0,
            accel=SensorCheck(expected=0.02, measured=0.1, in_windows=0.03, bias_prior=0.4),
            gyro=SensorCheck(expected=2e-3, measured=1e-3, in_windows=None, bias_prior=None),
        ),
        notes={"chi2": float("nan"), "count": 3, "flag": True},
    )
    estimate = replace(estimate, **changes)
    return Calibration(
        parent="wrist_3_link",
        child="imu_link",
        estimate=estimate,
        nominal=Nominal(
            joint="imu_joint", R_parent_imu=np.eye(3), t_parent_imu=np.array([0.0, 0.1, 0.0])
        ),
        provenance=Provenance(
            version="0.1.0",
            files=(SourceFile(path="a b.mcap", sha256="0" * 64),),
            urdf=SourceFile(path="robot.urdf", sha256="f" * 64),
            imu_topic="/imu/data",
            motion=("/joint_states",),
            world="base_link",
            clock="header",
            options={"max_offset": 1.0, "tilt_std": math.inf},
        ),
    )


VARIANTS: dict[str, dict[str, Any]] = {
    "ok": {},
    "no sigma": {"covariance": None, "time_offset_std": None, "method": "paper"},
    "translation unknown": {"unobservable": (UP,)},
    "rotation unknown": {"unobservable": (ROLL,)},
    "infinite sigma": {"covariance": np.diag([1.0, 1.0, math.inf, 1.0, 1.0, 1.0])},
    "distrusted": {"findings": texts(Severity.UNTRUSTED, ["segments disagree"])},
}


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("write", [to_yaml, to_json])
def test_documents_obey_the_schema_and_read_back_equal(variant: str, write: Any) -> None:
    calibration = make_calibration(**VARIANTS[variant])
    document = to_document(calibration)
    text = write([document])
    jsonschema.validate(document, SCHEMA, cls=jsonschema.Draft202012Validator)
    jsonschema.validate(yaml.safe_load(text), SCHEMA) if write is to_yaml else json.loads(text)
    (again,) = read_calibrations(text, "result.yaml")
    rewritten = to_document(again)
    # matrix -> quaternion -> matrix costs a rounding; everything else is exact
    _assert_close(rewritten, document)
    np.testing.assert_array_equal(again.estimate.t_parent_imu, calibration.estimate.t_parent_imu)


def _assert_close(a: Any, b: Any) -> None:
    assert type(a) is type(b)
    if isinstance(a, dict):
        assert list(a) == list(b)
        for key in a:
            _assert_close(a[key], b[key])
    elif isinstance(a, list):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            _assert_close(x, y)
    elif isinstance(a, float):
        assert a == pytest.approx(b, rel=1e-12, abs=1e-14)
    else:
        assert a == b


def test_keys_stand_in_the_order_of_the_contract() -> None:
    assert list(to_document(make_calibration(unobservable=(UP,)))) == [
        "schema",
        "status",
        "transform",
        "partial",
        "covariance",
        "std",
        "time_offset",
        "accel_bias",
        "gyro_bias",
        "gravity_world",
        "diagnostics",
        "provenance",
    ]


def test_an_unknown_translation_nulls_its_component_only() -> None:
    document = to_document(make_calibration(unobservable=(UP,)))
    assert document["status"] == "untrusted"
    assert document["transform"]["translation"] == [-0.0225, 0.1, None]
    assert document["transform"]["rotation_xyzw"] is not None
    assert document["partial"]["translation"] == [-0.0225, 0.1, 1e-5]
    assert document["diagnostics"]["unobservable"][0]["std"] is None


def test_an_oblique_unknown_direction_nulls_every_component_it_touches() -> None:
    oblique = replace(UP, direction_parent=np.array([0.8, 0.0, 0.6]))
    translation = to_document(make_calibration(unobservable=(oblique,)))["transform"]["translation"]
    assert translation == [None, 0.1, None]


def test_an_unknown_rotation_nulls_the_whole_rotation() -> None:
    document = to_document(make_calibration(unobservable=(ROLL,)))
    assert document["transform"]["rotation_xyzw"] is None
    assert document["transform"]["rotation_rpy"] is None
    assert document["transform"]["translation"] == [-0.0225, 0.1, 1e-5]
    np.testing.assert_allclose(
        Rotation.from_quat(document["partial"]["rotation_xyzw"]).as_matrix(), R_TRUE.as_matrix()
    )


def test_std_and_rotation_agree_with_scipy() -> None:
    calibration = make_calibration()
    document = to_document(calibration)
    covariance = np.array(document["covariance"])
    np.testing.assert_allclose(
        document["std"]["translation_mm"], 1e3 * np.sqrt(np.diag(covariance))[:3]
    )
    np.testing.assert_allclose(
        document["std"]["rotation_deg"], np.degrees(np.sqrt(np.diag(covariance))[3:])
    )
    np.testing.assert_allclose(
        document["transform"]["rotation_rpy"], R_TRUE.as_euler("xyz"), atol=1e-12
    )
    assert document["transform"]["rotation_xyzw"][3] >= 0


def test_vectors_stand_on_one_line_in_yaml() -> None:
    text = to_yaml([to_document(make_calibration(unobservable=(UP,)))])
    assert "  translation: [-0.0225, 0.1, null]\n" in text
    assert "\n- [" in text.split("covariance:")[1]
    assert "&id" not in text


def test_several_imus_are_a_stream_or_an_array() -> None:
    pair = [make_calibration(), make_calibration(unobservable=(UP,))]
    documents = [to_document(calibration) for calibration in pair]
    assert len(list(yaml.safe_load_all(to_yaml(documents)))) == 2
    array = json.loads(to_json(documents))
    assert len(array) == 2
    jsonschema.validate(array, SCHEMA, cls=jsonschema.Draft202012Validator)
    del array[1]["status"]
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(array, SCHEMA, cls=jsonschema.Draft202012Validator)
    for text in (to_yaml(documents), to_json(documents)):
        assert [c.status for c in read_calibrations(text, "x")] == ["ok", "untrusted"]


@given(value=st.floats(allow_nan=False, allow_infinity=False))
def test_floats_survive_yaml_and_json(value: float) -> None:
    document = {"value": [value], "again": value}
    assert yaml.safe_load(to_yaml([document])) == document
    assert json.loads(to_json([document])) == document


@pytest.mark.parametrize("written", ["1e-05", "1E-5", "1.0e-05", "0.00001"])
def test_numbers_of_other_writers_are_numbers(written: str) -> None:
    text = to_yaml([to_document(make_calibration())]).replace("1.0e-05", written)
    assert written in text
    (again,) = read_calibrations(text, "x")
    assert again.estimate.t_parent_imu[2] == 1e-5
    assert again.estimate.time_offset_std == 1e-5


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("", "empty"),
        ("[]", "empty"),
        ("a: [1", "neither YAML nor JSON"),
        ("\x00", "neither YAML nor JSON"),
        ("hello", "should be a mapping"),
        ("{}", "schema is missing"),
        ("schema: true\nstatus: ok", "schema should be of type int"),
        ("schema: 2\nstatus: ok", "schema is 2"),
        ("schema: 1\nstatus: fine", "status should be ok or untrusted"),
        ("schema: 1\nstatus: ok\ntransform: 3", "transform should be a mapping"),
    ],
)
def test_bad_files_give_one_line(text: str, part: str) -> None:
    with pytest.raises(InputError) as caught:
        read_calibrations(text, "bad.yaml")
    message = str(caught.value)
    assert message.startswith("bad.yaml: ")
    assert part in message
    assert "\n" not in message


def test_findings_keep_their_codes_and_values() -> None:
    told = (
        untrusted("imu.motion_left_out", share=np.float64(0.75)),
        warning("stream.leaps", stream="/joints (a, b)", count=np.int64(3), least=0.01),
        warning("robot.held", streams=["/tf"], stretches=[(1.0, 2.5), (3.0, math.inf)]),
        note("log.unindexed", file="a.bag"),
    )
    calibration = make_calibration(findings=told)
    for write in (to_yaml, to_json):
        (again,) = read_calibrations(write([to_document(calibration)]), "f")
        assert again.estimate.findings == told
        assert again.estimate.distrust == calibration.estimate.distrust
    document = to_document(calibration)["diagnostics"]
    assert [each["severity"] for each in document["findings"]] == [
        "untrusted",
        "warning",
        "warning",
        "note",
    ]
    assert [each["message"] for each in document["findings"]] == [
        *document["distrust"],
        *document["warnings"],
    ]


def test_sentences_of_results_without_codes_are_read() -> None:
    """As versions wrote them that had no findings."""
    document = to_document(make_calibration())
    del document["diagnostics"]["findings"]
    document["status"] = "untrusted"
    old = "--require asks for 1 mm, the largest sigma is 2 mm along x of a: record longer"
    document["diagnostics"] |= {"distrust": ["it wobbles", old], "warnings": ["the moon is full"]}
    estimate = from_document(document, "f").estimate
    assert estimate.distrust == ("it wobbles", old)
    assert estimate.warnings == ("the moon is full",)
    assert [each.code for each in estimate.findings] == ["text", "require.text", "text"]
    (again,) = read_calibrations(to_yaml([to_document(from_document(document, "f"))]), "f")
    assert again.estimate.findings == estimate.findings


def test_a_finding_of_a_later_version_is_told_as_it_was() -> None:
    document = to_document(make_calibration())
    document["diagnostics"]["findings"] = [
        {"code": "imu.sings", "severity": "warning", "values": {"hz": 440}, "message": "it sings"}
    ]
    document["diagnostics"]["warnings"] = ["it sings"]
    (told,) = from_document(document, "f").estimate.findings
    assert (told.code, told.message) == ("text", "it sings")


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"code": "stream.leaps"}, "values are not those of a finding of code stream.leaps"),
        ({"severity": "fatal"}, "severity should be note or warning or untrusted"),
        ({"severity": "untrusted"}, "findings are not those of distrust and warnings"),
        ({"values": {"share": "much"}}, "values are not those"),
        ({"values": {"share": {"a": 1}}}, "should hold numbers, texts and lists"),
        ({"values": [1]}, "values should be of type dict"),
    ],
)
def test_a_spoilt_finding_is_an_input_error(changes: dict[str, Any], complaint: str) -> None:
    document = to_document(make_calibration())
    good = finding_entry(warning("imu.motion_left_out", share=0.5))
    document["diagnostics"]["warnings"] = [good["message"]]
    document["diagnostics"]["findings"] = [good | changes]
    with pytest.raises(InputError, match=complaint):
        from_document(document, "f")


def test_values_that_are_too_deep_are_an_input_error() -> None:
    text = to_yaml([to_document(make_calibration())])
    for values in ("{share: [[[[1]]]]}", "{share: [[[1]]]}"):
        told = f"  - {{code: x, severity: note, message: m, values: {values}}}"
        spoilt = re.sub(r"^  findings:.*$", f"  findings:\n{told}", text, flags=re.MULTILINE)
        assert spoilt != text
        with pytest.raises(InputError, match="should hold numbers, texts and lists"):
            read_calibrations(spoilt, "f")


def _paths(node: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    found = [path] if path else []
    items = node.items() if isinstance(node, dict) else ()
    for key, value in items:
        found += _paths(value, (*path, key))
    return found


def test_every_missing_or_mistyped_key_is_an_input_error() -> None:
    """No key's absence and no wrong type may end in a traceback."""
    whole = to_document(make_calibration(unobservable=(UP, ROLL)))
    unread = {"tool", "distance_mm", "distance_deg", "observable"}
    for path in _paths(whole):
        for damage in ("missing", "nonsense"):
            document = json.loads(json.dumps(whole))
            node = document
            for key in path[:-1]:
                node = node[key]
            if damage == "missing":
                del node[path[-1]]
            else:
                node[path[-1]] = {"non": ["sense"]}
            free = path[0] == "std" or path[-1] in unread or "notes" in path or "options" in path
            free |= path in {("transform", k) for k in ("rotation_rpy", "rotation_xyzw")}
            free |= path in {("partial",), ("diagnostics", "nominal"), ("provenance", "urdf")}
            later = {
                "corrections",
                "consistency",
                "residual_normalised",
                "imu_model",
                "findings",
                "parameters",
            }
            free |= damage == "missing" and (path[-1] in later or path[-2:-1] == ("corrections",))
            try:
                from_document(document, "f")
            except InputError:
                continue
            assert free, (path, damage)


def _edited(path: tuple[Any, ...], value: Any, **changes: Any) -> str:
    """A document of ours in which one value was edited by hand."""
    document = to_document(make_calibration(**changes))
    node: Any = document
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = value
    return yaml.safe_dump(document)


@pytest.mark.parametrize(
    ("path", "value", "part"),
    [
        (("transform", "translation", 0), math.inf, "translation should be 3 finite numbers"),
        (("transform", "translation", 0), math.nan, "3 finite numbers, not nan"),
        (("transform", "translation", 1), True, "3 finite numbers, not True"),
        (("transform", "translation", 1), "0.1", "3 finite numbers, not '0.1'"),
        (("transform", "translation", 1), 10**400, "3 finite numbers"),
        (("transform", "translation", 1), None, "should have no null"),
        (("transform", "translation", 1), 1e300, "within 100 m"),
        (("transform", "translation", 1), -100.1, "within 100 m"),
        (("transform", "rotation_xyzw", 0), 1e300, "should have norm 1"),
        (("transform", "rotation_rpy", 2), 2.9 + 1e-5, "is not the rotation of rotation_xyzw"),
        (("covariance", 1, 1), math.nan, "covariance should be 6x6 finite numbers, not nan"),
        (("covariance", 1, 1), -1e-9, "covariance should have no negative number"),
        (("covariance", 2), [1.0], "6x6 finite numbers"),
        (("accel_bias", "std", 0), math.inf, "accel_bias.std should be 3 finite numbers"),
        (("time_offset", "seconds"), math.inf, "seconds should be a finite number, not inf"),
        (("time_offset", "seconds"), False, "seconds should be a finite number, not False"),
        (("diagnostics", "nominal", "translation", 2), math.inf, "3 finite numbers, not inf"),
    ],
)
def test_numbers_that_cannot_be_are_refused(path: tuple[Any, ...], value: Any, part: str) -> None:
    with pytest.raises(InputError) as caught:
        read_calibrations(_edited(path, value), "edited.yaml")
    assert part in str(caught.value)
    assert str(caught.value).startswith("edited.yaml: ")


def test_what_the_transform_shows_must_be_what_partial_says() -> None:
    text = _edited(("transform", "translation", 0), 0.5, unobservable=(UP,))
    with pytest.raises(InputError, match="is not that of partial"):
        read_calibrations(text, "x")


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2, math.pi / 2 - 1e-8, 1.5707])
def test_our_own_angles_agree_with_our_quaternion_even_in_gimbal_lock(pitch: float) -> None:
    for roll, yaw in ((0.0, 0.0), (1.0, -2.0), (math.pi, math.pi)):
        R = Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix()
        text = to_yaml([to_document(make_calibration(R_parent_imu=R))])
        (again,) = read_calibrations(text, "x")
        np.testing.assert_allclose(again.estimate.R_parent_imu, R, atol=1e-9)


def test_status_must_agree_with_the_diagnostics() -> None:
    document = to_document(make_calibration(unobservable=(UP,))) | {"status": "ok"}
    with pytest.raises(InputError, match="status is ok"):
        read_calibrations(to_json([document]), "x")


def test_require_distrusts_a_sigma_that_is_too_large() -> None:
    calibration = make_calibration(covariance=np.diag([1e-6, 4e-6, 1e-6] + [1e-8] * 3))
    assert require(calibration, Tolerance(translation=2.1e-3, rotation=1.1e-4)).status == "ok"
    assert require(calibration, Tolerance(rotation=1.1e-4)).status == "ok"
    tight = require(calibration, Tolerance(translation=1e-3))
    assert tight.status == "untrusted"
    (sentence,) = tight.estimate.distrust
    assert sentence == (
        "--require asks for 1 mm, the largest sigma is 2 mm along y of wrist_3_link: record about "
        "4 times as long (sigma falls with the root of the duration), or livelier motion"
    )
    both = require(calibration, Tolerance(translation=1e-5, rotation=math.radians(1e-6)))
    (sentence,) = both.estimate.distrust
    assert "0.01 mm, the largest sigma is 2 mm along y" in sentence
    assert "for 1e-06 deg, the largest sigma is 0.00573 deg about x of wrist_3_link" in sentence
    assert sentence.endswith(
        "record livelier motion (faster turns about several axes) and more of it"
    )


def test_require_advises_what_helps() -> None:
    asked = Tolerance(translation=1e-9)
    segments = require(make_calibration(sigma_source="segments"), asked)
    assert "more of the same motion will not help" in segments.estimate.distrust[0]
    blind = require(make_calibration(unobservable=(UP,)), asked)
    assert blind.estimate.distrust[0].endswith(": record the motion that determines it")
    no_sigma = require(make_calibration(covariance=None, method="paper"), asked)
    assert "1e-06 mm, and --method paper states no sigma" in no_sigma.estimate.distrust[0]
    nan = require(make_calibration(covariance=np.full((6, 6), np.nan)), asked)
    assert nan.status == "untrusted"
    hair = require(
        make_calibration(covariance=np.eye(6) * (1e-3 + 1e-12) ** 2), Tolerance(translation=1e-3)
    )
    assert "1 mm, the largest sigma is 1.000000001 mm" in hair.estimate.distrust[0]


def test_distance_matches_scipy_near_and_far() -> None:
    for angle in (0.0, 1e-9, 0.5, math.pi):
        R = Rotation.from_rotvec([0.0, angle, 0.0])
        calibration = make_calibration(R_parent_imu=R.as_matrix())
        assert calibration.nominal is not None
        found = distance_to(calibration, calibration.nominal)
        assert found.rotation == pytest.approx(angle, rel=1e-9, abs=1e-15)
        assert found.translation == pytest.approx(math.hypot(0.0225, 1e-5))


def test_tf_arguments_put_the_child_where_the_estimate_does() -> None:
    line = render([make_calibration()], "tf")
    words = line.split()
    named = {words[i][2:]: words[i + 1] for i in range(0, len(words), 2)}
    assert named["frame-id"] == "wrist_3_link"
    assert named["child-frame-id"] == "imu_link"
    q = Rotation.from_quat([float(named[k]) for k in ("qx", "qy", "qz", "qw")])
    np.testing.assert_allclose(q.as_matrix(), R_TRUE.as_matrix(), atol=1e-11)
    assert [float(named[k]) for k in "xyz"] == [-0.0225, 0.1, 1e-5]


@pytest.mark.parametrize("fmt", ["tf", "urdf"])
def test_untrusted_poses_are_refused_without_force(fmt: Any) -> None:
    bad = make_calibration(unobservable=(UP,))
    with pytest.raises(UntrustedError, match="translation not determined"):
        render([bad], fmt)
    assert render([bad], "yaml")


def test_published_and_packaged_schema_are_one() -> None:
    for name in ("result.schema.json", "comparison.schema.json"):
        packaged = ROOT / "imucalib_cli/results" / name
        assert packaged.read_bytes() == (ROOT / "docs" / name).read_bytes()


def test_the_summary_gives_both_directions_and_they_undo_each_other() -> None:
    text = summarise(make_calibration())
    positions = [_numbers(line) for line in text.splitlines() if line.startswith("    xyz ")]
    quaternions = [_numbers(line) for line in text.splitlines() if "quaternion xyzw" in line]
    there, back = (Rotation.from_quat(quaternion) for quaternion in quaternions)
    np.testing.assert_allclose((there * back).magnitude(), 0.0, atol=1e-7)
    np.testing.assert_allclose(there.apply(positions[1]) + positions[0], np.zeros(3), atol=1e-6)
    np.testing.assert_allclose(positions[0], [-0.0225, 0.1, 1e-5])
    np.testing.assert_allclose(there.as_matrix(), R_TRUE.as_matrix(), atol=1e-7)
    example = re.search(r"the point \(0\.1 0 0\) of imu_link is \((.*)\) of wrist", text)
    assert example is not None
    expected = np.add(R_TRUE.apply([0.1, 0.0, 0.0]), [-0.0225, 0.1, 1e-5])
    np.testing.assert_allclose(_numbers(example.group(1)), expected, atol=5.1e-5)


def _numbers(text: str) -> list[float]:
    return [float(word) for word in re.findall(r"-?\d+\.\d+", text)]


def test_the_summary_says_what_is_not_known() -> None:
    text = summarise(
        make_calibration(
            unobservable=(UP, ROLL), findings=texts(Severity.UNTRUSTED, ["it wobbles"])
        )
    )
    assert "UNTRUSTED" in text
    far = make_calibration(unobservable=(replace(ROLL, std=math.pi),))
    assert "sigma 180 deg" in summarise(far)
    assert "not trusted: it wobbles" in text
    assert "translation along (0.00 0.00 1.00) of wrist_3_link, sigma unbounded; tilt it" in text
    assert "rotation about (1.00 0.00 0.00) of wrist_3_link, sigma 17 deg; roll it" in text
    assert re.search(r"^  z +not determined$", text, flags=re.MULTILINE)
    assert re.search(r"^  x +-22\.50 ± ", text, flags=re.MULTILINE)
    assert "\x1b[" not in text
    assert "\x1b[31m" in summarise(make_calibration(unobservable=(UP,)), colour=True)
