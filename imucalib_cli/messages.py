"""The words of every finding: a table from its code to a template of sentences.py or a function.

A message is one line in plain English: the cause, the numbers with their units, the remedy. It
begins with its file, topic or stream. ``±`` is one standard deviation.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucalib_cli.sentences import CAUSES, cause, publishers, unknown_found, unusual_bias

if TYPE_CHECKING:
    from collections.abc import Callable

    Messages = dict[str, str | Callable[..., str]]

_TO = "--to {seconds:before uncertainty}"
_FROM = "--from {seconds:after uncertainty}"
_ONE_SIDE = (
    "[only=?use a part on one side of it (" + _TO + " or " + _FROM + ")]"
    "[only=before?use the part before it (" + _TO + ")]"
    "[only=after?use the part after it (" + _FROM + ")]"
    "[only=none?record again]"
)
_AT = " at about {seconds:.0f} ± {uncertainty:whole} s of the log: "
_RESET = "the sensor was reset, struck or is warming up; " + _ONE_SIDE
_NOISE = "the {sensor:sensor}'s noise is {measured:.2g} {sensor:unit} in a sample, "
_FILTERED = (
    _NOISE + "and should be {expected:.2g} by the data sheet of {model} at {rate:.4g} Hz: the "
    "driver filters it"
)
_STAMPS = "{stamps:stamps} of {topic} "
_THEN = (
    "[then=receive times?: receive times are used for all topics (--clock log)]"
    "[then=no better?, and receive times are no better: {other}]"
    "[then=asked?, yet --clock {clock} was asked for: ][then=asked?and {other}]"
    "[other=?try --clock {clock:other}]"
)
_JUMPS = (
    "jumps by {turn:deg.3g} and {shift:mm.3g} from one sample to the next, which is physically "
    "impossible"
)
_MARKERS = "; place the markers so that they are not symmetric"
_TRANSLATION = (
    "{translation:mm.6g}, the largest sigma is {translation_sigma:mm apart translation} along "
    "{translation_axis} of {parent}"
)
_ROTATION = (
    "{rotation:deg.6g}, the largest sigma is {rotation_sigma:deg apart rotation} about "
    "{rotation_axis} of {parent}"
)
# Codes with a meaning for decisions, in sections; the sets of each meaning are below them.
_UNSPECIFIC: Messages = {
    "fit.unsettled": "the solution does not settle: it still changes from step to step, which "
    "happens if the model does not fit: check parent link, units and stamps, "
    "[longest=?choose a longer --window, ]or use another part of the log (--from, --to)",
    "fit.rotation_unexplained": "the robot's motion does not explain the gyroscope ({share:.0%} "
    "of the rotation remains unexplained): [beyond?is the gyroscope's unit right "
    "(--gyro-unit), and ]"
    "[tracked?are these poses of the IMU's parent, with quaternions x y z w and right stamps]"
    "[tracked=?is this the right parent link, URDF and joint topic][, "
    "or do the clocks differ by more than {max_offset:g} s (--max-offset)]?",
    "fit.acceleration_unexplained": "the robot's motion and gravity leave {left:.2g} m/s² of the "
    "acceleration unexplained: are --gravity, the units and the parent link right?",
    "offset.at_edge": "the time offset may lie beyond the search of ±{max_offset:g} s: widen it "
    "with --max-offset",
    "rotation.ambiguous": "another rotation fits almost as well: record motion about more than one "
    "axis",
    "residual.beyond_noise": "the residuals of the {sensor:sensor} are {ratio:.2g} times the "
    "noise of sensor and [tracked?poses: usually the tracker's own errors, above all of rotation; "
    "else the mount is not rigid, or frames, stamps or units are wrong]"
    "[tracked=?encoders: the mount or a link is not rigid, or kinematics, stamps or units are "
    "wrong]",
    "windows.motion_left_out": "windows with {share:.0%} of the motion do not fit the rest and "
    "were left out: [tracked?the tracker, its frames or stamps][tracked=?frames, joint order or "
    "stamps] may be wrong in parts of the log",
    "window.dependent": "the result depends on the filter window: with {seconds:.2g} s instead of "
    "{used:.2g} s the pose differs by {translation:mm.2g} and {rotation:deg.2g}, {sigmas:.2g} "
    "sigma: the model does not explain this; a flexible mount[tracked=? or joint], for example, "
    "would; sigma includes the difference",
    "parts.disagree": "parts of the log disagree {factor:.2g} times more than noise and model "
    "explain: an error that is not in the model changes within the log, such as a tracker's "
    "from place to place[tracked=? or a joint's as it warms]; sigma is larger by this factor",
    "change.mount": "before and after about {seconds:.0f} ± {uncertainty:whole} s of the log the "
    "IMU's pose differs by {translation:mm± translation_std} and {rotation:deg± rotation_std}, "
    "beyond what noise and model explain: the mount moved, or the log joins two set-ups; "
    "[only=?calibrate each part alone (" + _TO + ", " + _FROM + ")]"
    "[only=before?calibrate the part before alone (" + _TO + "), the other is too short]"
    "[only=after?calibrate the part after alone (" + _FROM + "), the other is too short]"
    "[only=none?record again, each part is too short]",
    "change.drift": "over the log the IMU's pose drifts by {translation:mm± translation_std} and "
    "{rotation:deg± rotation_std}, beyond what noise and model explain: the mount is loose, or "
    "the robot warms up; warm it up before recording, or use a shorter part (--from, --to)",
    "change.clock": "the clocks of IMU and robot shift by {size:ms± std} against each other"
    + _AT
    + _ONE_SIDE
    + ", and see that no clock is set while recording",
    "change.gyro_bias": "the gyroscope's bias changes by [std?{size:± std}||{size:.2g}] rad/s"
    + _AT
    + _RESET,
    "change.accel_bias": "the accelerometer's bias changes by [std?{size:± std}||{size:.2g}] m/s²"
    + _AT
    + _RESET,
}
_UNSPECIFIC_OF_ANSWER: Messages = {
    "unknown.implausible": "{words} [{label} ]{value:in unit std}, more than any sound robot or "
    "sensor has ({limit:in unit}): [other?a {other:.2g} s window does not confirm it "
    "(try --window); vibration can cause it][other=?{name:cure negative}]",
    "bias.unusual": unusual_bias,
}
_FOLLOWING: Messages = {
    "windows.left_out": "{count} of {total} windows do not fit the rest and were left out[, "
    "nearly all between {start:.1f} and {end:.1f} s of the log: check what happened there; the "
    "result is from the rest of the log]",
    "imu.accel_reversed": "the accelerometer points down at rest: its values fit the motion "
    "decisively better with the opposite sign, so the sign was reversed (--accel-sign up keeps it)",
    "imu.accel_sign_in_doubt": "the estimated gravity is far from down, and the motion does not "
    "show whether the world frame is tilted or the accelerometer points down at rest: give "
    "--accel-sign up or down, or also move the parent link along straight lines",
}
_FOLLOWING_OF_ANSWER: Messages = {
    "offset.undetermined": "the motion does not determine the time offset; the value is a guess",
    "unknown.found": unknown_found,
    "gravity.tilted": "gravity is {tilt:deg.0f} away from -z of the world: right if "
    "[tracked?another axis of the tracker's world points up (often y); otherwise its "
    "quaternions, its frames][tracked=?the base is mounted like this; otherwise joint signs, "
    "frames] or the accelerometer's sign are wrong",
    "prior.contradicted": "the data contradict {option}: if it is estimated, it differs from your "
    "value by {step:in unit std}; leave the option out, or measure again",
}
_OF_ANSWER: Messages = {
    "prior.untested": "the log has no information on {components:list} beyond --fix or "
    "--prior-std: it neither confirms nor contradicts the given value",
    "robot.joints_still": "{joints:list} [count=1?does not move in this log: errors of its "
    "zero||do not move in this log: errors of their zeros] and lengths "
    "look like errors of the mount, and add {translation:mm.2g} and {rotation:deg.2g} to "
    "sigma; move them too, or give --robot exact or --robot ANGLE,LENGTH",
    "imus.together": "solved together with {others:list}: they share the errors of the robot",
}
REQUIREMENTS: Messages = {
    "require.sigma": "--require asks for [" + _TRANSLATION + "]"
    "[translation_axis?; and for " + _ROTATION + "][translation_axis=?" + _ROTATION + "]: "
    "[remedy=motion?record the motion that determines it]"
    "[remedy=longer?record about {longer:fig2} times as long (sigma falls with the root of the "
    "duration), or faster motion]"
    "[remedy=faster?record faster turns about several axes, and more of them]",
    "require.no_sigma": "--require asks for [{translation:mm.6g}][translation? and "
    "{rotation:deg.6g}][translation=?{rotation:deg.6g}], but --method {method} gives no sigma: "
    "use --method matched",
    "require.text": "{text}",
}
"""Of a sigma that is too large, but not wrong; ``require.text`` occurs in stored results that were
written without codes."""
UNSPECIFIC = _UNSPECIFIC | _UNSPECIFIC_OF_ANSWER
"""Something is wrong, but not what: a known cause replaces them."""
FOLLOWING = UNSPECIFIC | _FOLLOWING | _FOLLOWING_OF_ANSWER
"""A wrong model causes them too: a known cause replaces them."""
OF_ANSWER = _UNSPECIFIC_OF_ANSWER | _FOLLOWING_OF_ANSWER | _OF_ANSWER | REQUIREMENTS
"""They rest on the answer, its unknowns and their priors, not on the data: another answer from the
same data has its own."""
MESSAGES: Messages = {
    **FOLLOWING,
    **OF_ANSWER,
    # A text without a code.
    "text": "{text}",
    # The recording and its files.
    "log.cut_short": "{file}: the {what} is cut short or damaged at byte {byte} of {size}: the "
    "part before it is used",
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
    "log.definition_damaged": "{file}: the definition of {topic} ({type}) is missing or "
    "damaged, so that its messages cannot be read: use a sound copy of the log, or record again",
    "log.part_missing": "{file}: {name} is named in metadata.yaml but is not there",
    "log.part_unusable": "{file}: left out: {reason}",
    "log.unpacks_too_large": "{file}: it unpacks to over {ratio} times its size, which no log does",
    "log.holds_too_much": "{file}: it holds more messages than bytes, or numbers of over {ratio} "
    "times its size, which no log does: the part before them is used",
    "log.compression_damaged": "{file}: its compression is damaged ({reason}): the part before "
    "the damage is used",
    "log.database_cut_short": "{file}: the database is cut short or damaged: what can be read is "
    "used",
    "log.database_companion": "{file}: {name} does not match the database and is not used",
    "log.database_wal": "{file}: its -wal is damaged or was cut off while it was written: {left} "
    "of its {total} pages are left out",
    "log.database_topic": "{file}: topic {number} is left out: its name or type is not text",
    "log.database_damaged": "{file}: the database is damaged ({reason}): the rows found in its "
    "pages are used",
    "log.more_losses": "{file}: and {count} further losses",
    "log.messages_missing": "{topic}: only {found} of the {listed} messages that the index counts "
    "are there",
    "log.messages_undecoded": "{topic}: {undecoded} of {messages} messages do not fit {type} and "
    "are left out",
    "log.row_unreadable": "{file}: row {row} is the first that cannot be read: {text:quoted}"
    "[comma?: write numbers with a decimal point]",
    "log.files_overlap": "{first} and {second} overlap by {seconds:.3g} s: if they are two "
    "recordings, name each alone",
    # Contents of messages.
    "imu.frames_mixed": "{topic}: {count} messages in other frames ({others:quoted}) than "
    "{frame:quoted} are left out",
    "imu.joined": "{gyro}: one IMU with the accelerometer of {accel}; {slow} is interpolated onto "
    "the stamps of {fast}, {rate:.4g} Hz",
    "imu.not_finite": "{topic}: {count} messages whose values are not finite or beyond {limit:g} "
    "are left out",
    "joints.named_twice": "{topic}: {count} messages that name a joint twice are left out",
    "joints.incomplete": "{topic}: {count} of {total} messages are left out, as they have "
    "[positions?{positions}||no] position[positions=1?||s] for [named?{named}||no] joint"
    "[named=1?||s] by name[positions?; say which joints they are by --joints]",
    "joints.columns": "{topic}: {count} messages are left out, as {field} has {numbers} "
    "numbers and --joints names {named}: name a part, or - for what is no joint",
    "joints.not_finite": "{topic}: {count} messages whose positions are not finite or beyond "
    "{limit:g} are left out",
    "pose.unusable": "{topic}: {count} poses that are not finite or whose quaternion is not of "
    "unit norm are left out",
    "joints.prefixed": "{topic}: names of joints ({count}) differ from those of {robot} by the "
    "prefix '{prefix}' and are matched to them; --joint-prefix overrides this",
    "frames.prefixed": "names of frames ({count}) differ from links of {robot} by the prefix "
    "'{prefix}' and are matched to them",
    "base.imu": "{topic} on {link} gives the motion of the robot; the other IMUs are calibrated "
    "against it",
    "pose.told_twice": "{topic} also gives the pose of {child} in {parent}; {used} is used "
    "because it has more messages",
    "stream.rows_left_out": "{stream}: left out {not_finite} messages that are not finite, "
    "{astray} with stamps far from the log and {repeated} with repeated stamps",
    "stream.leaps": "{stream}: {count} messages in which a value jumps by more than {least:g} "
    "(rad or m) and back are left out: check the "
    "[kind=pose?tracker][kind=joints?encoder][kind=?encoder] or its driver",
    "stream.flips": "{stream}: {count} poses are left out, {stretches:spans}: the pose "
    + _JUMPS
    + ", and back: the tracker swaps its markers"
    + _MARKERS,
    "stream.steps": "{stream}: at {seconds:times} the pose "
    + _JUMPS
    + ", and stays there: both sides are used, with a gap between them: the tracker swapped its "
    "markers or started over" + _MARKERS,
    "stream.missing": "{stream} is missing for {missing:.3g} of the {whole:.3g} s of the log, the "
    "longest time from {start:.1f} to {end:.1f} s: the rest is used, and sigma is for the rest",
    "streams.overlap": "{streams:list} have only {shared:.3g} s in common, and the shorter has "
    "{shorter:.3g} s: with so little, a wrong time offset can fit by chance: check the stamps "
    "(--clock), give the right --time-offset if it is known, or record both over the same time",
    # Stamps and clocks.
    "joints.numbered": "{topic}: the motors are numbered; {count} get the names of {called} in "
    "{robot}",
    "stamps.none": "{topics:list}: no stamps in the messages; receive times are used for all "
    "topics",
    "stamps.all_zero": _STAMPS + "are all zero" + _THEN,
    "stamps.some_zero": _STAMPS + "are zero in {count} of {total} messages" + _THEN,
    "stamps.all_same": _STAMPS + "are all the same" + _THEN,
    "stamps.stand_still": _STAMPS + "advance in only {count} of {total} steps" + _THEN,
    "stamps.backwards": _STAMPS + "run backwards in {count} of {total} steps" + _THEN,
    "stamps.set_back": _STAMPS
    + "jump back by {seconds:.3g} s at message {number} and repeat that time"
    + _THEN,
    "stamps.step": _STAMPS
    + "step by {milliseconds:+.0f} ms against the receive times near {when:.0f} s"
    + _THEN,
    "stamps.other_pace": _STAMPS
    + "advance at {rate:.3g} times the receive times, those of other topics at {others:.3g} times"
    + _THEN,
    "stamps.other_epoch": _STAMPS + "lie {seconds:.4g} s apart from those of other topics" + _THEN,
    "stamps.bunched": "{stream}: stamps come in bursts[ of {batch:many}] ({share:.0%} of the "
    "intervals are far shorter than the {period:ms.4g} between samples[, {lost:some} messages "
    "seem to be missing]): they are arrival times and were replaced by evenly spaced stamps; the "
    "time offset includes the unknown delay",
    "stamps.surplus": "{stream}: {share:.1%} of the intervals are far shorter than those between "
    "samples, and those messages are not samples of a constant rate: they are left out; check for "
    "a driver or a recorder that sends a buffer twice",
    "stamps.rate_changes": "{stream}: the rate changes within the log ({rates:rates starts}): the "
    "stamps are used as recorded; check the driver's setting if one rate was intended",
    "stamps.reordered": "{stream}: the stamps go back {count} times: the messages are put in the "
    "order of their stamps; check for a driver or a network that sends them out of order",
    # Units and readings of the IMU.
    "imu.accel_looks_like": "{topic}: |accel| at rest is {norm:.4g}, which looks like {unit}; "
    "sensor_msgs/Imu is in m/s²",
    "imu.accel_without_gravity": "{topic}: |accel| at rest is {norm:.3g}: gravity is absent or was "
    "removed (--gravity none)",
    "imu.accel_of_no_unit": "{topic}: |accel| at rest is {norm:.4g}, of no known unit",
    "imu.gyro_looks_like": "{topic}: the gyroscope reaches {largest:.4g}, which looks like {unit}; "
    "sensor_msgs/Imu is in rad/s",
    "imu.gyro_unit_converted": "{topic}: gyro reads {ratio:.3g} times the rate at which the robot "
    "turns: taken as {unit} and multiplied by {factor} (--gyro-unit {keep} keeps it)",
    "imu.gyro_factor_unknown": "{topic}: gyro reads [std?{factor:± std}||{factor:fig6}] times the "
    "rate at which the robot turns, a constant factor that belongs to no known unit "
    "({known:list}): raw counts or a wrong scale of the gyroscope, or of the joint positions or "
    "odometry[link?, or the IMU is on another link]; correct it and record again",
    "imu.gyro_too_fast": "{topic}: gyro reaches {largest:.3g}, more than most gyroscopes measure "
    "in rad/s, and [it is {ratio:.3g} times the robot's rate, where deg/s would be 57.3 "
    "times||the robot's own motion does not show its unit]: name its unit by --gyro-unit deg/s or "
    "--gyro-unit rad/s, or fix the driver and record again",
    "imu.accel_unit_converted": "{topic}: accel at rest is {norm:.4g}: taken as {unit} and "
    "multiplied by {factor:.6g} (--accel-unit m/s2 keeps it)",
    "imu.accel_unit_contradicted": "{topic}: accel at rest is {norm:.4g}, which is gravity in "
    "{unit}, yet --accel-unit {stated} was given, which makes it {times:.3g} times gravity: leave "
    "the option out",
    "imu.gyro_unit_contradicted": "{topic}: gyro reads {ratio:.3g} times the rate at which the "
    "robot turns, which is {unit}, yet --gyro-unit {stated} was given, which would read "
    "{expected:.3g} times: leave the option out",
    "imu.accel_unit_unknown": "{topic}: accel at rest is {norm:.4g}, which is gravity in no known "
    "unit: correct its scale, or give --accel-unit or --gravity",
    "imu.gravity_unasked": "{topic}: accel at rest is {norm:.4g}, which is gravity in {unit}, yet "
    "--gravity none was given",
    "imu.gravity_removed": "{topic}: accel at rest is {norm:.4g} m/s², so it does not contain "
    "gravity: if the robot is weightless or the driver removes gravity, rerun with --gravity none",
    "imu.zero": "{topic}: [sensor=both?gyro and accel are||{sensor} is] [reads?{reads}||zero] in "
    "all {count} messages: the driver does not fill [sensor=both?them in, and nothing can be "
    "calibrated from it; turn it on in the driver, or choose another {option}||it in, and "
    "{sensor:other} alone is not enough to find the pose; turn it on in the driver, choose "
    "another {option}, or, if another topic has it, name both by --gyro-topic and --accel-topic]"
    "[reads=NaN?; the header of a table names columns of the gyroscope gx gy gz, of the "
    "accelerometer ax ay az]",
    "imu.impossible": "{topic}: {sensor} is beyond {limit:g} {unit} in {count} of {total} "
    "messages, which no IMU measures: fix the driver or the log's layout and record again",
    "imu.axes_dead": "{topic}: {sensor} {axes:spaced} reads {held:list.4g} from first message to "
    "last while the others vary: the sensor or its driver is broken there, and the pose cannot be "
    "found without it",
    "imu.axes_dead_in_motion": "{topic}: {sensor} {axes:spaced} reads {held:list.4g} from first "
    "message to last, but the robot turns differently: the sensor or its driver is broken there, "
    "or the IMU is on another link",
    "imu.frozen": "{topic}: {sensor} {axes:spaced} is frozen at {held:list.5g} {sensor:unit} in "
    "{samples} samples[ in {stretches:many} stretches] between {start:.2f} and {end:.2f} s of the "
    "log: they were left out; check for a driver that repeats its last message",
    "imu.held": "{topic}: {share:.0%} of the samples in motion repeat the one before in all six "
    "numbers: the log has samples of about {rate:fig2} Hz, each held until the next, which looks "
    "like noise and delay: log each sample once, when the sensor has measured it",
    "imu.saturated": "{topic}: {sensor} {axes:spaced} is saturated at {held:list.5g} "
    "{sensor:unit} in {samples} samples[ in {stretches:many} stretches] between {start:.2f} and "
    "{end:.2f} s of the log: they were left out; set a larger range or move more slowly",
    "imu.motion_left_out": "{share:.0%} of the rotation is in samples that were left out as frozen "
    "or saturated: record again with a sound sensor of larger range",
    "imu.bias_beyond_sheet": "a {sensor} bias of {bias:.2g} {sensor:unit} is far beyond the data "
    "sheet of {model} ({sigma:.2g}, 1 sigma), so the sheet does not limit it: the IMU is not "
    "the one of --imu-model, the unit is another, or the sensor is damaged",
    "imu.noise_above_sheet": _NOISE + "{measured:/ expected} times the {expected:.2g} of the data "
    "sheet of {model} at {rate:.4g} Hz: the mount is loose or vibrates, or this is another IMU; "
    "fasten or damp it, or correct --imu-model (the result uses the measured noise)",
    "imu.noise_below_sheet": _FILTERED + ", the log is simulated, or this is another IMU; if it is "
    "another, correct --imu-model",
    "imu.noise_filtered": _FILTERED + " (below the cut-off the noise is that of the sheet); "
    "the filter's delay is part of the time offset; if this is another IMU, correct --imu-model",
    "imu.beyond_range": "{samples} samples of the {sensor:sensor} are beyond the range of "
    "{full_scale:.4g} {sensor:unit} in the data sheet of {model}: glitches, another unit, or an "
    "IMU other than --imu-model",
    # The robot.
    "robot.described": "the URDF of '{robot}' is taken from the log's {topic}; --urdf overrides it",
    "robot.description_unusable": "{reason}: the log's own description of the robot is not used",
    "robot.chain_missing": "{parent} is taken as the parent of [frame?'{frame}'||the IMU], because "
    "no other frame moves; if a joint lies between them, [has_robot?name the IMU's link by "
    "--imu-link or --parent||give --urdf], without which {topics:list} cannot be used",
    "joints.other_robot": "{dropped:list} also has joints of {robot}; {used:list} is used because "
    "it is in the namespace of the IMU",
    "cause.pose_unread": "no link of the robot moves like the IMU, but {topics:list} was not "
    "read: if it is the pose of the robot's base, give --pose-topic {first}",
    "robot.unused": "{urdf} is not used; the motion comes from the log's own frames: {reason}",
    "robot.held": "{streams:list}: stands still from {stretches:spans} while the IMU turns: "
    "frozen, or something else moves the robot; these stretches were left out",
    "robot.held_in_motion": "{share:.0%} of the IMU's rotation happened while the robot's stream "
    "stood still: record again with a publisher that runs throughout",
    "robot.static": "the robot does not move in this[part? part of the] log",
    "robot.frozen": "{topics:list}: the robot stands still[part? in this part of the log], while "
    "the IMU turns at {rate:.2g} rad/s: a publisher repeats its last message, or the IMU is on "
    "another robot; restart the publisher and record again, or choose other topics",
    "nominal.inverted": "[joint {joint}||the nominal pose] seems to hold the pose of the parent "
    "in the IMU instead of the pose of the IMU in the parent: its inverse is "
    "{inverse_distance:mm.2g} and {inverse_angle:deg.2g} from the pose found, the pose itself "
    "{distance:mm.3g} and {angle:deg.3g}",
    # Two results.
    "trend.unknown_time": "{file}[ and {others:some} more]: the recording time is not known (a "
    "result of an earlier version, or a log without dates), so the results are taken in the given "
    "order, those of a folder by name",
    "trend.at_once": "{second}[ and {others:some} more] began before {first} ended, but one mount "
    "cannot be recorded twice at the same time: the results are of several robots (give the "
    "results of each robot separately), or simulated (imucalib simulate --start dates them); "
    "results with the same start are ordered by name",
    "diff.same_log": "{first} and {second} were computed from the same log: their errors are not "
    "independent, so the sigma of their difference is not valid",
    "compare.frames_far": "the poses are farther apart than two calibrations of one mount are: is "
    "{camera_link} the camera's optical frame (z forward, x right, y down)?[ --camera-link takes "
    "another: {others:list}]",
    # Several IMUs together.
    "imus.disagree": "{imu} does not agree with {others:list} on the errors of the robot that "
    "they share: solved together, its pose would differ by {translation:mm.2g} and "
    "{rotation:deg.2g}, {sigmas:.2g} sigma, so it is solved alone; check the joints "
    "that only one of the IMUs has, and that every IMU is mounted firmly",
    # Many logs, each on its own.
    "batch.log_twice": "{log} is the same log as {first} and is calibrated once",
    "batch.log_replaced": "{log} is not the recording that was calibrated under this name before: "
    "the earlier results are replaced; to keep both, give each recording its own name",
    "batch.parts_joined": "{first}[ and {others:some} more]: taken as the parts of one recording "
    "because of their names; if each is a recording of its own, list them one by one: "
    "{pattern:quoted}",
    # Several logs together.
    "logs.disagree": "{log} disagrees with the other logs: its pose differs from theirs by "
    "{translation:mm.2g} and {rotation:deg.2g}, {sigmas:.2g} sigma including the scatter between "
    "logs: the mount moved, or the log is of another set-up; leave it out, or find out when it "
    "moved with imucalib trend",
    "logs.apart": "the logs do not agree on one pose: they differ by up to {translation:mm.2g} "
    "and {rotation:deg.2g}, more than a firm mount moves: find out when it moved with imucalib "
    "trend, and combine the logs of each position separately",
    "logs.far": "{log} was solved {rotation:deg.2g} from the common pose, too far for its "
    "statistics to be valid there: run it again with --initial and --prior-std near the common "
    "pose",
    "logs.left_out": "{log} is not trusted on its own and was left out: {reason}",
    "logs.one_left": "{log} is the only log left, and {other}, which was left out, has a pose "
    "{translation:mm.2g} and {rotation:deg.2g} from its own: one log does not show how far the "
    "mount moves between recordings; give more logs, or run on {log} alone",
    "logs.missing": "{missing} of the {logs} logs give no result for this IMU: the result is from "
    "the other {used}; run on each alone to see why",
    "logs.twice": "some of the logs have the same samples as others ({count}): the longest counts "
    "once",
    "logs.few": "{logs} logs are too few to estimate how far the mount scatters between "
    "recordings (up to {translation:mm.2g} and {rotation:deg.2g}): sigma includes this scatter; "
    "more logs reduce it",
    # The fit.
    "imu.strikes": "{topic}: strikes of up to {largest:.3g} m/s² ({count}): {windows} of "
    "{total} windows contain one; {left_out} of them do not fit the rest and were left out",
    "imu.slow": "{topic}: at {rate:.3g} Hz the accelerometer misses what happens between two "
    "samples: set a rate of {enough:g} Hz or more, and its low-pass to less than half of it",
    "imu.spikes": "{topic}: {count} of {total} samples are single spikes and were replaced from "
    "their neighbours: check the sensor's cable, power supply and driver",
    "windows.between_gaps": "filter windows cover only {share:.0%} of the time of both streams, "
    "the rest is lost to gaps ({imu} in the IMU's stamps, {robot} in the robot's): record without "
    "losses, or choose a shorter --window",
    "window.noisy": "the gyroscope shows errors of the kinematics, which may move the position by "
    "{error:mm.2g} in windows of {seconds:.2g} s; sigma includes this: [longest?move faster, "
    "reduce these errors||choose a longer --window], or "
    "[tracked?stamp each pose when it is measured][tracked=?publish each sample of the controller "
    "with the controller's stamp]",
    "imu.samples_left_out": "IMU samples left out: {repeated} with repeated stamps, {not_finite} "
    "not finite, {astray} with stamps far from the log",
    "stamps.imu_ticks": "IMU stamps jitter by {jitter:ms.2g} about a constant rate; the constant "
    "rate fits the motion better and was used",
    "stamps.robot_ticks": "robot stamps jitter about a constant rate, which fits the motion better "
    "and was used",
    "stream.held_values": "{stream}: values are held for several messages; only changes were used, "
    "and the time offset contains the hold",
    "paper.not_converged": "the solver did not converge: give a better --initial guess",
    "paper.undetermined": "the motion does not determine the pose: rotate about two axes at least",
    "paper.unexplained": "the solution leaves {force:.2g} m/s² and {rate:.2g} rad/s unexplained, "
    "perhaps a local minimum: give a better --initial guess or use --method matched",
    "paper.gaps": "the method assumes a constant rate; the log has {count} gaps, and the parts "
    "between them were filtered separately: prefer --method matched",
    "paper.no_sigma": "the published method gives no sigma, and assumes that both clocks agree and "
    "that the sensor has no bias: compare with --method matched",
    **{f"cause.{kind.partition('.')[0]}": cause for kind in CAUSES},
    "cause.publishers": publishers,
    "cause.base_moves": "the IMU [turns at {turning:deg.2g}/s][turning? and is accelerated by "
    "{pushing:.2g} m/s²][turning=?is accelerated by {pushing:.2g} m/s²] (rms) while everything "
    "else in the log stands still: {names:list} moves, [joints?the mount swings, or a joint in "
    "between moves that is not in the log; clamp it||or the poses are held; fix that], or record "
    "its pose and name it with --pose-topic",
    "cause.base_link": "the base IMU {topic} moves like {names:list}, not like {told}: correct "
    "its frame_id, or the URDF's joint that holds that frame",
    "cause.imu_still": "the IMU stands still while {names:list} turns at {turning:deg.2g}/s (rms): "
    "it is not on {names:list}; name what carries it with --parent, or choose another --imu-topic",
}
"""By code. Values are in SI units and radians unless their name says otherwise."""
