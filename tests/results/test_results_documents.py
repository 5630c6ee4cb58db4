"""The documents against the published schema, against themselves, and against bad input."""

import json
import math
import re
import shlex
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import jsonschema
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs, to_builtins
from scipy.spatial.transform import Rotation

from imucalib_cli.errors import InputError
from imucalib_cli.findings import TEXT, note, untrusted, warning
from imucalib_cli.results.codec import read_results, result_from, to_json, to_yaml
from imucalib_cli.results.comparison.answers import schema_of
from imucalib_cli.results.fields import sections, summarise, verdict
from imucalib_cli.results.formats import FORMATS
from imucalib_cli.results.requirement import Tolerance, require
from tests.results.results_samples import (
    DOUBTS,
    R_TRUE,
    RECORDED,
    ROLL,
    UP,
    make_estimate,
    make_result,
)

ROOT = Path(__file__).parents[2]
SCHEMA = jsonschema.Draft202012Validator(json.loads((ROOT / "docs/result.schema.json").read_text()))

VARIANTS: dict[str, dict[str, Any]] = {
    "ok": {},
    "no sigma": {"covariance": None, "time_offset_std": None, "method": "paper"},
    "translation unknown": {"unobservable": (UP,)},
    "rotation unknown": {"unobservable": (ROLL,)},
    "infinite sigma": {"covariance": np.diag([1.0, 1.0, math.inf, 1.0, 1.0, 1.0])},
    "distrusted": {"findings": (untrusted(TEXT, text="segments disagree"),)},
}


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("write", [to_yaml, to_json])
def test_documents_match_schema_and_read_back_equal(variant: str, write: Any) -> None:
    document = to_builtins(make_result(**VARIANTS[variant]))
    text = write([document])
    SCHEMA.validate(document)
    SCHEMA.validate((yaml.safe_load if write is to_yaml else json.loads)(text))
    (again,) = read_results(text, "result.yaml")
    assert to_builtins(again) == document


def test_recording_time_is_read_from_any_writer() -> None:
    """Also from one that leaves the quotes out, which makes of the text a date."""
    text = to_yaml([make_result()])
    assert "start: '2026-05-04T09:15:02.250000Z'" in text
    for form in (text, text.replace("'2026-05-04T09:15:02.250000Z'", "2026-05-04T09:15:02.25Z")):
        (again,) = read_results(form, "result.yaml")
        assert again.recorded_at == RECORDED
    assert "recorded        2026-05-04 09:15:02 UTC, 60 s: 30000 samples" in summarise(again)
    with pytest.raises(InputError, match=r"recording.start .*date"):
        read_results(text.replace("2026-05-04T", "last week, "), "result.yaml")


def test_keys_are_in_schema_order_and_vectors_on_one_line() -> None:
    told = "schema status transform partial covariance std time_offset accel_bias gyro_bias"
    keys = [*told.split(), "gravity_world", "diagnostics", "provenance"]
    result = make_result(unobservable=(UP,))
    assert list(to_builtins(result)) == keys
    text = to_yaml([result])
    assert "  translation: [-0.0225, 0.1, null]\n" in text
    assert "\n- [" in text.split("covariance:")[1]
    assert "&id" not in text


@pytest.mark.parametrize(
    ("direction", "translation", "place"),
    [
        (UP, [-0.0225, 0.1, None], [-0.0225, 0.1, 0.0]),  # there at its nominal value
        (structs.replace(UP, direction_parent=[0.8, 0.0, 0.6]), [None, 0.1, None], None),
        (ROLL, [-0.0225, 0.1, 1e-5], [-0.0225, 0.1, 1e-5]),
    ],
)
def test_undetermined_values_are_null(direction: Any, translation: Any, place: Any) -> None:
    """Of a translation every component that it touches, a rotation as a whole."""
    document = to_builtins(make_result(unobservable=(direction,)))
    assert document["status"] == "untrusted"
    assert document["transform"]["translation"] == translation
    is_turned = direction.kind == "rotation"
    for key in ("rotation_xyzw", "rotation_rpy"):
        assert (document["transform"][key] is None) == is_turned
    assert place is None or document["partial"]["translation"] == place
    assert document["diagnostics"]["unobservable"][0]["std"] == direction.std
    np.testing.assert_allclose(
        Rotation.from_quat(document["partial"]["rotation_xyzw"]).as_matrix(), R_TRUE.as_matrix()
    )


