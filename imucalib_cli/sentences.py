"""How a finding becomes a sentence: the language of the templates in messages.py, and functions.

- ``{name}`` and ``{name:.3g}`` are those of Python.
- ``{name:mm.3g}`` is a value in m as ``4.12 mm``; likewise deg (of rad), ms and µs (of s).
- ``{name:± other}`` is a value with the 1 sigma that another value holds, to the digits it earns;
  ``{name:mm± other}`` the same in mm, as ``4.1 ± 0.2 mm``, without sigma where there is none.
- ``{name:list}`` joins a tuple by commas, ``{name:list.4g}`` its numbers; ``spaced`` puts blanks
  between letters, ``quoted`` quotes each of a tuple.
- ``{name:sensor}`` and ``{name:unit}`` are the sensor's name and the unit of its readings,
  ``{name:stamps}`` whose stamps are meant.
- ``{name:many}`` is a count that is there only if it is more than one, ``some`` if it is not zero.
- ``{name:before other}`` is the last whole number that is surely less, if the other value is its
  uncertainty, ``{name:after other}`` the first that is surely more.
- ``{name:/ other}`` is how many times another value it is; further forms stand in ``_FORMS``.
- ``[...]`` is left out where a value in it is not there; ``[...||...]`` then has its second part.

What takes more than that is a function of the values, below. ``±`` is one standard deviation.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any, Final

from imucalib_cli.digits import figures, with_std

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

SENSORS = {"accel": ("accelerometer", "m/s²"), "gyro": ("gyroscope", "rad/s")}
STAMPS = {"header": "header stamps", "log": "receive times"}
_SCALES = {"mm": 1e3, "deg": math.degrees(1.0), "ms": 1e3, "µs": 1e6}
_FORMS: dict[str, Callable[[Any], str]] = {
    "sensor": lambda name: SENSORS[name][0],
    "unit": lambda name: SENSORS[name][1],
    "stamps": STAMPS.__getitem__,
    "spaced": " ".join,
    "quoted": lambda names: ", ".join(map(repr, [names] if isinstance(names, str) else names)),
    "many": str,
    "some": str,
    "whole": lambda seconds: f"{max(seconds, 1.0):.0f}",
    "later": lambda seconds: f"{_duration(abs(seconds))} {'later' if seconds > 0 else 'earlier'}",
    "beyond": lambda seconds: f"{math.ceil(abs(seconds) * 1.1 + 0.5)}s",
    "order": {
        "chain": "they come in the order of the chain, their names do not",
        "alphabet": "they come in alphabetical order, their names do not",
        "reverse": "they come in the reverse order of their names",
        "late": "they come one place late",
        "early": "they come one place early",
    }.__getitem__,
    "sound": {
        "accelerometer": "point up at rest",
        "gyroscope": "be right-handed",
    }.__getitem__,
}
_OF_TWO: dict[str, Callable[[float, float], str]] = {
    "±": with_std,
    "/": lambda value, other: f"{value / other:.2g}",
    "before": lambda value, std: str(max(math.floor(value - std), 0)),
    "after": lambda value, std: str(math.ceil(value + std)),
}
_VALUE = re.compile(r"\{(\w+)(?::([^{}]*))?\}")
_CLAUSE = re.compile(r"\[([^\[\]]*)\]")
_QUANTITY = re.compile(r"(mm|deg|ms|µs)(\W.*)")


def sentence(template: str, values: Mapping[str, Any]) -> str:
    """A template filled with values.

    Raises:
        KeyError, TypeError, ValueError: A value is missing or of another kind.
    """

    def clause(found: re.Match[str]) -> str:
        full, _, other = found[1].partition("||")
        needed = _VALUE.findall(full)
        return full if all(_is_there(values.get(name), spec) for name, spec in needed) else other

    def value(found: re.Match[str]) -> str:
        return _shown(values[found[1]], found[2] or "", values)

    return _VALUE.sub(value, _CLAUSE.sub(clause, template))


def _duration(seconds: float) -> str:
    return f"{seconds:.3g} s" if seconds >= 1.0 else f"{seconds * 1e3:.3g} ms"


def _is_there(value: Any, spec: str) -> bool:
    if spec in {"many", "some"}:
        return bool(value > (spec == "many"))
    return value not in (None, "", ())


def _shown(value: Any, spec: str, values: Mapping[str, Any]) -> str:
    if spec in _FORMS:
        return _FORMS[spec](value)
    form, _, other = spec.partition(" ")
    if other and form in _OF_TWO:
        return _OF_TWO[form](value, values[other])
    if spec.startswith("list"):
        shown = (each if isinstance(each, str) else f"{each + 0.0:{spec[4:]}}" for each in value)
        return ", ".join(shown)
    if quantity := _QUANTITY.fullmatch(spec):
        unit, form = quantity.groups()
        scale, std = _SCALES[unit], None
        if form.startswith("± "):
            std, form = values.get(form[2:]), ".3g"
        size = value * scale
        return f"{format(size, form) if std is None else with_std(size, std * scale)} {unit}"
    return format(value, spec)


_SHOWN = 3
"""Of many stretches, those that are told with their times."""


def stamps(words: str) -> Callable[..., str]:
    """Of a fault of a topic's stamps: the fault, then what becomes of it."""

    def message(
        topic: str,
        stamps: str,
        then: str = "",
        clock: str = "",
        other: str | None = None,
        **of: Any,
    ) -> str:
        fault = f"{STAMPS[stamps]} of {topic} {words.format(**of)}"
        match then:
            case "receive times":
                return f"{fault}: receive times are used for all topics (--clock log)"
            case "no better":
                return f"{fault}, and receive times are no better: {other}"
            case "asked":
                advice = f"try --clock {'log' if clock == 'header' else 'header'}"
                if other is not None:
                    advice = f"and {other}"
                return f"{fault}, yet --clock {clock} was asked for: {advice}"
            case _:
                return fault

    return message


