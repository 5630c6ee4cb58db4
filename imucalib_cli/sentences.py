"""The template language of messages.py, and the functions for what a template cannot say.

- ``{name}`` and ``{name:.3g}`` are as in Python.
- ``{name:mm.3g}`` is a value in m, shown as ``4.12 mm``; deg is of rad, ms and µs of s.
- ``{name:± other}`` is a value with its 1 sigma, which is the value ``other``, to the digits that
  sigma earns; ``{name:mm± other}`` is the same in mm, without sigma where that is missing.
- ``{name:in unit std}`` is a value with the unit and 1 sigma in these other values, in the unit
  that people use; ``{name:in unit}`` has no sigma.
- ``{name:fig3}`` is a number to three significant figures.
- ``{name:list}`` joins a tuple by commas, ``{name:list.4g}`` also formats its numbers; ``spaced``
  puts blanks between letters, ``quoted`` quotes each element.
- ``{name:sensor}`` and ``{name:unit}`` are a sensor's name and the unit of its readings,
  ``{name:stamps}`` the kind of stamps.
- ``{name:many}`` is a count, there only if it is more than one; ``some``: if it is not zero.
- ``{name:before other}`` is the last whole number surely below a value with the uncertainty
  ``other``; ``{name:after other}`` is the first surely above it.
- ``{name:/ other}`` is the ratio of two values; ``_FORMS`` and ``_OF_TWO`` hold further forms.
- ``[...]`` is a clause. It is left out where a value in it is missing; ``[...||...]`` then shows
  its second part.
- ``[name?...]`` needs a value that is neither missing nor zero, ``[name=text?...]`` one that is
  this text; ``[name=?...]`` needs it to be missing.

``±`` is one standard deviation.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any, Final

from imucalib_cli.digits import figures, with_std
from imucalib_cli.shown import listed

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

SENSORS = {"accel": ("accelerometer", "m/s²"), "gyro": ("gyroscope", "rad/s")}
_SCALES = {"mm": 1e3, "deg": math.degrees(1.0), "ms": 1e3, "µs": 1e6}
_SHOWN = 3
"""Stretches or changes listed with their times, of many."""


def _spans(stretches: tuple[tuple[float, float], ...]) -> str:
    return listed([f"{start:.1f} to {end:.1f} s" for start, end in stretches], _SHOWN)


def _rates(rates: tuple[float, ...], starts: tuple[float, ...]) -> str:
    pairs = zip(rates[1:], starts[1:], strict=False)
    later = [f"{rate:.4g} Hz from {start:.1f} s" for rate, start in pairs]
    return f"{rates[0]:.4g} Hz at first, {listed(later, _SHOWN, more=' and {} more changes')}"


def _apart_from(value: float, bound: float) -> str:
    """A number to as many figures as tell it from a bound."""
    candidates = (figures(value, count) for count in range(3, 12))
    return next((text for text in candidates if text != figures(bound, 11)), repr(value))


_FORMS: dict[str, Callable[[Any], str]] = {
    "sensor": lambda name: SENSORS[name][0],
    "unit": lambda name: SENSORS[name][1],
    "stamps": {"header": "header stamps", "log": "receive times"}.__getitem__,
    "other": {"header": "log", "log": "header", "gyro": "accel", "accel": "gyro"}.__getitem__,
    "spans": _spans,
    "times": lambda seconds: listed([f"{each:.1f} s" for each in seconds], _SHOWN),
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
    "sound": {"accelerometer": "point up at rest", "gyroscope": "be right-handed"}.__getitem__,
}
_CURES = {
    ("joint_filter", True): "a link with play in its bearing, which the encoder does not see, "
    "looks the same; tighten it",
    ("mount_give", False): "it bends under gravity, differently in each pose, or the base sways, "
    "which looks the same; stiffen mount and base, or record slower motion",
    ("mount_turn", False): "it turns under gravity, differently in each pose; stiffen it",
}
"""Of an error that is too large, by its name and whether it is negative."""
_OF_TWO: dict[str, Callable[[Any, Any], str]] = {
    "±": with_std,
    "apart": _apart_from,
    "rates": _rates,
    "/": lambda value, other: f"{value / other:.2g}",
    "cure": lambda name, negative: _CURES.get(
        (name, bool(negative)), "check units, ranges, axes and the URDF"
    ),
    "before": lambda value, std: str(max(math.floor(value - std), 0)),
    "after": lambda value, std: str(math.ceil(value + std)),
}
_VALUE = re.compile(r"\{(\w+)(?::([^{}]*))?\}")
_CLAUSE = re.compile(r"\[(?:(\w+)(=[^?\]]*)?\?)?([^\[\]]*)\]")
_QUANTITY = re.compile(r"(mm|deg|ms|µs)(?: ?(\W[^ ]*|apart))(?: (\w+))?")
_MISSING = (None, "", ())


def sentence(template: str, values: Mapping[str, Any]) -> str:
    """A template filled with values.

    Raises:
        KeyError, TypeError, ValueError: A value is missing or of another kind.
    """

    def clause(found: re.Match[str]) -> str:
        name, wanted, text = found.groups()
        full, _, other = text.partition("||")
        is_shown = all(_is_there(values.get(each), spec) for each, spec in _VALUE.findall(full))
        if wanted:
            held = values.get(name)
            is_shown = is_shown and ("" if held in _MISSING else str(held)) == wanted[1:]
        elif name:
            is_shown = is_shown and bool(values.get(name))
        return full if is_shown else other

    def value(found: re.Match[str]) -> str:
        return _shown(values[found[1]], found[2] or "", values)

    return _VALUE.sub(value, _CLAUSE.sub(clause, template))


def _duration(seconds: float) -> str:
    return f"{seconds:.3g} s" if seconds >= 1.0 else f"{seconds * 1e3:.3g} ms"


def _is_there(value: Any, spec: str) -> bool:
    if spec in {"many", "some"}:
        return bool(value > (spec == "many"))
    return value not in _MISSING


def _shown(value: Any, spec: str, values: Mapping[str, Any]) -> str:
    form, _, other = spec.partition(" ")
    if spec in _FORMS:
        text = _FORMS[spec](value)
    elif form in _OF_TWO:
        text = _OF_TWO[form](value, values[other])
    elif form == "in":
        unit, *std = other.split()
        text = _quantity(values[unit], value, *(values[each] for each in std))
    elif spec.startswith("list"):
        text = ", ".join(e if isinstance(e, str) else f"{e + 0.0:{spec[4:]}}" for e in value)
    elif spec.startswith("fig"):
        text = figures(value, int(spec[3:]))
    elif found := _QUANTITY.fullmatch(spec):
        unit, form, other = found.groups()
        scale = _SCALES[unit]
        if (second := values.get(other)) is not None:
            text = f"{_OF_TWO[form](value * scale, second * scale)} {unit}"
        else:
            text = f"{value * scale:{'.3g' if other else form}} {unit}"
    else:
        text = format(value, spec)
    return text


_QUANTITIES: dict[str, tuple[float, str]] = {
    "rad": (math.degrees(1.0), "deg"),
    "m": (1e3, "mm"),
    "s": (1e3, "ms"),
    "s²": (1e6, "ms²"),
    "s/s": (1e6, "µs a second"),
    "1": (100.0, "%"),
    "rad/(Nm/kg)": (math.degrees(9.80665), "deg for each m of lever"),
    "m/(m/s²)": (1e3 * 9.80665, "mm for each g"),
    "rad/(m/s²)": (math.degrees(9.80665), "deg for each g"),
}
"""Units of the table of unknowns as people write them: factor and name; other units stay."""
_OF_BASE: Final = "base_"
"""Prefix of unknowns of the base IMU that the other IMU has too."""
_SECOND_OPINION = "before you edit the URDF, check that the arm's own calibration agrees"
_REMEDIES: dict[str, str] = {
    "clock_drift": "synchronise the clocks",
    "gyro_delay": "give both sensors the same bandwidth, or expect the same delay in use",
    "accel_filter": "a filter in the driver; turn it off, or expect it in use",
    "gyro_filter": "a filter in the driver; turn it off, or expect it in use",
    "accel_scale": "calibrate the sensor, or scale its data",
    "gyro_scale": "calibrate the sensor, or scale its data",
    "accel_square": "calibrate the sensor",
    "accel_place": "the pose is that of their middle",
    "accel_skew": "calibrate the sensor's axes",
    "gyro_skew": "calibrate the sensor's axes",
    "gyro_misalignment": "the pose is the accelerometer's; calibrate the sensor's axes",
    "gravity_norm": "give --gravity if you know it",
    "gyro_g_sensitivity": "calibrate the sensor",
    "mount_give": "stiffen the mount",
    "mount_turn": "stiffen the mount",
    "joint_zero": _SECOND_OPINION,
    "origin": _SECOND_OPINION,
    "joint_axis": _SECOND_OPINION,
    "translation": "measure it on the robot before you edit the URDF",
    "rotation": "measure it on the robot before you edit the URDF",
    "pose_frame_place": "align the tracked frame with the robot's",
    "pose_frame_turn": "align the tracked frame with the robot's",
    "pose_scale": "calibrate the tracker",
    "pose_age": "stamp positions and attitude when they are measured",
    "pose_filter": "turn smoothing and prediction off in the tracker",
    "pose_turn": "take positions and attitude from one source, or align the two",
    "pose_delay": "stamp poses when they are measured",
}


def _quantity(unit: str, value: float, std: float | None = None) -> str:
    factor, name = _QUANTITIES.get(unit, (1.0, unit))
    size = value * factor
    return f"{f'{size:.3g}' if std is None else with_std(size, std * factor)} {name}"


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
    in_sigma: bool = False,
) -> str:
    """An unknown that is significant, and has been corrected."""
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
        f"{label} {_quantity(unit, value, std)}".strip()
        for label, value, std in zip(labels, values, stds, strict=True)
    )
    remedy = _REMEDIES.get(name, "")
    return (
        f"{words} {what}: corrected here, which moves the pose by {translation * 1e3:.2g} mm and "
        f"{math.degrees(rotation):.2g} deg{', which sigma includes' if in_sigma else ''}"
        f"{f'; it may also be the {like}, which looks the same' if like else ''}"
        f"{f'; {remedy}' if remedy else ''}"
    )


_UNEXPLAINED = " (…): "
_REMAP = "fix the driver's axis mapping"
_REORDER = "let the publisher list positions in the order of its names"
CAUSES: dict[str, str] = {
    "link": "the IMU moves like {any}[ (rigidly joined: {joined})], not like {nominal} (…): rerun "
    "with --parent {parents}; if --parent was not given, also correct the frame_id or the URDF's "
    "joint that holds the IMU",
    "sign": "joint {first} moves opposite to the URDF: its axis has the wrong sign "
    "(…): reverse <axis> in the URDF, or the sign of these positions in their publisher",
    "sign.several": "joints {all} move opposite to the URDF: their axes have the "
    "wrong sign (…): reverse <axis> in the URDF, or the sign of these positions in their "
    "publisher",
    "order": "the positions of {all} are exchanged in {topic}[ ({how:order})] (…): " + _REORDER,
    "order.many": "positions and names of the joints in {topic} do not belong together[ "
    "({how:order})] (…): " + _REORDER,
    "unit.joints": "the joint positions of {topics} are in degrees (…): sensor_msgs/JointState "
    "is in rad: convert them in the publisher",
    "unit.sliding": "the positions of sliding joints in {topics} are in millimetres (…): "
    "sensor_msgs/JointState is in m: convert them in the publisher",
    "unit.origins": "the origins in the URDF are in millimetres (…): URDF is in m: divide them "
    "by 1000",
    "unit.poses": "the positions of {topics} are in millimetres (…): ROS poses are in m: convert "
    "them in the publisher",
    "inverse": "the poses of {first} are inverted, of the parent in the child (…): "
    "publish their inverse, or exchange the two frames' names",
    "quaternion": "the quaternions of {first} come in the order {order} (…): ROS has x y z w: "
    "let the publisher reorder them",
    "conjugate": "the rotations of {first} are inverted while the positions are not (…): publish "
    "conjugate quaternions",
    "zero": "the zero of joint {first} is off by {size:deg+.4g}[ ± {std:deg.2g}] (true angle minus "
    "position) (…): turn the joint's origin in the URDF by it, or correct the encoder's zero",
    "offset": "the IMU's stamps are {size:later} than the robot's, beyond the search of "
    "±{max_offset:g} s (…): rerun with --max-offset {size:beyond}",
    "offset.given": "the IMU's stamps are {size:later} than the robot's, not the {given:g} s "
    "that were given (…): rerun without --time-offset, or give this one",
    "base_clock": "the stamps of the base IMU {first} are {size:later} than those of the joints "
    "(…): let one clock stamp both, or rerun with --clock log",
    "base_sign": "the accelerometer of the base IMU {first} points down at rest (should point "
    "up) (…): negate its data",
    "base_frame": "the base IMU {first} is turned by {size:deg.0f} from its frame in the URDF "
    "(…): correct the frame's rpy there, or its driver's axis mapping",
    "base_imu": "{base} moves but the log does not contain this motion, or the joint positions up "
    "to {link} are wrong: relative to {first} on {link} the motion is explained (…): rerun with "
    "--base-imu {first}, or record the base's pose and name it with --pose-topic",
    "axes.left-handed": "the IMU's axes are left-handed (both sensors fit a mirrored frame and "
    "no rotation): an axis has the wrong sign, or two are swapped (…): " + _REMAP,
    "axes.reversed": "the {which}'s sign is reversed on all axes (should {which:sound}) (…): "
    "negate its data",
    "axes": "accelerometer and gyroscope do not share their axes: [the gyroscope's x, y, z point "
    "along the accelerometer's {order}||they are turned by {size:deg.0f} against each other][; "
    "those of the {which} are left-handed] (…): " + _REMAP,
}
"""Causes that one change of the model or of the readings explains, and the remedy.

