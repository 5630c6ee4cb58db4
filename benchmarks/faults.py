"""Faults of robot and log, one at a time, and what the diagnosis says of them.

    python -m benchmarks.faults [SEEDS [KIND...]]

RiHIBot and BarBot are simulated, a fault is put into the estimator's inputs (URDF, joint names,
clock, poses) or into the mount, and the result is judged: which cause is named, whether the names
and figures are right, and whether a pose that is off by more than three sigma was ever called ok.
Faults of the IMU itself stand below: none of the causes looked for here may be blamed for them.
"""

from __future__ import annotations

import sys
from collections import Counter
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.linalg import norm

from benchmarks.common import grade, parallel, table
from imucalib_cli.diagnose.diagnose import needs_diagnosis
from imucalib_cli.errors import ImucalibError
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import PhysicsOptions
from imucalib_cli.study.recordings import clean_recording
from tools.errors import error_of
from tools.faults import Fault, misdescribed, with_faulty_sensor

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.findings import Finding

ROBOT = load_system("rihibot").joints
JOINTS, LINKS = tuple(joint.name for joint in ROBOT), tuple(joint.child for joint in ROBOT[:-1])
PHYSICS = PhysicsOptions(imu_rate=250, robot_rate=125)
OFFSET = 0.0125
LEAST = (1e-5, 1e-5)
"""m and rad: without noise sigma is less than the quadrature errs."""
SENSOR = (
    Fault(kind="accel scale", size=0.02),
    Fault(kind="gyro scale", size=0.02),
    Fault(kind="handed"),
)
ARM = (
    Fault(kind="none"),
    *(Fault(kind="link", names=(link,)) for link in LINKS),
    *(Fault(kind="sign", names=(joint,)) for joint in JOINTS),
    Fault(kind="sign", names=("shoulder_lift_joint", "wrist_2_joint")),
    *(
        Fault(kind="zero", names=(joint,), size=float(np.radians(angle)))
        for joint, angle in product(JOINTS[1:5], (0.57, 5.0, 30.0, -90.0))
    ),
    *(Fault(kind="length", names=(joint,), size=0.01) for joint in JOINTS[2:5]),
    Fault(kind="order"),
    *(Fault(kind="order", names=pair) for pair in (JOINTS[:2], JOINTS[2:5:2], JOINTS[3::2])),
    Fault(kind="degrees"),
    Fault(kind="publishers", size=0.2),
    *(Fault(kind="offset", size=size) for size in (1.8, 7.3, -23.0)),
    *(Fault(kind="ringing", size=size) for size in (6.0, 11.8)),
    Fault(kind="base", size=0.2),
    Fault(kind="hum", size=11.0),
    *SENSOR,
)
BODY = (
    *(Fault(kind=kind) for kind in ("none", "inverse", "quaternion", "conjugate", "millimetres")),
    Fault(kind="publishers", size=0.2),
    Fault(kind="offset", size=9.0),
    *SENSOR,
)
SYSTEMS: dict[str, tuple[tuple[Fault, ...], MatchedOptions, dict[str, float]]] = {
    "rihibot": (ARM, MatchedOptions(), {"encoder_noise": 2e-5}),
    "barbot": (
        BODY,
        MatchedOptions(gravity="none"),
        {"pose_noise": 1e-5, "pose_noise_rotation": 2e-5},
    ),
}
"""Faults, options of the estimator, and noise of the robot."""
NAMED = {
    "degrees": "unit",
    "millimetres": "unit",
    "ringing": "unknown.implausible",
    "base": "base_moves",
    "handed": "axes",
}
"""Names of faults in findings, where they differ."""


class Verdict(NamedTuple):
    """The judgement of one recording."""

    fault: Fault
    grade: str
    named: str
    """Cause that is named, or unknown.found where the fit corrected it; "-" nothing was found, "not
    asked" the fit was good."""
    right: bool
    """The names are right, and the size within a hundredth."""
    trusted: bool
    wrong_ok: bool
    sentence: str


