"""The words of what an estimate finds out: the part of messages.MESSAGES on fits and causes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from imucalib_cli.digits import with_std

if TYPE_CHECKING:
    from collections.abc import Callable

_COMPONENTS = ("x", "y", "z")


def _rotation_unexplained(share: float, max_offset: float | None) -> str:
    beyond = (
        f", or do the clocks differ by more than {max_offset:g} s (--max-offset)"
        if max_offset is not None
        else ""
    )
    return (
        f"the robot's motion does not explain the gyroscope ({share:.0%} of the rotation is left "
        f"over): is this the right parent link, URDF and joint topic{beyond}?"
    )


def _beyond_noise(sensor: str, ratio: float) -> str:
    name = {"accel": "accelerometer", "gyro": "gyroscope"}[sensor]
    return (
        f"what the model leaves of the {name} is {ratio:.2g} times the noise that sensor and "
        "encoders show: a mount or a link that is not rigid, or kinematics, stamps or units that "
        "are not what they are taken for"
    )


def _left_out(count: int, total: int, start: float | None, end: float | None) -> str:
    where = (
        f", nearly all between {start:.0f} and {end:.0f} s of the log: look what changed there, "
        "the result is that of the rest"
        if start is not None
        else ""
    )
    return f"{count} of {total} windows do not fit the rest and were left out{where}"


def _window(sigmas: float, seconds: float, used: float, translation: float, rotation: float) -> str:
    return (
        f"the answer depends on the filter window: at {seconds:.2g} s instead of {used:.2g} s the "
        f"IMU would be {translation * 1e3:.2g} mm and {math.degrees(rotation):.2g} deg elsewhere, "
        f"{sigmas:.2g} sigma: something that no unknown of the model explains moves it, such as a "
        "mount or a joint that gives; sigma includes this difference"
    )


def _mount_moved(
    *,
    seconds: float,
    uncertainty: float,
    translation: float,
    rotation: float,
    translation_std: float = 0.0,  # not in results of the first stage
    rotation_std: float = 0.0,
) -> str:
    return (
        f"before and after about {seconds:.0f} ± {max(uncertainty, 1.0):.0f} s of the log the "
        f"IMU's pose differs by {translation * 1e3:.3g} ± {translation_std * 1e3:.2g} mm and "
        f"{math.degrees(rotation):.2g} ± {math.degrees(rotation_std):.2g} deg, "
        "beyond what noise and model explain: the mount moved, or the log joins two set-ups; "
        "calibrate each part alone"
    )


def _clock_step(seconds: float, uncertainty: float, size: float) -> str:
    return (
        f"the clocks of IMU and robot shift by {size * 1e3:+.3g} ms against each other at about "
        f"{seconds:.0f} ± {max(uncertainty, 1.0):.0f} s of the log: use a part on one side of it, "
        "and see that no clock is set while recording"
    )


def _bias_step(name: str, unit: str) -> Callable[..., str]:
    def message(seconds: float, uncertainty: float, size: float) -> str:
        return (
            f"the {name}'s bias changes by {size:.2g} {unit} at about {seconds:.0f} ± "
            f"{max(uncertainty, 1.0):.0f} s of the log: the sensor was reset, struck or is warming "
            "up; use a part on one side of it"
        )

    return message


_QUANTITIES: dict[str, tuple[float, str]] = {
    "rad": (math.degrees(1.0), "deg"),
    "m": (1e3, "mm"),
    "s": (1e3, "ms"),
    "s²": (1e6, "ms²"),
    "s/s": (1e6, "µs a second"),
    "1": (100.0, "%"),
    "m/(m/s²)": (1e3 * 9.80665, "mm for each g"),
}
"""Units of the table of unknowns, as people write them: factor and name; others stay."""
_REMEDIES: dict[str, str] = {
    "clock_drift": "synchronise the clocks",
    "gyro_delay": "give both sensors the same bandwidth, or expect the same delay in use",
    "accel_filter": "a filter in the driver; turn it off, or expect it in use",
    "gyro_filter": "a filter in the driver; turn it off, or expect it in use",
    "accel_scale": "calibrate the sensor, or scale its data",
    "gyro_scale": "calibrate the sensor, or scale its data",
    "gyro_misalignment": "the pose is the accelerometer's; calibrate the sensor's axes",
    "gravity_norm": "give --gravity if you know it",
    "gyro_g_sensitivity": "calibrate the sensor",
    "mount_give": "stiffen the mount",
    "joint_zero": "the arm's own calibration should say the same before the URDF is edited",
    "origin": "the arm's own calibration should say the same before the URDF is edited",
    "pose_scale": "calibrate the tracker",
}
_CURES: dict[str, str] = {
    "mount_give": "it hangs elsewhere in each pose; stiffen the mount, or record slower motion",
}
"""Where a value is larger than it can be; others are wrong units, ranges, axes or lengths."""


def _quantity(unit: str, label: str, value: float, std: float) -> str:
    factor, name = _QUANTITIES.get(unit, (1.0, unit))
    return f"{label} {with_std(value * factor, std * factor)} {name}".strip()


def _unknown_found(
    *,
    name: str,
    words: str,
    unit: str,
    labels: tuple[str, ...],
    values: tuple[float, ...],
    stds: tuple[float, ...],
    seconds: float,
    translation: float,
    rotation: float,
) -> str:
    if name == "clock_drift":
        gains = "gains" if values[0] > 0.0 else "loses"
        return (
            f"the IMU's clock {gains} {with_std(abs(values[0]) * 1e6, stds[0] * 1e6)} µs a second "
            f"{'on' if values[0] > 0.0 else 'against'} the robot's, "
            f"{abs(values[0]) * seconds * 1e3:.2g} ms over the log; corrected here: synchronise "
            "the clocks"
        )
    what = ", ".join(
        _quantity(unit, label, value, std)
        for label, value, std in zip(labels, values, stds, strict=True)
    )
    remedy = _REMEDIES.get(name, "")
    return (
        f"{words} {what}: corrected here, which moves the pose by {translation * 1e3:.2g} mm and "
        f"{math.degrees(rotation):.2g} deg{f'; {remedy}' if remedy else ''}"
    )


def _implausible(
    *,
    name: str,
    words: str,
    unit: str,
    label: str,
    value: float,
    std: float,
    limit: float,
    other: float | None = None,
) -> str:
    factor, unit_name = _QUANTITIES.get(unit, (1.0, unit))
    remedy = _CURES.get(name, "check units, ranges, axes and the URDF")
    if other is not None:
        remedy = f"not so by a window of {other:.2g} s (try --window), vibration may look like that"
    return (
        f"{words} {_quantity(unit, label, value, std)}, more than any sound robot or sensor has "
        f"({limit * factor:.3g} {unit_name}): {remedy}"
    )


def _still(joints: tuple[str, ...], translation: float, rotation: float) -> str:
    return (
        f"{', '.join(joints)} do not move in this log: their zeros and lengths cannot be told from "
        f"the mount, and put {translation * 1e3:.2g} mm and {math.degrees(rotation):.2g} deg into "
        "sigma; move them too, or say --robot exact or --robot DEG,MM"
    )


def _stated(option: str, unit: str, step: float, std: float) -> str:
    factor, name = _QUANTITIES.get(unit, (1.0, unit))
    return (
        f"the data contradict {option}: left free, it would be "
        f"{with_std(step * factor, std * factor)} {name} from what is stated; leave the option "
        "out, or measure again"
    )


def _untested(components: tuple[str, ...]) -> str:
    return (
        f"the log says nothing on {', '.join(components)} beyond what was told by --fix or "
        "--prior-std: it neither confirms nor contradicts it"
    )


Clauses = tuple[str, str]
"""What is wrong, and the remedy."""
_HOW: dict[str, str] = {
    "chain": "they come in the order of the chain, their names do not",
    "alphabet": "they come in alphabetical order, their names do not",
    "reverse": "they come in the reverse order of their names",
    "late": "they come one place late",
    "early": "they come one place early",
}
"""In what order positions come that do not belong to their names."""
_JOINT_STATES = "sensor_msgs/JointState is in {}: convert them in the publisher"
_UNITS: dict[str, Clauses] = {
    "joints": ("the joint positions of {} are in degrees", _JOINT_STATES.format("rad")),
    "sliding": (
        "the positions of sliding joints in {} are in millimetres",
        _JOINT_STATES.format("m"),
    ),
    "origins": ("the origins in the URDF are in millimetres", "URDF is in m: divide them by 1000"),
    "poses": (
        "the positions of {} are in millimetres",
        "ROS poses are in m: convert them in the publisher",
    ),
}
_MOST_LISTED = 3
"""Joints named in a sentence about their order."""

Detail = str | float | None
Tie = tuple[str, tuple[str, ...], tuple[float, ...], tuple[Detail, ...]]
"""Kind of a cause, names, sizes, and what else its words need."""


def _listed(names: tuple[str, ...]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else names[0]


def _of_link(names: tuple[str, ...], _: tuple[float, ...], told: str) -> Clauses:
    return (
        f"the IMU moves as {' or '.join(names)} does, not as {told}",
        (
            f"rerun with --parent {' or --parent '.join(names)}; if --parent was not given, "
            "correct also the frame_id or the URDF's joint that holds the IMU"
        ),
    )


def _of_sign(names: tuple[str, ...], _: tuple[float, ...]) -> Clauses:
    one = len(names) == 1
    return (
        (
            f"{'joint' if one else 'joints'} {_listed(names)} {'turns' if one else 'turn'} the "
            f"other way than the URDF says: {'its axis is' if one else 'their axes are'} of the "
            "wrong sign"
        ),
        "reverse <axis> in the URDF, or the sign of these positions in their publisher",
    )


def _of_order(names: tuple[str, ...], _: tuple[float, ...], topic: str, how: str) -> Clauses:
    why = f" ({_HOW[how]})" if how else ""
    what = (
        f"the positions of {_listed(names)} are exchanged in {topic}"
        if len(names) <= _MOST_LISTED
        else f"positions and names of the joints in {topic} do not belong together"
    )
    return what + why, "let the publisher list positions in the order of its names"


def _of_unit(_: tuple[str, ...], __: tuple[float, ...], of: str, topics: str) -> Clauses:
    what, remedy = _UNITS[of]
    return what.format(topics), remedy


def _of_inverse(names: tuple[str, ...], _: tuple[float, ...]) -> Clauses:
    return (
        f"the poses of {names[0]} are the wrong way round, of the parent in the child",
        "publish their inverse, or exchange the two frames' names",
    )


def _of_quaternion(names: tuple[str, ...], _: tuple[float, ...], order: str) -> Clauses:
    return (
        f"the quaternions of {names[0]} come in the order {order}",
        "ROS has x y z w: let the publisher reorder them",
    )


def _of_conjugate(names: tuple[str, ...], _: tuple[float, ...]) -> Clauses:
    return (
        f"the rotations of {names[0]} are inverted while the positions are not",
        "publish conjugate quaternions",
    )


def _of_zero(names: tuple[str, ...], sizes: tuple[float, ...]) -> Clauses:
    return (
        (
            f"joint {names[0]} stands {math.degrees(sizes[0]):+.4g} deg from where its position "
            "says (true angle less position)"
        ),
        "turn the joint's origin in the URDF by it, or correct the encoder's zero",
    )


def _of_offset(
    _: tuple[str, ...], sizes: tuple[float, ...], given: float | None, max_offset: float
) -> Clauses:
    late, size = "later" if sizes[0] > 0.0 else "earlier", abs(sizes[0])
    shown = f"{size:.3g} s" if size >= 1.0 else f"{size * 1e3:.3g} ms"
    what = f"the IMU's stamps are {shown} {late} than the robot's"
    if given is not None:
        return (
            f"{what}, not the {given:g} s that were given",
            "rerun without --time-offset, or give this one",
        )
    return (
        f"{what}, beyond the search of ±{max_offset:g} s",
        f"rerun with --max-offset {math.ceil(size * 1.1 + 0.5)}s",
    )


def _of_axes(
    _: tuple[str, ...], sizes: tuple[float, ...], form: str, which: str, order: str
) -> Clauses:
    remap = "mend the driver's axis mapping"
    if form == "left-handed":
        return (
            (
                "the IMU's axes are left-handed (both sensors fit a mirrored frame and no "
                "rotation): an axis has the wrong sign, or two are swapped"
            ),
            remap,
        )
    if form == "reversed":
        how = "point up at rest" if which == "accelerometer" else "be right-handed"
        return f"the {which}'s sign is reversed on all axes (should {how})", "negate its data"
    apart = (
        f"the gyroscope's x, y, z point along the accelerometer's {order}"
        if order
        else f"they are turned by {math.degrees(sizes[0]):.0f} deg against each other"
    )
    mirrored = f"; those of the {which} are left-handed" if which else ""
    return f"accelerometer and gyroscope do not share their axes: {apart}{mirrored}", remap


_CAUSES: dict[str, Callable[..., Clauses]] = {
    "link": _of_link,
    "sign": _of_sign,
    "order": _of_order,
    "unit": _of_unit,
    "inverse": _of_inverse,
    "quaternion": _of_quaternion,
    "conjugate": _of_conjugate,
    "zero": _of_zero,
    "offset": _of_offset,
    "axes": _of_axes,
}
"""Causes that one change of the model or of the readings explains."""


def _cause(
    *,
    ties: tuple[Tie, ...],
    rotation: tuple[float, float] | None,
    acceleration: tuple[float, float] | None,
    ratio: float,
    **_: Any,
) -> str:
    """A gross cause, what it leaves unexplained, those that explain as well, and what to do."""
    if all(tie[0] == "link" for tie in ties):
        names = tuple(name for tie in ties for name in tie[1])
        ties = (("link", names, (), ties[0][3]),)
        unsure = len(names) > 1
    else:
        unsure = len(ties) > 1
    told = [_CAUSES[kind](names, sizes, *detail) for kind, names, sizes, detail in ties]
    causes, remedies = ("; or ".join(dict.fromkeys(each)) for each in zip(*told, strict=True))
    which = ", the log cannot tell which" if unsure else ""
    left = _unexplained(rotation, acceleration, ratio)
    return f"{causes}{which} (that leaves {left}): {remedies}"


def _unexplained(
    rotation: tuple[float, float] | None, acceleration: tuple[float, float] | None, ratio: float
) -> str:
    """What is left over, before and after."""
    parts = [
        f"{_percent(share[1])} of the {what} instead of {_percent(share[0])}"
        for what, share in (("rotation", rotation), ("acceleration", acceleration))
        if share is not None
    ]
    return f"{' and '.join(parts)} unexplained" if parts else f"residuals {ratio:.2g} times smaller"


def _percent(share: float) -> str:
    """Two digits, never as a power of ten."""
    percent = 100.0 * share
    if percent < 0.1:
        return "less than 0.1 %"
    return f"{percent:.0f} %" if percent >= 10.0 else f"{percent:.2g} %"


def _publishers(names: tuple[str, ...], sizes: tuple[float, ...], what: str, kind: str) -> str:
    topic, size = names[0], sizes[0]
    told = f"the pose told by {what}" if kind != "joint" else f"the position of {what} in {topic}"
    by = {
        "joint": f"{size:.2g} rad (or m)",
        "position": f"{size * 1e3:.3g} mm",
        "rotation": f"about {math.degrees(2.0 * size):.2g} deg",
    }[kind]
    return (
        f"{told} jumps to and fro by {by} from message to message: two publishers tell it and "
        "contradict each other; stop one of them, and record again"
    )


def _base_moves(
    names: tuple[str, ...], turning: float | None, pushing: float | None, joints: bool
) -> str:
    seen = [] if turning is None else [f"turns at {math.degrees(turning):.2g} deg/s"]
    seen += [] if pushing is None else [f"is accelerated by {pushing:.2g} m/s²"]
    cause = (
        f"{names[0]} moves, the mount swings, or a joint on the way moves and the log does not "
        "say so; clamp it"
        if joints
        else f"{names[0]} moves, or the poses are held; mend that"
    )
    return (
        f"the IMU {' and '.join(seen)} (rms) while all that the log knows of stands still: "
        f"{cause}, or record its pose and name it with --pose-topic"
    )


def _unusual_bias(name: str, size: float) -> str:
    if name == "accel_bias":
        return (
            f"an accelerometer bias of {size:.2g} m/s² is unusual: a scale error, or another "
            "--gravity norm?"
        )
    return f"a gyroscope bias of {size:.2g} rad/s is unusual: is its unit right?"


FIT_MESSAGES: dict[str, str | Callable[..., Any]] = {
    "fit.rotation_unexplained": _rotation_unexplained,
    "fit.acceleration_unexplained": "the robot's motion and gravity leave {left:.2g} m/s² of the "
    "acceleration unexplained: are --gravity, the units and the parent link right?",
    "offset.at_edge": "the time offset may lie beyond the search of ±{max_offset:g} s: widen it "
    "with --max-offset",
    "offset.undetermined": "the motion does not determine the time offset; the value is a guess",
    "rotation.ambiguous": "another rotation fits almost as well: record motion about more than one "
    "axis",
    "residual.beyond_noise": _beyond_noise,
    "windows.motion_left_out": "windows with {share:.0%} of the motion do not fit the rest and "
    "were left out: frames, joint order or stamps may be wrong in parts of the log",
    "windows.left_out": _left_out,
    "windows.between_gaps": "only {share:.0%} of the time of both streams lies in filter windows, "
    "the rest is lost to gaps ({imu} in the IMU's stamps, {robot} in the robot's): record without "
    "losses, or choose a shorter --window",
    "window.dependent": _window,
    "change.mount": _mount_moved,
    "change.clock": _clock_step,
    "change.gyro_bias": _bias_step("gyroscope", "rad/s"),
    "change.accel_bias": _bias_step("accelerometer", "m/s²"),
    "unknown.found": _unknown_found,
    "unknown.implausible": _implausible,
    "robot.joints_still": _still,
    "prior.contradicted": _stated,
    "prior.untested": _untested,
    "imu.accel_sign_in_doubt": "gravity comes out far from down, and the motion does not tell "
    "whether world is mounted so or the accelerometer points down at rest: say --accel-sign up or "
    "down, or move the parent link along as well",
    "bias.unusual": _unusual_bias,
    "imu.accel_reversed": "the accelerometer points down at rest: its values fit the motion "
    "decisively better with their sign reversed, which was done (--accel-sign up keeps them)",
    "imu.samples_left_out": "IMU samples left out: {repeated} with repeated stamps, {not_finite} "
    "not finite, {astray} with stamps far from the log; stamps that went backwards: {backward}",
    "stamps.imu_ticks": lambda jitter: (
        f"IMU stamps jitter by {jitter * 1e3:.2g} ms about a constant rate; the constant rate fits "
        "the motion better and was used"
    ),
    "stamps.robot_ticks": "robot stamps jitter about a constant rate, which fits the motion better "
    "and was used",
    "stream.held_values": "{stream}: values are held for several messages; only changes were used, "
    "and the time offset contains the hold",
    "gravity.tilted": lambda tilt: (
        f"gravity is {math.degrees(tilt):.0f} deg off -z of the world: true for a base mounted so, "
        "else joint signs, frames or the accelerometer's sign are wrong"
    ),
    "paper.not_converged": "the solver did not converge: give a better --initial guess",
    "paper.undetermined": "the motion does not determine the pose: rotate about two axes at least",
    "paper.unexplained": "the solution leaves {force:.2g} m/s² and {rate:.2g} rad/s unexplained, "
    "another minimum perhaps: give a better --initial guess or use --method matched",
    "paper.gaps": "the method assumes a constant rate; the log has {count} gaps, each side of "
    "which was filtered alone: prefer --method matched",
    **{f"cause.{kind}": _cause for kind in _CAUSES},
    "cause.publishers": _publishers,
    "cause.base_moves": _base_moves,
}
