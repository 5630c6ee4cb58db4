"""The words of every finding: one table from code to template, or to a function of the values.

A message is one line in plain English: the cause, the numbers with their units, the remedy. It
begins with the file, topic or stream that it is about. ``±`` is one standard deviation.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from imucalib_cli.digits import figures, with_std
from imucalib_cli.messages_fit import FIT_MESSAGES

if TYPE_CHECKING:
    from collections.abc import Callable

_SENSORS = {"accel": ("accelerometer", "m/s²"), "gyro": ("gyroscope", "rad/s")}
_STAMPS = {"header": "header stamps", "log": "receive times"}
_SHOWN = 3
"""Of many stretches, those that are told with their times."""


def _stamps(words: str) -> Callable[..., str]:
    """Of a fault of a topic's stamps: the fault, then what becomes of it."""

    def message(
        topic: str,
        stamps: str,
        then: str = "",
        clock: str = "",
        other: str | None = None,
        **of: Any,
    ) -> str:
        fault = f"{_STAMPS[stamps]} of {topic} {words.format(**of)}"
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


def _bunched(stream: str, share: float, period: float, batch: int, lost: int) -> str:
    batches = f" of {batch}" if batch > 1 else ""
    missing = f", {lost} messages seem to be missing" if lost else ""
    return (
        f"{stream}: stamps come in bursts{batches} ({share:.0%} of the intervals are far shorter "
        f"than the {period * 1e3:.4g} ms between samples{missing}): they are times of arrival, "
        "and were replaced by even ticks; the time offset contains the unknown delay"
    )


def _axes(topic: str, sensor: str, axes: str, held: tuple[float, ...]) -> str:
    one = len(axes) == 1
    values = ", ".join(f"{value + 0.0:.4g}" for value in held)
    return (
        f"{topic}: {sensor} {'axis' if one else 'axes'} {' '.join(axes)} "
        f"{'says' if one else 'say'} {values} from first message to last"
    )


def _axes_dead(topic: str, sensor: str, axes: str, held: tuple[float, ...]) -> str:
    return (
        f"{_axes(topic, sensor, axes, held)} while the others vary: the sensor or its driver is "
        "broken there, and the pose cannot be found with it"
    )


def _axes_dead_in_motion(topic: str, sensor: str, axes: str, held: tuple[float, ...]) -> str:
    return (
        f"{_axes(topic, sensor, axes, held)}, and the robot turns otherwise: the sensor or its "
        "driver is broken there, or the IMU rides on another link"
    )


def _zero(topic: str, sensor: str, count: int) -> str:
    if sensor == "both":
        return (
            f"{topic}: gyro and accel are zero in all {count} messages: the driver does not fill "
            "them in, and nothing can be calibrated from it; turn it on in the driver, or choose "
            "another --imu-topic"
        )
    other = "accel" if sensor == "gyro" else "gyro"
    return (
        f"{topic}: {sensor} is zero in all {count} messages: the driver does not fill it in, and "
        f"{other} alone does not tell the pose; turn it on in the driver, or choose another "
        "--imu-topic"
    )


def _fault(
    *,
    topic: str,
    sensor: str,
    axes: str,
    kind: str,
    held: tuple[float, ...],
    samples: int,
    stretches: int,
    start: float,
    end: float,
) -> str:
    value = ", ".join(f"{x + 0.0:.5g}" for x in held)
    times = f" in {stretches} stretches" if stretches > 1 else ""
    return (
        f"{topic}: {sensor} {' '.join(axes)} is {kind} at {value} {_SENSORS[sensor][1]} in "
        f"{samples} samples{times} between {start:.2f} and {end:.2f} s of the log: they were left "
        "out"
    )


def _frozen(**values: Any) -> str:
    return f"{_fault(kind='frozen', **values)}; look for a driver that repeats its last message"


def _saturated(**values: Any) -> str:
    return f"{_fault(kind='saturated', **values)}; set a larger range or move more slowly"


def _held(streams: tuple[str, ...], stretches: tuple[tuple[float, float], ...]) -> str:
    shown = ", ".join(f"{start:.1f} to {end:.1f} s" for start, end in stretches[:_SHOWN])
    more = f" and {len(stretches) - _SHOWN} more" if len(stretches) > _SHOWN else ""
    return (
        f"{', '.join(streams)}: stands still from {shown}{more} while the IMU turns: frozen, or "
        "something else moves the robot; these stretches were left out"
    )


def _gyro_converted(topic: str, ratio: float, unit: str, factor: str, keep: str) -> str:
    return (
        f"{topic}: gyro reads {ratio:.3g} times the rate at which the robot turns: taken as {unit} "
        f"and multiplied by {factor} (--gyro-unit {keep} keeps it)"
    )