def rate_changes(stream: str, rates: tuple[float, ...], starts: tuple[float, ...]) -> str:
    """At which times a stream's rate changes."""
    parts = [f"{rates[0]:.4g} Hz at first"] + [
        f"{rate:.4g} Hz from {start:.1f} s"
        for rate, start in zip(rates[1 : 1 + _SHOWN], starts[1:], strict=False)
    ]
    more = f" and {len(rates) - 1 - _SHOWN} changes more" if len(rates) > 1 + _SHOWN else ""
    return (
        f"{stream}: the rate changes within the log ({', '.join(parts)}{more}): the stamps are "
        "used as they are; check the driver's setting if one rate was meant"
    )


def gyro_factor(topic: str, factor: float, std: float, known: tuple[str, ...]) -> str:
    """A gyroscope that reads a constant factor of no unit."""
    return (
        f"{topic}: gyro reads {_factor(factor, std)} times the rate at which the robot turns, a "
        f"constant factor that belongs to no known unit ({', '.join(known)}): raw counts or a "
        "wrong scale of the gyroscope, or of the joint positions; correct it in the driver and "
        "record again"
    )


def _factor(value: float, std: float) -> str:
    return with_std(value, std) if std > 0.0 else figures(value, 6)


def zero(
    topic: str, sensor: str, count: int, reads: str = "zero", option: str = "--imu-topic"
) -> str:
    """Readings that are all zero, or all NaN."""
    if sensor == "both":
        return (
            f"{topic}: gyro and accel are {reads} in all {count} messages: the driver does not "
            "fill them in, and nothing can be calibrated from it; turn it on in the driver, or "
            f"choose another {option}"
        )
    other = "accel" if sensor == "gyro" else "gyro"
    return (
        f"{topic}: {sensor} is {reads} in all {count} messages: the driver does not fill it in, "
        f"and {other} alone does not tell the pose; turn it on in the driver, choose another "
        f"{option}, or, if another topic has it, name both by --gyro-topic and --accel-topic"
    )


def incomplete(topic: str, count: int, total: int, named: int, positions: int) -> str:
    """Joint states without one position for each joint."""
    remedy = "; say which joints they are by --joints" if positions else ""
    held, joints = (
        f"{number or 'no'} {word}{'' if number == 1 else 's'}"
        for number, word in ((positions, "position"), (named, "joint"))
    )
    return (
        f"{topic}: {count} of {total} messages are left out, as they have {held} for {joints} by "
        f"name{remedy}"
    )


def held(streams: tuple[str, ...], stretches: tuple[tuple[float, float], ...]) -> str:
    """When a robot's stream stands still although it moves."""
    shown = ", ".join(f"{start:.1f} to {end:.1f} s" for start, end in stretches[:_SHOWN])
    more = f" and {len(stretches) - _SHOWN} more" if len(stretches) > _SHOWN else ""
    return (
        f"{', '.join(streams)}: stands still from {shown}{more} while the IMU turns: frozen, or "
        "something else moves the robot; these stretches were left out"
    )