def test_std_and_rotation_agree_with_scipy() -> None:
    document = to_builtins(make_result())
    stds = np.sqrt(np.diag(document["covariance"]))
    np.testing.assert_allclose(document["std"]["translation_mm"], 1e3 * stds[:3])
    np.testing.assert_allclose(document["std"]["rotation_deg"], np.degrees(stds[3:]))
    np.testing.assert_allclose(
        document["transform"]["rotation_rpy"], R_TRUE.as_euler("xyz"), atol=1e-12
    )
    assert document["transform"]["rotation_xyzw"][3] >= 0


def test_several_imus_are_a_yaml_stream_or_json_array() -> None:
    pair = [make_result(), make_result(unobservable=(UP,))]
    documents = [to_builtins(calibration) for calibration in pair]
    assert len(list(yaml.safe_load_all(to_yaml(documents)))) == 2
    array = json.loads(to_json(documents))
    assert len(array) == 2
    SCHEMA.validate(array)
    del array[1]["status"]
    with pytest.raises(jsonschema.ValidationError):
        SCHEMA.validate(array)
    for text in (to_yaml(documents), to_json(documents)):
        assert [c.status for c in read_results(text, "x")] == ["ok", "untrusted"]


@settings(deadline=None)
@given(value=st.floats(allow_nan=False, allow_infinity=False))
def test_floats_survive_yaml_and_json(value: float) -> None:
    document = {"value": [value], "again": value}
    assert yaml.safe_load(to_yaml([document])) == document
    assert json.loads(to_json([document])) == document


@pytest.mark.parametrize("written", ["1e-05", "1E-5", "1.0e-05", "0.00001"])
def test_numbers_written_by_other_tools_are_read(written: str) -> None:
    text = to_yaml([make_result()]).replace("1.0e-05", written)
    assert written in text
    (again,) = read_results(text, "x")
    assert again.pose.t[2] == 1e-5
    assert again.time_offset.std == 1e-5


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("", "empty"),
        ("[]", "empty"),
        ("a: [1", "neither YAML nor JSON"),
        ("\x00", "neither YAML nor JSON"),
        ("hello", "should be a mapping"),
        ("{}", "schema is missing"),
        ("schema: true\nstatus: ok", "schema should be 1, not True"),
        ("schema: 2\nstatus: ok", "schema is 2"),
        ("schema: 1\nstatus: fine", "status should be ok or untrusted, not 'fine'"),
        ("schema: 1\nstatus: ok\ntransform: 3", "transform should be a mapping"),
    ],
)
def test_bad_files_give_one_line_errors(text: str, part: str) -> None:
    with pytest.raises(InputError, match=rf"^bad.yaml: .*{re.escape(part)}.*\Z") as caught:
        read_results(text, "bad.yaml")
    assert "\n" not in str(caught.value)


def test_findings_keep_their_codes_and_values() -> None:
    told = (
        untrusted("imu.motion_left_out", share=np.float64(0.75)),
        warning("stream.leaps", stream="/joints (a, b)", count=np.int64(3), least=0.01),
        warning("robot.held", streams=["/tf"], stretches=[(1.0, 2.5), (3.0, math.inf)]),
        note("log.unindexed", file="a.bag"),
    )
    result = make_result(findings=told)
    for write in (to_yaml, to_json):
        (again,) = read_results(write([result]), "f")
        assert again == result
    document = to_builtins(result)["diagnostics"]
    assert document["findings"][0]["values"] == {"share": 0.75}
    assert document["findings"][2]["values"]["stretches"] == [[1.0, 2.5], [3.0, "inf"]]
    severities = ["untrusted", "warning", "warning", "note"]
    assert [each["severity"] for each in document["findings"]] == severities
    messages = [*document["distrust"], *document["warnings"]]
    assert [each["message"] for each in document["findings"]] == messages