def _gyro_factor(topic: str, factor: float, std: float, known: tuple[str, ...]) -> str:
    return (
        f"{topic}: gyro reads {_factor(factor, std)} times the rate at which the robot turns, a "
        f"constant factor that belongs to no known unit ({', '.join(known)}): raw counts or a "
        "wrong scale of the gyroscope, or of the joint positions; correct it in the driver and "
        "record again"
    )


def _factor(value: float, std: float) -> str:
    return with_std(value, std) if std > 0.0 else figures(value, 6)


def _gyro_too_fast(topic: str, largest: float, ratio: float | None) -> str:
    told = "the robot's own motion cannot tell its unit"
    if ratio is not None:
        told = f"it is {ratio:.3g} times the robot's rate, where deg/s would be 57.3 times"
    return (
        f"{topic}: gyro reaches {largest:.3g}, more than any in rad/s, and {told}: if it is in "
        "deg/s rerun with --gyro-unit deg/s, else mend the driver and record again"
    )


def _missing(stream: str, missing: float, whole: float, start: float, end: float) -> str:
    return (
        f"{stream} is missing for {missing:.3g} of the {whole:.3g} s of the log, the longest time "
        f"from {start:.1f} to {end:.1f} s: what is there is used, and sigma is that of it"
    )


def _bias_beyond_sheet(sensor: str, bias: float, model: str, sigma: float) -> str:
    return (
        f"a {sensor} bias of {bias:.2g} {_SENSORS[sensor][1]} is far beyond what the data sheet "
        f"of {model} allows ({sigma:.2g}, 1 sigma): it was left free; another IMU than "
        "--imu-model says, another unit, or a damaged one"
    )


def _noise(sensor: str, measured: float) -> str:
    name, unit = _SENSORS[sensor]
    return f"the {name}'s noise is {measured:.2g} {unit} in a sample"


def _sheet(expected: float, model: str, rate: float) -> str:
    return f"{expected:.2g} by the data sheet of {model} at {rate:.4g} Hz"


def _noise_above(sensor: str, measured: float, expected: float, model: str, rate: float) -> str:
    return (
        f"{_noise(sensor, measured)}, {measured / expected:.2g} times the "
        f"{_sheet(expected, model, rate)}: the mount is loose or shakes, or this is another IMU; "
        "fasten or damp it, or correct --imu-model (the result goes by the noise found)"
    )


def _noise_below(sensor: str, measured: float, expected: float, model: str, rate: float) -> str:
    return (
        f"{_noise(sensor, measured)}, and should be {_sheet(expected, model, rate)}: a filter in "
        "the driver, a simulated log, or another IMU; if it is another, correct --imu-model"
    )


def _noise_filtered(sensor: str, measured: float, expected: float, model: str, rate: float) -> str:
    return (
        f"{_noise(sensor, measured)}, and should be {_sheet(expected, model, rate)}: a filter in "
        "the driver, for below its cut-off the noise is the sheet's; its delay is part of the "
        "time offset; if it is another, correct --imu-model"
    )


def _beyond_range(sensor: str, samples: int, full_scale: float, model: str) -> str:
    name, unit = _SENSORS[sensor]
    return (
        f"{samples} samples of the {name} are beyond the {full_scale:.4g} {unit} where {model} "
        "ends by its data sheet: glitches, another unit, or another IMU than --imu-model says"
    )


def _inverted(
    joint: str,
    inverse_distance: float,
    inverse_angle: float,
    distance: float,
    angle: float,
) -> str:
    where = f"joint {joint}" if joint else "the nominal pose"
    return (
        f"{where} seems to hold the pose of the parent in the IMU, where the pose of the IMU in "
        f"the parent belongs: inverted it is {inverse_distance * 1e3:.2g} mm and "
        f"{math.degrees(inverse_angle):.2g} deg off the pose found, as it stands "
        f"{distance * 1e3:.3g} mm and {math.degrees(angle):.3g} deg"
    )


def _tolerance(translation: float | None, rotation: float | None) -> str:
    asked = []
    if translation is not None:
        asked.append(f"{translation * 1e3:.6g} mm")
    if rotation is not None:
        asked.append(f"{math.degrees(rotation):.6g} deg")
    return " and ".join(asked)


def _require_no_sigma(translation: float | None, rotation: float | None, method: str) -> str:
    return (
        f"--require asks for {_tolerance(translation, rotation)}, and --method {method} states no "
        "sigma to show it: use --method matched"
    )


