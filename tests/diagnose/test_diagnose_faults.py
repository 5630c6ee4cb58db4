"""One fault told at a time: named rightly, nothing else blamed, never ok with a wrong pose."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest

from imucalib_cli.diagnose.case import needs_diagnosis
from imucalib_cli.diagnose.diagnose import diagnose, explained
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.estimate.sentence import Says, says_any
from imucalib_cli.simulate.load import load_grade, load_system
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import PhysicsOptions
from imucalib_cli.simulate.physics import record
from imucalib_cli.study.faults import Fault, told_wrongly, with_faulty_sensor
from imucalib_cli.study.trial import error_of

if TYPE_CHECKING:
    from imucalib_cli.diagnose.case import Finding
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.simulate.recording import Recording
    from imucalib_cli.study.trial import Error

ARM, BODY = "rihibot", "barbot"


@cache
def clean(system: str) -> Recording:
    seconds = 30.0 if system == ARM else 45.0
    physics = PhysicsOptions(duration=seconds, imu_rate=125, robot_rate=125)
    return record(load_system(system), physics)


@cache
def judged(system: str, fault: Fault) -> tuple[Estimate, Estimate, tuple[Finding, ...], Error]:
    """The estimate as it comes, as it is told, what was found, and how far off it is."""
    noise = load_grade("industrial")
    noisy = corrupt(with_faulty_sensor(clean(system), fault), noise, seed=3)
    told = told_wrongly(noisy, fault)
    options = MatchedOptions(gravity="none" if system == BODY else "tilt")
    plain = calibrate_matched(told.imu, told.path, options)
    found = diagnose(told.case(plain, options)) if needs_diagnosis(plain) else ()
    return plain, explained(plain, found), found, error_of(plain, noisy)


@pytest.mark.parametrize(
    ("system", "fault", "named", "size", "said"),
    [
        (
            ARM,
            Fault(kind="link", names=("forearm_link",)),
            "wrist_3_link",
            None,
            "rerun with --parent wrist_3_link",
        ),
        (
            ARM,
            Fault(kind="sign", names=("elbow_joint",)),
            "elbow_joint",
            None,
            "turns the other way than the URDF",
        ),
        (
            ARM,
            Fault(kind="zero", names=("wrist_2_joint",), size=-np.pi / 2),
            "wrist_2_joint",
            np.pi / 2,
            "+90 deg",
        ),
        (
            ARM,
            Fault(kind="zero", names=("elbow_joint",), size=np.radians(5)),
            "elbow_joint",
            np.radians(-5),
            "-5 deg of joint elbow_joint",
        ),
        (
            ARM,
            Fault(kind="order"),
            "elbow_joint",
            None,
            "the positions of shoulder_pan_joint and elbow_joint are exchanged in",
        ),
        (ARM, Fault(kind="degrees"), "deg", None, "are in degrees"),
        (ARM, Fault(kind="offset", size=7.3), "", 7.3, "rerun with --max-offset 9s"),
        (BODY, Fault(kind="inverse"), "bar_link", None, "are the wrong way round"),
        (BODY, Fault(kind="quaternion"), "bar_link", None, "come in the order w x y z"),
        (BODY, Fault(kind="millimetres"), "mm", None, "are in millimetres"),
    ],
    ids=lambda value: (
        f"{value.kind}-{value.names[0] if value.names else ''}" if isinstance(value, Fault) else ""
    ),
)
def test_a_gross_fault_is_named_first_and_alone(
    system: str, fault: Fault, named: str, size: float | None, said: str
) -> None:
    plain, told, found, _ = judged(system, fault)
    assert not told.trusted
    assert len(found) == 1
    assert told.distrust[0] == found[0].sentence
    assert said in found[0].sentence
    assert "cannot tell which" not in found[0].sentence
    if named:
        assert named in found[0].names
    if size is not None:
        assert found[0].size[0] == pytest.approx(size, abs=2e-3)
    # What the cause explains is not said again, and advice on motion steps back.
    assert not any(says_any(reason, Says) for reason in (*told.distrust, *told.warnings))
    assert all("cause of the misfit" in direction.motion for direction in told.unobservable)
    assert len(told.unobservable) == len(plain.unobservable)


def test_generic_sentences_are_those_that_step_back() -> None:
    plain, told, _, _ = judged(ARM, Fault(kind="link", names=("forearm_link",)))
    for part in ("does not explain the gyroscope", "of the acceleration unexplained"):
        (reason,) = (reason for reason in plain.distrust if part in reason)
        assert says_any(reason, {Says.POOR})
        assert reason not in told.distrust


def test_a_length_is_a_warning_and_the_widened_result_stands() -> None:
    fault = Fault(kind="length", names=("wrist_1_joint",), size=0.01)
    _, told, found, error = judged(ARM, fault)
    assert told.trusted
    assert [finding.kind for finding in found] == ["length"]
    assert found[0].names == fault.names
    assert found[0].size[0] == pytest.approx(-0.005975, rel=0.05)
    assert "mm shorter than in the URDF" in told.warnings[0]
    assert not any("kinematic model or the mount" in warning for warning in told.warnings[1:])
    assert found[0].moves is not None
    assert found[0].moves[0] == pytest.approx(error.translation_norm, rel=0.3)


def test_a_zero_that_moves_the_answer_is_not_left_to_a_wide_sigma() -> None:
    """Five degrees put the IMU centimetres off: a warning would not do."""
    fault = Fault(kind="zero", names=("wrist_1_joint",), size=float(np.radians(5.0)))
    _, told, found, error = judged(ARM, fault)
    assert not told.trusted
    assert found[0].moves is not None
    assert found[0].moves[0] == pytest.approx(error.translation_norm, rel=0.1)
    assert error.translation_norm > 5e-3


def test_a_time_offset_given_wrongly_is_contradicted() -> None:
    noisy = corrupt(clean(ARM), replace(load_grade("industrial"), time_offset=0.03), seed=3)
    told = told_wrongly(noisy, Fault(kind="none"))
    options = MatchedOptions(time_offset=0.0)
    plain = calibrate_matched(told.imu, told.path, options)
    (found,) = diagnose(told.case(plain, options))
    assert found.kind == "offset"
    assert found.size[0] == pytest.approx(0.03, abs=1e-4)
    assert "30 ms later than the robot's, not the 0 s that were given" in found.sentence
    assert not explained(plain, (found,)).trusted


@pytest.mark.parametrize(("kind", "size"), [("ringing", 6.0), ("hum", 6.0)])
def test_what_rings_after_moves_is_named_and_what_hums_is_not(kind: str, size: float) -> None:
    _, told, found, _ = judged(ARM, Fault(kind=kind, size=size))
    if kind == "hum":
        assert not any("rings at" in line for line in (*told.warnings, *told.distrust))
    else:
        assert [finding.kind for finding in found] == ["ringing"]
        assert found[0].size[0] == pytest.approx(size, abs=0.3)


def test_a_base_that_turns_while_the_joints_stand_still() -> None:
    _, told, found, _ = judged(ARM, Fault(kind="base", size=0.2))
    assert not told.trusted
    assert [finding.kind for finding in found] == ["base"]
    assert "while all that the log knows of stands still: base_link moves" in told.distrust[0]


def test_two_publishers_that_contradict_each_other() -> None:
    _, _, found, _ = judged(ARM, Fault(kind="publishers", size=0.2))
    assert [finding.kind for finding in found] == ["publishers"]
    assert "two publishers tell it and contradict each other" in found[0].sentence
    assert found[0].size[0] == pytest.approx(0.2, rel=0.05)


@pytest.mark.parametrize(
    ("system", "kind"),
    [(ARM, "accel scale"), (ARM, "gyro scale"), (ARM, "handed"), (BODY, "handed")],
)
def test_the_robot_is_not_blamed_for_the_sensor(system: str, kind: str) -> None:
    _, _, found, _ = judged(system, Fault(kind=kind, size=0.02))
    assert found == ()


@pytest.mark.parametrize("system", [ARM, BODY])
def test_a_good_fit_asks_nothing(system: str) -> None:
    plain, told, found, _ = judged(system, Fault(kind="none"))
    assert not needs_diagnosis(plain)
    assert told is plain
    assert found == ()


def test_no_motion_is_advised_where_an_unknown_cause_spoils_the_fit() -> None:
    """Livelier motion would not determine what units that change midway leave open."""
    noisy = corrupt(clean(ARM), load_grade("industrial"), seed=3)
    imu, late = noisy.imu, noisy.imu.t > 0.5 * noisy.imu.t[-1]
    accel = np.where(late[:, None], imu.accel / 9.80665, imu.accel)
    told = told_wrongly(replace(noisy, imu=replace(imu, accel=accel)), Fault(kind="none"))
    plain = calibrate_matched(told.imu, told.path, MatchedOptions())
    assert plain.unobservable
    assert not diagnose(told.case(plain, MatchedOptions()))
    estimate = explained(plain, ())
    assert estimate.distrust == plain.distrust
    for direction in estimate.unobservable:
        assert "before the cause of the misfit is mended" in direction.motion