What remains unexplained is written at ``(…)``. Some kinds have further forms, after a dot.
"""
_DETAILS: dict[str, tuple[str, ...]] = {
    "link": ("nominal", "joined"),
    "order": ("topic", "how"),
    "unit": ("of", "topics"),
    "quaternion": ("order",),
    "offset": ("given", "max_offset"),
    "axes": ("form", "which", "order"),
    "zero": ("std",),
    "base_imu": ("link", "base"),
}
"""Further values for the words of a kind, in the order of a finding."""
_MOST_LISTED = 3
"""Joints named in a sentence about their order."""

Detail = str | float | None
Tie = tuple[str, tuple[str, ...], tuple[float, ...], tuple[Detail, ...]]
"""Kind of a cause, names, sizes, and the details of its kind."""


def _clauses(
    kind: str, names: tuple[str, ...], sizes: tuple[float, ...], *detail: Detail
) -> list[str]:
    # Links of older results have none that are joined to them, and zeros no sigma.
    strict = kind not in {"link", "zero"}
    values: dict[str, Any] = dict(zip(_DETAILS.get(kind, ()), detail, strict=strict))
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
    template = CAUSES.get(f"{kind}.{form}") or CAUSES[kind]
    return [sentence(each, values) for each in template.split(_UNEXPLAINED)]


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
    pairs = [_clauses(kind, names, sizes, *detail) for kind, names, sizes, detail in ties]
    causes, remedies = ("; or ".join(dict.fromkeys(each)) for each in zip(*pairs, strict=True))
    which = ", the log cannot tell which" if unsure else ""
    left = _unexplained(rotation, acceleration, ratio)
    return f"{causes}{which} (this leaves {left}): {remedies}"


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
    subject = f"the pose from {what}" if kind != "joint" else f"the position of {what} in {topic}"
    by = {
        "joint": f"{size:.2g} rad (or m)",
        "position": f"{size * 1e3:.3g} mm",
        "rotation": f"about {math.degrees(2.0 * size):.2g} deg",
    }[kind]
    return (
        f"{subject} jumps back and forth by {by} from message to message: two publishers send it "
        "and contradict each other; stop one of them, and record again"
    )


def unusual_bias(name: str, size: float, std: float | None = None, *, gravity: bool = True) -> str:
    """A bias that is larger than usual, with or without gravity in the equations."""
    error = "" if std is None else f" ± {std:.2g}"
    whose = " of the base IMU" if name.startswith(_OF_BASE) else ""
    if name.endswith("accel_bias"):
        return (
            f"an accelerometer bias{whose} of {size:.2g}{error} m/s² is unusual: a scale error"
            f"{', or another --gravity norm' if gravity else ''}?"
        )
    return f"a gyroscope bias{whose} of {size:.2g}{error} rad/s is unusual: is its unit right?"