def _require_sigma(
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


def _apart_from(value: float, bound: float) -> str:
    """A number to as many figures as tell it from a bound."""
    candidates = (figures(value, count) for count in range(3, 12))
    return next((text for text in candidates if text != figures(bound, 11)), repr(value))


def _frames_far(camera_link: str, others: tuple[str, ...]) -> str:
    remedy = f" --camera-link takes another: {', '.join(others)}" if others else ""
    return (
        "the poses are farther apart than two calibrations of one mount are: is "
        f"{camera_link} the camera's optical frame (z forward, x right, y down)?{remedy}"
    )


def _rate_changes(stream: str, rates: tuple[float, ...], starts: tuple[float, ...]) -> str:
    parts = [f"{rates[0]:.4g} Hz at first"] + [
        f"{rate:.4g} Hz from {start:.1f} s"
        for rate, start in zip(rates[1 : 1 + _SHOWN], starts[1:], strict=False)
    ]
    more = f" and {len(rates) - 1 - _SHOWN} changes more" if len(rates) > 1 + _SHOWN else ""
    return (
        f"{stream}: the rate changes within the log ({', '.join(parts)}{more}): the stamps are "
        "used as they are; check the driver's setting if one rate was meant"
    )


MESSAGES: dict[str, str | Callable[..., str]] = {
    # As it is, for words may carry more than their letters.
    "text": lambda text: text,
    # The recording and its files.
    "log.cut_short": "{file}: the {what} is cut short or damaged at byte {byte} of {size}: what "
    "stands before is used",
    "log.bytes_damaged": "{file}: bytes {start} to {end} are damaged and left out",
    "log.chunk_unchecked": "{file}: a chunk at byte {byte} is damaged or cut short: its messages "
    "are used unchecked",
    "log.chunk_unreadable": "{file}: a chunk at byte {byte} is left out: {reason}",
    "log.chunk_checksum": "{file}: a chunk at byte {byte} is left out: its checksum is wrong",
    "log.chunk_partly_unpacked": "{file}: a chunk at byte {byte} is used as far as it can be "
    "unpacked",
    "log.chunk_damaged": "{file}: a chunk at byte {byte} is damaged inside: {lost} of its {size} "
    "bytes are left out",
    "log.chunk_messages_damaged": "{file}: {count} messages of the chunk at byte {byte} are "
    "damaged or cut short and left out",
    "log.record_unknown": "{file}: a record of the unknown kind {kind} at byte {byte} is left out",
    "log.unindexed": "{file}: the bag has no usable index and was scanned; nothing is lost",
    "log.part_missing": "{file}: {name} is named in metadata.yaml but is not there",
    "log.part_unusable": "{file}: left out: {reason}",
    "log.unpacks_too_large": "{file}: it unpacks to over {ratio} times its size, which no log does",
    "log.holds_too_much": "{file}: it holds more messages than bytes, or numbers of over {ratio} "
    "times its size, which no log does: what stands before is used",
    "log.compression_damaged": "{file}: its compression is damaged ({reason}): what stands before "
    "is used",
    "log.database_cut_short": "{file}: the database is cut short or damaged: what can be read is "
    "used",
    "log.database_companion": "{file}: {name} does not fit what is left of it and is left out",
    "log.database_wal": "{file}: its -wal is damaged or was cut off while it was written: {left} "
    "of its {total} pages are left out",
    "log.database_topic": "{file}: topic {number} is left out: its name or type is no text",
    "log.database_damaged": "{file}: the database is damaged ({reason}): what its pages hold is "
    "used",
    "log.more_losses": "{file}: and {count} further losses",
    "log.messages_missing": "{topic}: only {found} of the {listed} messages that the index counts "
    "are there",
    "log.messages_undecoded": "{topic}: {undecoded} of {messages} messages do not fit {type} and "
    "are left out",
    "log.files_overlap": "{first} and {second} overlap by {seconds:.3g} s: if they are two "
    "recordings, run on each alone",
    # What messages hold.
    "imu.frames_mixed": lambda topic, count, frame, others: (
        f"{topic}: {count} messages in other frames ({', '.join(map(repr, others))}) than "
        f"{frame!r} are left out"
    ),
    "imu.not_finite": "{topic}: {count} messages whose values are not finite or beyond {limit:g} "
    "are left out",
    "joints.named_twice": "{topic}: {count} messages that name a joint twice are left out",
    "joints.incomplete": "{topic}: {count} messages without one position for each joint are left "
    "out",
    "joints.not_finite": "{topic}: {count} messages whose positions are not finite or beyond "
    "{limit:g} are left out",
    "pose.unusable": "{topic}: {count} poses that are not finite or whose quaternion is not of "
    "unit norm are left out",
    "pose.told_twice": "{topic} tells the pose of {child} in {parent} too; {used} is used, having "
    "more messages",
    "stream.rows_left_out": "{stream}: left out {not_finite} messages that are not finite, "
    "{astray} with stamps far from the log and {repeated} with repeated stamps; stamps that went "
    "backwards: {backward}",
    "stream.leaps": "{stream}: {count} messages in which a value leaps away and back by more than "
    "{least:g} (rad or m) are left out: look after the encoder or its driver",
    "stream.missing": _missing,
    # Stamps and clocks.
    "stamps.all_zero": _stamps("are all zero"),
    "stamps.some_zero": _stamps("are zero in {count} of {total} messages"),
    "stamps.all_same": _stamps("are all the same"),
    "stamps.stand_still": _stamps("advance in only {count} of {total} steps"),
    "stamps.backwards": _stamps("run backwards in {count} of {total} steps"),
    "stamps.set_back": _stamps(
        "are set back by {seconds:.3g} s at message {number} and run through it again"
    ),
    "stamps.step": _stamps(
        "step by {milliseconds:+.0f} ms against the receive times near {when:.0f} s"
    ),
    "stamps.other_pace": _stamps(
        "advance at {rate:.3g} times the receive times, those of other topics at {others:.3g} times"
    ),
    "stamps.other_epoch": _stamps("lie {seconds:.4g} s apart from those of other topics"),
    "stamps.bunched": _bunched,
    "stamps.surplus": "{stream}: {share:.0%} of the intervals are far shorter than those between "
    "samples, and the motion says that those messages are no samples of an even rate: they are "
    "left out; look for a driver or a recorder that sends a buffer twice",
    "stamps.rate_changes": _rate_changes,
    # Units and readings of the IMU.
    "imu.accel_looks_like": "{topic}: |accel| at rest is {norm:.4g}, which looks like {unit}; "
    "sensor_msgs/Imu is in m/s²",
    "imu.accel_without_gravity": "{topic}: |accel| at rest is {norm:.3g}: gravity is absent or was "
    "removed (--gravity none)",
    "imu.accel_of_no_unit": "{topic}: |accel| at rest is {norm:.4g}, of no known unit",
    "imu.gyro_looks_like": "{topic}: the gyroscope reaches {largest:.4g}, which looks like {unit}; "
    "sensor_msgs/Imu is in rad/s",
    "imu.gyro_unit_converted": _gyro_converted,
    "imu.gyro_factor_unknown": _gyro_factor,
    "imu.gyro_too_fast": _gyro_too_fast,
    "imu.accel_unit_converted": "{topic}: accel at rest is {norm:.4g}: taken as {unit} and "
    "multiplied by {factor:.6g} (--accel-unit m/s2 keeps it)",
    "imu.accel_unit_contradicted": "{topic}: accel at rest is {norm:.4g}, which is gravity in "
    "{unit}, yet --accel-unit {stated} was given, which makes it {times:.3g} times gravity: leave "
    "the option out",
    "imu.gyro_unit_contradicted": "{topic}: gyro reads {ratio:.3g} times the rate at which the "
    "robot turns, which is {unit}, yet --gyro-unit {stated} was given, which would read "
    "{expected:.3g} times: leave the option out",
    "imu.accel_unit_unknown": "{topic}: accel at rest is {norm:.4g}, neither gravity nor a unit "
    "that is known: mend its scale, or say --accel-unit or --gravity",
    "imu.gravity_unasked": "{topic}: accel at rest is {norm:.4g}, which is gravity in {unit}, yet "
    "--gravity none was given",
    "imu.gravity_removed": "{topic}: accel at rest is {norm:.4g} m/s², so gravity is not in it: if "
    "the robot floats without gravity or the driver took gravity off, rerun with --gravity none",
    "imu.zero": _zero,
    "imu.impossible": "{topic}: {sensor} is beyond {limit:g} {unit} in {count} of {total} "
    "messages, which no IMU measures: mend the driver or the log's layout and record again",
    "imu.axes_dead": _axes_dead,
    "imu.axes_dead_in_motion": _axes_dead_in_motion,
    "imu.frozen": _frozen,
    "imu.saturated": _saturated,
    "imu.motion_left_out": "{share:.0%} of the rotation is in samples that were left out as frozen "
    "or saturated: record again with a sound sensor of larger range",
    "imu.bias_beyond_sheet": _bias_beyond_sheet,
    "imu.noise_above_sheet": _noise_above,
    "imu.noise_below_sheet": _noise_below,
    "imu.noise_filtered": _noise_filtered,
    "imu.beyond_range": _beyond_range,
    # The robot.
    "robot.held": _held,
    "robot.held_in_motion": "{share:.0%} of the IMU's rotation happened while the robot's stream "
    "stood still: record again with a publisher that runs throughout",
    "robot.static": "the robot does not move in this log",
    "nominal.inverted": _inverted,
    # What was asked of a result, and two results.
    "require.sigma": _require_sigma,
    "require.no_sigma": _require_no_sigma,
    "require.text": lambda text: text,
    "diff.same_log": "{first} and {second} were computed from the same log: their errors are not "
    "independent, so the sigma of their difference is not true",
    "compare.frames_far": _frames_far,
    **FIT_MESSAGES,
}
"""By code. Values are in SI units and radians unless their name says otherwise."""
