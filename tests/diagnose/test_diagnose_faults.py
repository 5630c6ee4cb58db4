"""One fault at a time: it is named, nothing else is blamed, and a wrong pose is never ok."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from imucalib_cli.diagnose.diagnose import needs_diagnosis
from imucalib_cli.diagnose.hypotheses import single_faults
from imucalib_cli.diagnose.publishers import find_rival_publishers
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.findings import Finding
from imucalib_cli.messages import UNSPECIFIC
from imucalib_cli.robot.path import JointStep
from imucalib_cli.signals.imu.repair import repair
from imucalib_cli.signals.imu.units import Units
from imucalib_cli.simulate.load import load_grade
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.recording import Recording
from tests.simulate.simulate_samples import recorded
from tests.slow import slow_after
from tools.errors import error_of
from tools.faults import Fault, Judged, misdescribed, with_faulty_sensor

ARM, BODY = "rihibot", "barbot"


@cache
def clean(system: str) -> Recording:
    seconds = 30.0 if system == ARM else 45.0
    return recorded(system, duration=seconds, imu_rate=125, robot_rate=125)


@cache
def noisy(system: str, fault: Fault) -> Recording:
    return corrupt(with_faulty_sensor(clean(system), fault), load_grade("industrial"), seed=3)


@cache
def judged(system: str, fault: Fault) -> Judged:
    options = MatchedOptions(gravity="none" if system == BODY else "tilt")
    return misdescribed(noisy(system, fault), fault).judged(options)


def value(finding: Finding, name: str) -> Any:
    return finding.values[name]


def flawed(kind: str, name: str = "", size: float = 0.0) -> Fault:
    return Fault(kind=kind, names=(name,) if name else (), size=size)


@pytest.mark.parametrize(
    ("system", "fault", "code", "named", "size"),
    slow_after(
        1,
        [
            (ARM, flawed("offset", size=7.3), "offset", "", np.degrees(7.3)),
            (ARM, flawed("zero", "elbow_joint", np.radians(5)), "zero", "elbow_joint", -5.0),
            (ARM, flawed("zero", "wrist_2_joint", -np.pi / 2), "zero", "wrist_2_joint", 90.0),
            (ARM, flawed("zero", "elbow_joint", np.radians(25)), "zero", "elbow_joint", -25.0),
            (BODY, flawed("handed"), "axes", "", None),
        ],
    ),
)
def test_a_gross_fault_is_named_first_and_alone(
    system: str, fault: Fault, code: str, named: str, size: float | None
) -> None:
    """The size is in degrees, or in those of a radian a second.

    tests/troubleshooting has faults without a size.
    """
    case = judged(system, fault)
    (cause,), explained = case.found, case.explained
    assert not explained.trusted
    assert cause.code == f"cause.{code}"
    assert explained.distrust[0] == cause.message
    assert len(value(cause, "ties")) == 1
    assert "cannot tell which" not in cause.message
    if named:
        assert named in value(cause, "names")
    if size is not None:
        assert value(cause, "sizes")[0] == pytest.approx(np.radians(size), abs=2e-3)
    # Consequences of the cause are not reported again, and advice on motion steps back.
    assert not any(each.code in UNSPECIFIC for each in explained.findings)
    assert all("cause of the poor fit" in direction.motion for direction in explained.unobservable)
    assert len(explained.unobservable) == len(case.plain.unobservable)


@pytest.mark.slow
def test_indistinguishable_causes_are_all_named() -> None:
    """A pan joint turned over is, to the last digit, a lift joint turned by half a turn."""
    case = judged(ARM, flawed("sign", "shoulder_pan_joint"))
    (cause,) = case.found
    assert cause.code == "cause.sign"
    kinds = {(tie[0], tie[1]) for tie in value(cause, "ties")}
    assert kinds == {("sign", ("shoulder_pan_joint",)), ("zero", ("shoulder_lift_joint",))}
    assert "the log cannot tell which" in case.explained.distrust[0]


@pytest.mark.parametrize(
    ("kind", "joint", "size"),
    slow_after(
        1,
        [
            ("zero", "elbow_joint", 0.00995),
            ("length", "wrist_1_joint", 0.01),
            ("zero", "wrist_1_joint", np.radians(5.0)),
            ("zero", "wrist_2_joint", np.radians(5.0)),
            ("length", "elbow_joint", 0.01),
            ("length", "wrist_2_joint", 0.01),
        ],
    ),
)
def test_small_chain_error_is_corrected_and_named_if_significant(
    kind: str, joint: str, size: float
) -> None:
    fault = flawed(kind, joint, size)
    case = judged(ARM, fault)
    assert case.plain.covariance is not None
    sigma = np.sqrt(np.diag(case.plain.covariance))
    assert np.all(np.abs(error_of(case.plain, noisy(ARM, fault))) < 4.0 * sigma)
    blamed: list[Any] = [
        name
        for each in case.explained.findings
        if each.code in {"unknown.found", "unknown.implausible", "cause.zero"}
        for name in each.values.get("labels") or each.values.get("names") or ()  # type: ignore[union-attr]
    ]
    assert all(str(name).startswith(joint) for name in blamed)


@pytest.mark.slow
@pytest.mark.parametrize("late", [0.03, 0.4, 3.0])
def test_a_wrong_stated_time_offset_is_contradicted(late: float) -> None:
    recording = corrupt(clean(ARM), replace(load_grade("industrial"), time_offset=late), seed=3)
    case = misdescribed(recording, flawed("none")).judged(MatchedOptions(time_offset=0.0))
    assert not case.explained.trusted
    found = case.explained.findings[0]
    if found.code == "prior.contradicted":
        assert found.values["option"] == "--time-offset"
        assert value(found, "step") == pytest.approx(late, abs=1e-4)
    else:
        assert found.code == "cause.offset"
        assert value(found, "sizes")[0] == pytest.approx(late, abs=1e-4)
        assert "later than the robot's, not the 0 s that were given" in found.message


@pytest.mark.slow
def test_a_fault_beside_a_late_gyroscope_is_named() -> None:
    """It leaves more than a right model does, and a small part of what was given."""
    recording, fault = noisy(BODY, flawed("conjugate")), flawed("conjugate")
    late = np.roll(recording.imu.gyro, 5, axis=0)  # 40 ms
    recording = replace(recording, imu=replace(recording.imu, gyro=late))
    found = misdescribed(recording, fault).judged(MatchedOptions(gravity="none"))
    assert found.found[0].code == "cause.conjugate"


@pytest.mark.slow
def test_fault_that_needs_another_time_offset_too_is_not_named() -> None:
    """With the offset freed too, any zero of a joint about gravity fits, and so does no zero."""
    recording = noisy(ARM, flawed("none"))
    case = misdescribed(recording, flawed("none")).judged(MatchedOptions(time_offset=7.0))
    (found, *_) = case.explained.findings
    assert found.code == "cause.offset"
    assert [tie[0] for tie in value(found, "ties")] == ["offset"]


@pytest.mark.slow
@pytest.mark.parametrize("rate", [6.0, 11.8])
def test_flexible_mount_is_reported_with_its_frequency(rate: float) -> None:
    case = judged(ARM, flawed("ringing", size=rate))
    assert not case.explained.trusted
    assert case.found == ()
    gives = [e for e in case.explained.findings if e.values.get("name") == "mount_give"]
    assert [each.code for each in gives] == ["unknown.implausible"]
    give = float(value(gives[0], "value"))
    assert give == pytest.approx(1.0 / (2.0 * np.pi * rate) ** 2, rel=0.1)


@pytest.mark.slow
def test_hum_is_not_reported_as_flexible_mount() -> None:
    found = judged(ARM, flawed("hum", size=6.0)).explained.findings
    assert not any(each.values.get("name") == "mount_give" for each in found)


@pytest.mark.parametrize("system", slow_after(1, [ARM, BODY]))
def test_contradicting_publishers_are_named(system: str) -> None:
    case = judged(system, flawed("publishers", size=0.2))
    assert not case.explained.trusted
    (cause,) = case.found
    assert cause.code == "cause.publishers"
    assert case.explained.distrust[0] == cause.message
    assert value(cause, "sizes")[0] == pytest.approx(0.2, rel=0.05)


def test_encoder_toggling_between_two_counts_is_one_publisher() -> None:
    """Its jumps are as large as its steps are."""
    path = misdescribed(clean(ARM), flawed("none")).path
    (track,) = path.tracks
    count, values = 2.0 * np.pi / 4096.0, track.values.copy()
    values[:, 0] = count * (np.random.default_rng(1).random(len(values)) < 0.5)
    undecided = structs.replace(path, tracks=(structs.replace(track, values=values),))
    assert find_rival_publishers(undecided) is None
    values[:, 0] = 20.0 * values[:, 0] + track.values[:, 0]
    assert find_rival_publishers(undecided) is not None


@pytest.mark.slow
def test_signs_of_quaternions_are_one_publisher() -> None:
    """A quaternion and its negative are one rotation, and some publishers choose either."""
    given = misdescribed(clean(BODY), flawed("none"))
    (track,) = given.path.tracks
    values = track.values.copy()
    values[:, 3:] *= np.random.default_rng(1).choice((-1.0, 1.0), (len(values), 1))
    path = structs.replace(given.path, tracks=(structs.replace(track, values=values),))
    mended = repair(given.imu, path, units=Units(), gravity=0.0, max_offset=1.0)
    assert find_rival_publishers(mended.path) is None


@pytest.mark.parametrize("system", slow_after(1, [ARM, BODY]))
def test_good_fit_needs_no_diagnosis(system: str) -> None:
    case = judged(system, flawed("none"))
    assert not needs_diagnosis(case.plain)
    assert case.explained is case.plain
    assert case.found == ()


@pytest.mark.slow
def test_poor_fit_of_unknown_cause_advises_no_motion() -> None:
    """Livelier motion would not determine what units that change midway leave open."""
    recording = noisy(ARM, flawed("none"))
    imu, late = recording.imu, recording.imu.t > 0.5 * recording.imu.t[-1]
    accel = np.where(late[:, None], imu.accel / 9.80665, imu.accel)
    spoiled = misdescribed(replace(recording, imu=replace(imu, accel=accel)), flawed("none"))
    case = spoiled.judged(MatchedOptions())
    assert case.plain.unobservable
    assert case.found == ()
    assert case.explained.distrust == case.plain.distrust
    for direction in case.explained.unobservable:
        assert "correct the cause of the poor fit first" in direction.motion


def test_position_swapped_with_another_limb_is_found() -> None:
    """And with all in the URDF's order, under names in another."""
    described = misdescribed(clean(ARM), flawed("none"))
    (track,) = described.path.tracks
    values = np.insert(track.values, 0, 0.0, axis=1)
    wide = structs.replace(track, names=("a_joint", *track.names), values=values)
    steps = tuple(
        structs.replace(step, column=step.column + 1) if isinstance(step, JointStep) else step
        for step in described.path.steps
    )
    poor = structs.replace(
        described.poor_fit(judged(ARM, flawed("none")).plain, MatchedOptions()),
        path=structs.replace(described.path, steps=steps, tracks=(wide,)),
        joints=(*track.names[::-1], "a_joint"),
    )
    orders = [each for each in single_faults(poor) if each.kind == "order"]
    assert any(set(each.names) == {"a_joint", track.names[2]} for each in orders)
    columns = [[s.column for s in each.path.steps if isinstance(s, JointStep)] for each in orders]
    assert [6 - step.column for step in steps if isinstance(step, JointStep)] in columns