def test_results_without_finding_codes_are_read() -> None:
    """As versions wrote them that had no findings."""
    document = to_builtins(make_result())
    del document["diagnostics"]["findings"]
    document["status"] = "untrusted"
    old = "--require asks for 1 mm, the largest sigma is 2 mm along x of a: record longer"
    document["diagnostics"] |= {"distrust": ["it wobbles", old], "warnings": ["the moon is full"]}
    result = result_from(document, "f")
    found = result.diagnostics.findings
    assert [each.message for each in found] == ["it wobbles", old, "the moon is full"]
    assert [each.code for each in found] == ["text", "require.text", "text"]
    assert [each.severity for each in found] == ["untrusted", "untrusted", "warning"]
    (again,) = read_results(to_yaml([to_builtins(result_from(document, "f"))]), "f")
    assert again == result


@pytest.mark.parametrize(("findings", "known"), [((), 5), (DOUBTS, 0)], ids=["ok", "contradicted"])
def test_missing_known_directions_are_computed(findings: Any, known: int) -> None:
    """A sigma that something contradicts makes no direction known."""
    result = make_result(unobservable=(UP,), findings=findings)
    document = to_builtins(result)
    assert len(document["diagnostics"].pop("observable")) == known
    assert result_from(document, "f") == result


def test_finding_of_a_later_version_is_kept_verbatim() -> None:
    document = to_builtins(make_result())
    document["diagnostics"]["findings"] = [
        {"code": "imu.sings", "severity": "warning", "values": {"hz": 440}, "message": "it sings"}
    ]
    document["diagnostics"]["warnings"] = ["it sings"]
    (told,) = result_from(document, "f").diagnostics.findings
    assert (told.code, told.message) == ("imu.sings", "it sings")