def require_sigma(
    *,
    parent: str,
    remedy: str,
    longer: float | None = None,
    translation: float | None = None,
    translation_sigma: float | None = None,
    translation_axis: str = "",
    rotation: float | None = None,
    rotation_sigma: float | None = None,
    rotation_axis: str = "",
) -> str:
    """Which sigma is larger than was asked for, and what would help."""
    said = []
    for bound, sigma, axis, scale, unit, where in (
        (translation, translation_sigma, translation_axis, 1e3, "mm", "along"),
        (rotation, rotation_sigma, rotation_axis, math.degrees(1.0), "deg", "about"),
    ):
        if bound is not None and sigma is not None:
            said.append(
                f"{bound * scale:.6g} {unit}, the largest sigma is "
                f"{_apart_from(sigma * scale, bound * scale)} {unit} {where} {axis} of {parent}"
            )
    advice = {
        "motion": "record the motion that determines it",
        "model": "the robot model or the mount, not noise, sets it, so correct the URDF's lengths "
        "and joint zeros or tighten the mount; more of the same motion will not help",
        "longer": f"record about {figures(longer or math.nan, 2)} times as long (sigma falls with "
        "the root of the duration), or livelier motion",
        "livelier": "record livelier motion (faster turns about several axes) and more of it",
    }[remedy]
    return f"--require asks for {'; and for '.join(said)}: {advice}"


def require_no_sigma(translation: float | None, rotation: float | None, method: str) -> str:
    """A requirement that a method without sigma cannot meet."""
    return (
        f"--require asks for {_tolerance(translation, rotation)}, and --method {method} states no "
        "sigma to show it: use --method matched"
    )


def _tolerance(translation: float | None, rotation: float | None) -> str:
    asked = []
    if translation is not None:
        asked.append(f"{translation * 1e3:.6g} mm")
    if rotation is not None:
        asked.append(f"{math.degrees(rotation):.6g} deg")
    return " and ".join(asked)


def _apart_from(value: float, bound: float) -> str:
    """A number to as many figures as tell it from a bound."""
    candidates = (figures(value, count) for count in range(3, 12))
    return next((text for text in candidates if text != figures(bound, 11)), repr(value))


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
_OF_BASE: Final = "base_"
"""Before the name of an unknown of the base IMU, where the other IMU has the same."""
_REMEDIES: dict[str, str] = {
    "clock_drift": "synchronise the clocks",
    "gyro_delay": "give both sensors the same bandwidth, or expect the same delay in use",
    "accel_filter": "a filter in the driver; turn it off, or expect it in use",
    "gyro_filter": "a filter in the driver; turn it off, or expect it in use",
    "accel_scale": "calibrate the sensor, or scale its data",
    "gyro_scale": "calibrate the sensor, or scale its data",
    "accel_skew": "calibrate the sensor's axes",
    "gyro_skew": "calibrate the sensor's axes",
    "gyro_misalignment": "the pose is the accelerometer's; calibrate the sensor's axes",
    "gravity_norm": "give --gravity if you know it",
    "gyro_g_sensitivity": "calibrate the sensor",
    "mount_give": "stiffen the mount",
    "joint_zero": "the arm's own calibration should say the same before the URDF is edited",
    "origin": "the arm's own calibration should say the same before the URDF is edited",
    "translation": "measure it on the robot before the URDF is edited",
    "rotation": "measure it on the robot before the URDF is edited",
    "pose_scale": "calibrate the tracker",
}
_CURES: dict[str, str] = {
    "mount_give": "it hangs elsewhere in each pose; stiffen the mount, or record slower motion",
}
"""Where a value is larger than it can be; others are wrong units, ranges, axes or lengths."""


def _quantity(unit: str, label: str, value: float, std: float) -> str:
    factor, name = _QUANTITIES.get(unit, (1.0, unit))
    return f"{label} {with_std(value * factor, std * factor)} {name}".strip()


def unknown_found(
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
    like: str = "",
) -> str:
    """An unknown that stands clear of its sigma."""
    of_base, name = name.startswith(_OF_BASE), name.removeprefix(_OF_BASE)
    if name == "clock_drift":
        gain = with_std(abs(values[0]) * 1e6, stds[0] * 1e6)
        ahead, over = ("gains", "on") if values[0] > 0.0 else ("loses", "against")
        return (
            f"the {'base ' if of_base else ''}IMU's clock {ahead} {gain} µs a second {over} the "
            f"robot's, {abs(values[0]) * seconds * 1e3:.2g} ms over the log; corrected here: "
            "synchronise the clocks"
        )
    what = ", ".join(
        _quantity(unit, label, value, std)
        for label, value, std in zip(labels, values, stds, strict=True)
    )
    remedy = _REMEDIES.get(name, "")
    return (
        f"{words} {what}: corrected here, which moves the pose by {translation * 1e3:.2g} mm and "
        f"{math.degrees(rotation):.2g} deg"
        f"{f'; it may as well be the {like}, which looks the same' if like else ''}"
        f"{f'; {remedy}' if remedy else ''}"
    )