def judge(system: str, fault: Fault, noise: str, seed: int) -> Verdict:
    """One recording with one fault."""
    _, options, extra = SYSTEMS[system]
    clean = with_faulty_sensor(clean_recording(system, PHYSICS), fault)
    noisy = corrupt(clean, grade(noise, time_offset=OFFSET, **extra), seed)
    try:
        case = misdescribed(noisy, fault).judged(options)
    except ImucalibError as refusal:
        return Verdict(fault, noise, "refused", True, False, False, str(refusal))
    estimate, asked = case.explained, needs_diagnosis(case.plain)
    error, covariance = error_of(estimate, noisy), np.asarray(estimate.covariance)
    shift, turn = (np.sqrt(np.trace(covariance[part, part])) for part in (slice(3), slice(3, 6)))
    off = norm(error[:3]) > 3 * shift + LEAST[0] or norm(error[3:]) > 3 * turn + LEAST[1]
    finding = case.found[0] if case.found else _learnt(estimate, fault)
    named = finding.code.removeprefix("cause.") if finding else "-" if asked else "not asked"
    right = finding is not None and _right(fault, finding)
    sentence = finding.message if finding else "; ".join(estimate.distrust[:1])
    wrong = estimate.trusted and bool(off)
    return Verdict(fault, noise, named, right, estimate.trusted, wrong, sentence)


def _learnt(estimate: Estimate, fault: Fault) -> Finding | None:
    """The error of the joint at fault that the fit itself found and corrected."""
    found = (each for each in estimate.findings if each.code.startswith("unknown."))
    if fault.kind == "ringing":
        return next((each for each in found if each.values["name"] == "mount_give"), None)
    return next((each for each in found if _owner(each) in fault.names), None)


def _owner(finding: Finding) -> str:
    """The joint that an unknown is of."""
    labels = finding.values.get("labels", (finding.values.get("label"),))
    return str(labels[0]).split(" ", 1)[0] if isinstance(labels, tuple) else ""


def _right(fault: Fault, finding: Finding) -> bool:
    """Whether the right thing is named, and its size."""
    if fault.kind == "ringing":
        given: Any = finding.values.get("value", finding.values.get("values"))
        give = np.ravel(given)[0]
        return bool(abs(1.0 / (2.0 * np.pi * np.sqrt(give)) - fault.size) < 0.1 * fault.size)
    if finding.code.startswith("unknown."):
        return True
    names: Any = finding.values["names"]
    sizes: Any = finding.values.get("sizes", ())
    match fault.kind:
        case "link":
            right = names == ("wrist_3_link",)
        case "sign":
            right = set(fault.names) <= set(names)
        case "zero":
            right = fault.names[0] in names and abs(sizes[0] + fault.size) < 0.01 * abs(fault.size)
        case "length":
            right = fault.names[0] in names
        case "order":
            right = set(names) == set(fault.names or ("elbow_joint", "shoulder_pan_joint"))
        case "offset":
            right = abs(sizes[0] - fault.size - OFFSET) < 0.001
        case _:
            right = True
    return bool(right)


def main() -> None:
    """Print the table of faults against what was named, and what went wrong."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    kinds = sys.argv[2:]
    cases = [
        (system, fault, noise, seed)
        for system, (faults, _, _) in SYSTEMS.items()
        for fault in faults
        if fault.kind in kinds or not kinds
        for noise in ("ideal", "industrial", "mems")
        for seed in range(seeds)
    ]
    verdicts: list[Verdict] = parallel(judge, cases)
    line = table(
        "told", "named", "names and figures right", "untrusted", "ok though off by 3 sigma"
    )
    for kind in dict.fromkeys(verdict.fault.kind for verdict in verdicts):
        own = [verdict for verdict in verdicts if verdict.fault.kind == kind]
        named = [v for v in own if v.named == NAMED.get(kind, kind)]
        line(
            kind,
            ", ".join(f"{name} {n}" for name, n in Counter(v.named for v in own).most_common()),
            f"{sum(v.right for v in named)} of {len(named)}",
            f"{sum(not v.trusted for v in own)} of {len(own)}",
            sum(v.wrong_ok for v in own),
        )
    print()
    for fault, noise, named_as, right, _, wrong_ok, sentence in verdicts:
        expected = NAMED.get(fault.kind, fault.kind)
        missed = named_as not in (expected, "not asked") and fault.kind not in ("none", "hum")
        if missed or wrong_ok or (named_as == expected and not right):
            print(
                f"{fault.kind} {', '.join(fault.names)} {fault.size:.4g}, {noise}: "
                f"{named_as}; ok though off: {wrong_ok}; {sentence}"
            )


if __name__ == "__main__":
    main()