def _paths(node: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    found = [path] if path else []
    items = node.items() if isinstance(node, dict) else ()
    for key, value in items:
        found += _paths(value, (*path, key))
    return found


FINITE = "should be a finite number"
NOT_OF_FINDINGS = "findings are not those of distrust and warnings"
NOT_SEMIDEFINITE = "of imu_link in wrist_3_link is not symmetric, or gives a variance below"
SCALAR, VALUE = "a number or a text or null", "a number or a text or a list or null"


@pytest.mark.parametrize(
    "edit",
    [
        ("transform translation 0", math.inf, f"translation[0] {FINITE}"),
        ("transform translation 0", math.nan, f"translation[0] {FINITE}, not nan"),
        ("transform translation 0", 0.5, "is not that of partial", {"unobservable": (UP,)}),
        ("transform translation 1", True, "[1] should be a number or null, not True"),
        ("transform translation 1", "0.1", "[1] should be a number or null, not '0.1'"),
        ("transform translation 1", 10**400, f"translation[1] {FINITE}"),
        ("transform translation 1", None, "should have no null"),
        ("transform translation 1", 1e300, "within 100 m"),
        ("transform translation 1", -100.1, "within 100 m"),
        ("transform rotation_xyzw 0", 1e300, "should have norm 1"),
        ("transform rotation_rpy 2", 2.9 + 1e-5, "is not the rotation of rotation_xyzw"),
        ("covariance 1 1", math.nan, f"covariance[1][1] {FINITE}, not nan"),
        ("covariance 1 1", -1e-9, f"covariance {NOT_SEMIDEFINITE}"),
        ("covariance 2", [1.0], "covariance[2] should be a list of 6, not [1.0]"),
        ("std translation_mm 0", 99.0, "std.translation_mm[0] is not the root of the covariance"),
        ("std rotation_deg 2", -0.01, "std.rotation_deg[2] is not the root of the covariance"),
        ("time_offset std", -1e-4, "time_offset.std should not be negative"),
        ("accel_bias std 1", -1e-4, "accel_bias.std should not be negative"),
        ("accel_bias std 0", math.inf, f"accel_bias.std[0] {FINITE}"),
        ("time_offset seconds", math.inf, f"seconds {FINITE}, not inf"),
        ("time_offset seconds", False, "seconds should be a number, not False"),
        ("diagnostics nominal translation 2", math.inf, f"translation[2] {FINITE}, not inf"),
        ("status", "ok", "status is ok", {"unobservable": (UP,)}),
        # reasons without findings would be lost: decisions use the findings
        ("diagnostics findings", [], NOT_OF_FINDINGS),
        ("diagnostics findings 0 severity", "fatal", "should be note or untrusted or warning"),
        ("diagnostics findings 0 severity", "warning", NOT_OF_FINDINGS),
        ("diagnostics findings 0 values share", {"a": 1}, f"values[...] should be {VALUE}"),
        ("diagnostics findings 0 values", [1], "values should be a mapping"),
        # nested too deeply
        ("diagnostics findings 0 values share", [[[[1]]]], f"] should be {SCALAR}"),
        ("diagnostics findings 0 values share", [[[[[1]]]]], f"] should be {SCALAR}"),
    ],
    ids=lambda edit: f"{edit[0]} = {str(edit[1])[:9]}",
)
def test_inconsistent_edits_are_refused(edit: tuple[Any, ...]) -> None:
    place, value, part, *more = edit
    changes = {"findings": DOUBTS} if "findings" in place else (more or [{}])[0]
    document = to_builtins(make_result(**changes))
    node: Any = document
    *path, last = (int(key) if key.isdigit() else key for key in place.split())
    for key in path:
        node = node[key]
    node[last] = value
    with pytest.raises(InputError, match=f"^edited.yaml: .*{re.escape(part)}"):
        read_results(yaml.safe_dump(document), "edited.yaml")


def test_lone_surrogate_is_an_input_error() -> None:
    """JSON and YAML can name it, UTF-8 cannot write it."""
    document = to_builtins(make_result())
    document["diagnostics"]["notes"]["unit"] = "\ud800"
    with pytest.raises(InputError, match=r"notes\.unit has half of a character"):
        result_from(document, "f")
    # libyaml, where it is there, refuses it before
    with pytest.raises(InputError, match=r"half of a character|invalid Unicode character escape"):
        read_results(json.dumps(document), "f")


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2, math.pi / 2 - 1e-8, 1.5707])
def test_angles_agree_with_quaternion_in_gimbal_lock(pitch: float) -> None:
    for roll, yaw in ((0.0, 0.0), (1.0, -2.0), (math.pi, math.pi)):
        R = Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix()
        text = to_yaml([make_result(R_parent_imu=R)])
        (again,) = read_results(text, "x")
        np.testing.assert_allclose(again.pose.R, R, atol=1e-9)


UNEVEN = {"covariance": np.diag([1e-6, 4e-6, 1e-6] + [1e-8] * 3)}
TINY = Tolerance(translation=1e-9)


@pytest.mark.parametrize(
    ("changes", "asked", "said"),
    [
        (
            UNEVEN,
            Tolerance(translation=1e-3),
            (
                "^--require asks for 1 mm, the largest sigma is 2 mm along y of wrist_3_link: "
                r"record about 4 times as long \(sigma falls with the root of the duration\), or "
                "faster motion$"
            ),
        ),
        (
            UNEVEN,
            Tolerance(translation=1e-5, rotation=math.radians(1e-6)),
            (
                r"0\.01 mm, the largest sigma is 2 mm along y.*for 1e-06 deg, the largest sigma is "
                r"0\.00573 deg about x of wrist_3_link.*record faster turns "
                r"about several axes, and more of them$"
            ),
        ),
        ({"unobservable": (UP,)}, TINY, ": record the motion that determines it$"),
        (
            {"covariance": None, "method": "paper"},
            TINY,
            "1e-06 mm, but --method paper gives no sigma",
        ),
        ({"covariance": np.full((6, 6), np.nan)}, TINY, "1e-06 mm"),
        (
            {"covariance": np.eye(6) * (1e-3 + 1e-12) ** 2},
            Tolerance(translation=1e-3),
            r"1 mm, the largest sigma is 1\.000000001 mm",
        ),
    ],
    ids=["longer", "faster", "unobservable", "no sigma", "nan", "by a hair"],
)
def test_sigma_above_requirement_is_untrusted_with_advice(
    changes: Any, asked: Tolerance, said: str
) -> None:
    (sentence,) = require(make_estimate(**changes), "wrist_3_link", asked).distrust
    assert re.search(said, sentence)