def implausible(
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
    """An unknown that is larger than it can be."""
    factor, unit_name = _QUANTITIES.get(unit, (1.0, unit))
    remedy = _CURES.get(name, "check units, ranges, axes and the URDF")
    if other is not None:
        remedy = f"not so by a window of {other:.2g} s (try --window), vibration may look like that"
    return (
        f"{words} {_quantity(unit, label, value, std)}, more than any sound robot or sensor has "
        f"({limit * factor:.3g} {unit_name}): {remedy}"
    )


def stated(option: str, unit: str, step: float, std: float) -> str:
    """Something stated that the data contradict."""
    factor, name = _QUANTITIES.get(unit, (1.0, unit))
    return (
        f"the data contradict {option}: left free, it would be "
        f"{with_std(step * factor, std * factor)} {name} from what is stated; leave the option "
        "out, or measure again"
    )


_REMAP = "mend the driver's axis mapping"
_REORDER = "let the publisher list positions in the order of its names"
_JOINT_STATES = "sensor_msgs/JointState is in {}: convert them in the publisher"
CAUSES: dict[str, tuple[str, str]] = {
    "link": (
        "the IMU moves as {any} does[ (rigidly joined: {joined})], not as {told}",
        (
            "rerun with --parent {parents}; if --parent was not given, correct also the frame_id "
            "or the URDF's joint that holds the IMU"
        ),
    ),
    "sign": (
        "joint {first} turns the other way than the URDF says: its axis is of the wrong sign",
        "reverse <axis> in the URDF, or the sign of these positions in their publisher",
    ),
    "sign.several": (
        "joints {all} turn the other way than the URDF says: their axes are of the wrong sign",
        "reverse <axis> in the URDF, or the sign of these positions in their publisher",
    ),
    "order": ("the positions of {all} are exchanged in {topic}[ ({how:order})]", _REORDER),
    "order.many": (
        "positions and names of the joints in {topic} do not belong together[ ({how:order})]",
        _REORDER,
    ),
    "unit.joints": ("the joint positions of {topics} are in degrees", _JOINT_STATES.format("rad")),
    "unit.sliding": (
        "the positions of sliding joints in {topics} are in millimetres",
        _JOINT_STATES.format("m"),
    ),
    "unit.origins": (
        "the origins in the URDF are in millimetres",
        "URDF is in m: divide them by 1000",
    ),
    "unit.poses": (
        "the positions of {topics} are in millimetres",
        "ROS poses are in m: convert them in the publisher",
    ),
    "inverse": (
        "the poses of {first} are the wrong way round, of the parent in the child",
        "publish their inverse, or exchange the two frames' names",
    ),
    "quaternion": (
        "the quaternions of {first} come in the order {order}",
        "ROS has x y z w: let the publisher reorder them",
    ),
    "conjugate": (
        "the rotations of {first} are inverted while the positions are not",
        "publish conjugate quaternions",
    ),
    "zero": (
        (
            "joint {first} stands {size:deg+.4g} from where its position says (true angle less "
            "position)"
        ),
        "turn the joint's origin in the URDF by it, or correct the encoder's zero",
    ),
    "offset": (
        (
            "the IMU's stamps are {size:later} than the robot's, beyond the search of "
            "±{max_offset:g} s"
        ),
        "rerun with --max-offset {size:beyond}",
    ),
    "offset.given": (
        "the IMU's stamps are {size:later} than the robot's, not the {given:g} s that were given",
        "rerun without --time-offset, or give this one",
    ),
    "base_clock": (
        "the stamps of the base IMU {first} are {size:later} than those of the joints",
        "let one clock stamp both, or rerun with --clock log",
    ),
    "base_sign": (
        "the accelerometer of the base IMU {first} points down at rest (should point up)",
        "negate its data",
    ),
    "base_frame": (
        "the base IMU {first} is turned by {size:deg.0f} from its frame in the URDF",
        "correct the frame's rpy there, or its driver's axis mapping",
    ),
    "base_imu": (
        (
            "{base} moves though the log does not say so, or what it says of the joints up to "
            "{link} is wrong: against {first} on {link} the motion is explained"
        ),
        "rerun with --base-imu {first}, or record the base's pose and name it with --pose-topic",
    ),
    "axes.left-handed": (
        (
            "the IMU's axes are left-handed (both sensors fit a mirrored frame and no rotation): "
            "an axis has the wrong sign, or two are swapped"
        ),
        _REMAP,
    ),
    "axes.reversed": (
        "the {which}'s sign is reversed on all axes (should {which:sound})",
        "negate its data",
    ),
    "axes": (
        (
            "accelerometer and gyroscope do not share their axes: [the gyroscope's x, y, z point "
            "along the accelerometer's {order}||they are turned by {size:deg.0f} against each "
            "other]"
            "[; those of the {which} are left-handed]"
        ),
        _REMAP,
    ),
}
"""Causes that one change of the model or of the readings explains: what is wrong, and the remedy.

A kind has further forms behind a dot.
"""
_DETAILS: dict[str, tuple[str, ...]] = {
    "link": ("told", "joined"),
    "order": ("topic", "how"),
    "unit": ("of", "topics"),
    "quaternion": ("order",),
    "offset": ("given", "max_offset"),
    "axes": ("form", "which", "order"),
    "base_imu": ("link", "base"),
}
"""What else the words of a kind need, in the order in which a finding has it."""
_MOST_LISTED = 3
"""Joints named in a sentence about their order."""

Detail = str | float | None
Tie = tuple[str, tuple[str, ...], tuple[float, ...], tuple[Detail, ...]]
"""Kind of a cause, names, sizes, and the details of its kind."""


def _clauses(
    kind: str, names: tuple[str, ...], sizes: tuple[float, ...], *detail: Detail
) -> list[str]:
    # links of older results have none that are joined to them
    values: dict[str, Any] = dict(zip(_DETAILS.get(kind, ()), detail, strict=kind != "link"))
    values |= {
        "first": names[0] if names else "",
        "all": " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:]))),
        "any": " or ".join(names),
        "parents": " or --parent ".join(names),
        "size": sizes[0] if sizes else 0.0,
    }
    form = {
        "sign": "several" if len(names) > 1 else "",
        "order": "many" if len(names) > _MOST_LISTED else "",
        "unit": values.get("of"),
        "offset": "" if values.get("given") is None else "given",
        "axes": values.get("form"),
    }.get(kind)
    templates = CAUSES.get(f"{kind}.{form}") or CAUSES[kind]
    return [sentence(template, values) for template in templates]


def cause(
    *,
    ties: tuple[Tie, ...],
    rotation: tuple[float, float] | None,
    acceleration: tuple[float, float] | None,
    ratio: float,
    **_: Any,
) -> str:
    """One cause that explains a poor fit, what it leaves unexplained, and what to do."""
    if all(tie[0] == "link" for tie in ties):
        names = tuple(name for tie in ties for name in tie[1])
        detail = ties[0][3] if len(ties) == 1 else ties[0][3][:1]
        ties = (("link", names, (), detail),)
        unsure = len(names) > 1
    else:
        unsure = len(ties) > 1
    told = [_clauses(kind, names, sizes, *detail) for kind, names, sizes, detail in ties]
    causes, remedies = ("; or ".join(dict.fromkeys(each)) for each in zip(*told, strict=True))
    which = ", the log cannot tell which" if unsure else ""
    left = _unexplained(rotation, acceleration, ratio)
    return f"{causes}{which} (that leaves {left}): {remedies}"


def _unexplained(
    rotation: tuple[float, float] | None, acceleration: tuple[float, float] | None, ratio: float
) -> str:
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


def publishers(names: tuple[str, ...], sizes: tuple[float, ...], what: str, kind: str) -> str:
    """Two publishers of one position."""
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


def base_moves(
    names: tuple[str, ...], turning: float | None, pushing: float | None, joints: bool
) -> str:
    """An IMU that moves while the robot stands still."""
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


def unusual_bias(name: str, size: float) -> str:
    """A bias that is larger than usual."""
    whose = " of the base IMU" if name.startswith(_OF_BASE) else ""
    if name.endswith("accel_bias"):
        return (
            f"an accelerometer bias{whose} of {size:.2g} m/s² is unusual: a scale error, or "
            "another --gravity norm?"
        )
    return f"a gyroscope bias{whose} of {size:.2g} rad/s is unusual: is its unit right?"