def test_sigma_within_requirement_stays_trusted() -> None:
    for asked in (Tolerance(translation=2.1e-3, rotation=1.1e-4), Tolerance(rotation=1.1e-4)):
        assert require(make_estimate(**UNEVEN), "wrist_3_link", asked).trusted


def test_distance_matches_scipy_near_and_far() -> None:
    for angle in (0.0, 1e-9, 0.5, math.pi):
        R = Rotation.from_rotvec([0.0, angle, 0.0])
        nominal = make_result(R_parent_imu=R.as_matrix()).diagnostics.nominal
        assert nominal is not None
        found = math.radians(nominal.distance_deg), nominal.distance_mm * 1e-3
        assert found[0] == pytest.approx(angle, rel=1e-9, abs=1e-15)
        assert found[1] == pytest.approx(math.hypot(0.0225, 1e-5))


T_TRUE = np.vstack([np.column_stack([R_TRUE.as_matrix(), [-0.0225, 0.1, 1e-5]]), [0, 0, 0, 1]])


def test_all_output_formats_give_the_same_pose() -> None:
    texts = {name: each.render([make_result()]) for name, each in FORMATS.items()}
    words = texts["tf"].split()
    named = {words[i][2:]: words[i + 1] for i in range(0, len(words), 2)}
    assert (named["frame-id"], named["child-frame-id"]) == ("wrist_3_link", "imu_link")
    q = Rotation.from_quat([float(named[k]) for k in ("qx", "qy", "qz", "qw")])
    np.testing.assert_allclose(q.as_matrix(), R_TRUE.as_matrix(), atol=1e-11)
    assert [float(named[k]) for k in "xyz"] == [-0.0225, 0.1, 1e-5]
    matrix = np.array([line.split() for line in texts["matrix"].splitlines()], dtype=float)
    np.testing.assert_allclose(matrix, T_TRUE, atol=1e-11)
    kalibr = yaml.safe_load(texts["kalibr"])
    np.testing.assert_allclose(kalibr["T_cam_imu"], T_TRUE, atol=1e-11)
    # t_imu = t_cam + shift, as Kalibr prints it
    assert kalibr["timeshift_cam_imu"] == make_result().time_offset.seconds
    lio = yaml.safe_load(texts["fast-lio"])  # the LiDAR, here the parent, in the IMU
    inverse = np.linalg.inv(T_TRUE)
    np.testing.assert_allclose(lio["extrinsic_T"], inverse[:3, 3], atol=1e-11)
    np.testing.assert_allclose(lio["extrinsic_R"], inverse[:3, :3].ravel(), atol=1e-11)
    *numbers, parent, child = texts["tf1"].split()
    assert [parent, child] == ["wrist_3_link", "imu_link"]
    q = Rotation.from_quat([float(each) for each in numbers[3:]])
    np.testing.assert_allclose(q.as_matrix(), R_TRUE.as_matrix(), atol=1e-11)
    node = ET.fromstring(texts["launch"])
    assert node.attrib["args"] == texts["tf"].strip()
    properties = ET.fromstring(f'<r xmlns:xacro="x">{texts["xacro"]}</r>')
    values = {each.attrib["name"]: each.attrib["value"].split() for each in properties}
    rpy = Rotation.from_euler("xyz", [float(each) for each in values["imu_link_rpy"]])
    np.testing.assert_allclose(rpy.as_matrix(), R_TRUE.as_matrix(), atol=1e-11)
    assert [float(each) for each in values["imu_link_xyz"]] == [-0.0225, 0.1, 1e-5]


def test_output_formats_separate_several_imus() -> None:
    results = [make_result(child=child) for child in ("imu-a", "imu_a", "9")]
    root = ET.fromstring(f'<r xmlns:xacro="x">{FORMATS["xacro"].render(results)}</r>')
    names = [each.attrib["name"] for each in root]
    assert len(set(names)) == 6
    assert all(name.isidentifier() for name in names)
    for form in ("kalibr", "fast-lio"):
        assert len(list(yaml.safe_load_all(FORMATS[form].render(results)))) == 3
    lines = FORMATS["matrix"].render(results).splitlines()
    assert lines[::5] == [f"# {each.child} in wrist_3_link" for each in results]
    np.testing.assert_allclose(np.loadtxt(lines), np.vstack([T_TRUE] * 3), atol=1e-11)


def test_names_execute_nothing_in_launch_file_or_shell() -> None:
    evil = make_result(child="$(command 'id')\nrm -rf \\")
    node = ET.fromstring(FORMATS["launch"].render([evil]))
    assert "\\$(command" in node.attrib["args"]
    assert "$(" not in node.attrib["args"].replace("\\$(", "")
    for form in ("tf", "tf1"):
        text = FORMATS[form].render([evil])
        assert text.count("\n") == 1
        assert shlex.split(text)[-1].startswith("$(command")
    for name in ("x; touch PWNED #", "x --frame-id evil", "`id`", "a b", "*"):
        words = shlex.split(FORMATS["tf"].render([make_result(child=name)]))
        assert words[-4:] == ["--frame-id", "wrist_3_link", "--child-frame-id", name]


@pytest.mark.parametrize("which", ["result", "comparison"])
def test_published_schema_matches_the_code(which: Any) -> None:
    """To write it again: imucalib schema result > docs/result.schema.json."""
    assert (ROOT / f"docs/{which}.schema.json").read_text() == schema_of(which)


def test_summary_directions_are_inverse_to_each_other() -> None:
    text = summarise(make_result())
    assert next(line for line in text.splitlines() if "±" in line) == "  ± is 1 sigma"
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


def test_every_listed_field_is_in_the_summary() -> None:
    result = make_result(unobservable=(UP,), findings=(warning(TEXT, text="it creaks"),))
    listed = sections(result)
    assert len({section.title for section in listed}) == len(listed)
    assert [section.title for section in listed if section.formula] == [
        "pose of imu_link in wrist_3_link",
        "the other way, pose of wrist_3_link in imu_link",
    ]
    fields = [field for section in listed for field in section.fields]
    text = summarise(result)
    assert all(field.label in text and field.text in text for field in fields)
    severities = {field.severity: field.label for field in fields if field.severity}
    assert severities["untrusted"] == "not determined"
    assert severities["warning"] == "warning"


MOUNT, DISTRUST = "imu_link in wrist_3_link", "untrusted, do not use this result: "


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({}, f"ok: {MOUNT} is known to 0.35 mm and 0.019 deg (1 sigma, "),
        ({"covariance": None}, f"ok: {MOUNT} is found; --method matched states no"),
        ({"covariance": np.zeros((6, 6))}, f"ok: {MOUNT} is held as given by --fix"),
        ({"unobservable": (UP,), "findings": DOUBTS}, f"{DISTRUST}it wobbles"),
        ({"unobservable": (UP,)}, f"{DISTRUST}not determined: translation along (0.00 0.00 1.00"),
    ],
)
def test_the_verdict_is_one_sentence(changes: dict[str, Any], sentence: str) -> None:
    assert verdict(make_result(**changes)).startswith(sentence)


def _numbers(text: str) -> list[float]:
    return [float(word) for word in re.findall(r"-?\d+\.\d+", text)]


def test_summary_lists_unknowns() -> None:
    text = summarise(make_result(unobservable=(UP, ROLL), findings=DOUBTS))
    assert "UNTRUSTED" in text
    far = make_result(unobservable=(structs.replace(ROLL, std=math.pi),))
    assert "sigma 180 deg" in summarise(far)
    assert "not trusted: it wobbles" in text
    assert "translation along (0.00 0.00 1.00) of wrist_3_link, sigma unbounded; tilt it" in text
    assert "rotation about (1.00 0.00 0.00) of wrist_3_link, sigma 17 deg; roll it" in text
    assert re.search(r"^  z +not determined$", text, flags=re.MULTILINE)
    assert re.search(r"^  x +-22\.50 ± ", text, flags=re.MULTILINE)
    assert "\x1b[" not in text
    assert "\x1b[31m" in summarise(make_result(unobservable=(UP,)), colour=True)
