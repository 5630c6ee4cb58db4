"""Options that several commands share: each is declared once, with type, parser and help."""

from __future__ import annotations

import inspect
from dataclasses import dataclass, fields, is_dataclass, make_dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_type_hints

import typer

from imucalib_cli.cli import complete, parsers
from imucalib_cli.cli.output import be_quiet
from imucalib_cli.results.formats import FORMATS

if TYPE_CHECKING:
    from collections.abc import Callable

    from imucalib_cli.cli.parsers import Pose
    from imucalib_cli.estimate.options import WindowChoice
    from imucalib_cli.logs.messages.columns import JointColumns
    from imucalib_cli.logs.messages.table import Kind
    from imucalib_cli.logs.reader import LogPath
    from imucalib_cli.results.requirement import Tolerance

    Gravity = Literal["tilt", "fixed", "none"] | float
    Robot = Literal["nominal", "exact"] | tuple[float, float]
    Components = list[int]
    PoseStd = list[float]
    Names = tuple[str, ...]
    FormatName = str
else:  # typer evaluates these too; the parsers of the options decide the types
    Components = Gravity = JointColumns = LogPath = Names = Pose = PoseStd = Robot = Tolerance = (
        WindowChoice
    ) = object
    FormatName = Literal[tuple(FORMATS)]

# Panels of the help, in the order in which a user needs them.
LOG, ROBOT = "Log and topics", "Robot"
KNOWN = "Known beforehand"
ESTIMATOR, PAPER = "Estimator", "Only with --method paper"
OUTPUT = "Output"

_log = partial(typer.Option, rich_help_panel=LOG)
_log_time = partial(_log, metavar="SECONDS|STAMP", parser=parsers.log_time)
_robot = partial(typer.Option, rich_help_panel=ROBOT)
_known = partial(typer.Option, rich_help_panel=KNOWN)
_estimator = partial(typer.Option, rich_help_panel=ESTIMATOR)
_paper = partial(typer.Option, rich_help_panel=PAPER)
output_option = partial(typer.Option, rich_help_panel=OUTPUT)
local_file_option = partial(typer.Option, metavar="FILE", parser=parsers.local_file)
_frame = partial(_robot, metavar="FRAME", parser=parsers.frame, autocompletion=complete.links)
_pose_std = partial(_known, metavar="2mm,0.5deg|tx=1mm,rz=0.2deg", parser=parsers.pose_std)
_bias = partial(_known, metavar="free|none|STD", parser=parsers.bias_std, show_default="free")


def _topics(
    kind: Kind, flag: str, *, show_default: str = "found automatically", **settings: Any
) -> Any:
    settings |= {"metavar": "TOPIC", "parser": parsers.topic, "show_default": show_default}
    return _log([], flag, autocompletion=complete.topics(kind), **settings)


def file_option(forms: str, *other: str, **settings: Any) -> Any:
    """A file whose suffix chooses its form: ``FILE.csv|.parquet``, and others not in the help."""
    suffixes = forms.removeprefix("FILE").split("|")
    parser = parsers.file_ending(*suffixes, *other)
    return output_option(None, metavar=forms, parser=parser, show_default="none", **settings)


CsvColumns = Annotated[
    Names | None,
    _log(
        metavar="NAME,NAME,...",
        parser=parsers.names,
        help="Columns of a CSV table without a header: t,gx,gy,gz,ax,ay,az; - skips a column, "
        "and ... at the end all others.",
    ),
]
JointColumnsOption = Annotated[
    list[JointColumns] | None,
    _log(
        "--joints",
        metavar="TOPIC:FIELD=NAME,...",
        parser=parsers.joint_columns,
        help="Joint names for messages that have only numbers: /arm:data[0:6]=pan,lift,...; use - "
        "for a number that is no joint. Repeatable.",
        show_default="none",
    ),
]
PartFrom = Annotated[
    float | None,
    _log_time(
        "--from",
        help="Use the log from this time on: seconds since the start of the log, or a stamp in "
        "s or ns since 1970.",
        show_default="start of the log",
    ),
]
PartTo = Annotated[
    float | None,
    _log_time("--to", help="Use the log up to this time.", show_default="end of the log"),
]
WORDS_OR_YAML = "summary on a terminal, else yaml"
"""Default of ``--format``, see output.chosen_format."""
FormatOption = Annotated[
    FormatName | None,
    output_option(
        "--format",
        help="; ".join(f"{name}: {each.words}" for name, each in FORMATS.items() if each.words)
        + ".",
        show_default=WORDS_OR_YAML,
    ),
]
Require = Annotated[
    Tolerance | None,
    output_option(
        "--require",
        metavar="LENGTH,ANGLE",
        parser=parsers.tolerance,
        help="Largest sigma to accept, such as 1mm,0.1deg; exit 3 if sigma is larger.",
        show_default="none",
    ),
]
Force = Annotated[
    bool,
    output_option(
        "--force",
        help="Write a bare pose (urdf, tf, ...) even if it should not be trusted, and overwrite "
        "a log or a URDF.",
    ),
]
AnswersFormat = Annotated[
    Literal["yaml", "json", "jsonl", "csv", "summary"] | None,
    output_option(
        "--format",
        help="Format of the answers; jsonl: one line of JSON per answer; csv: one row per answer; "
        "summary: plain text.",
        show_default=WORDS_OR_YAML,
    ),
]
OutputFile = Annotated[
    Path | None,
    output_option(
        "-o",
        "--output",
        metavar="FILE",
        parser=parsers.output_file,
        help="File to write.",
        show_default="stdout",
    ),
]
Within = Tolerance | None
within_option = partial(
    output_option,
    None,
    "--within",
    metavar="LENGTH,ANGLE",
    parser=parsers.within,
    help="Largest difference to accept, such as 2mm,0.2deg; a part that is not given is 5mm or "
    "0.5deg.",
)
Logs = Annotated[
    list[LogPath],
    typer.Argument(
        metavar="LOG...",
        parser=parsers.path_or_url,
        help="One recording: a ROS 1 bag, a ROS 2 folder or db3, an MCAP file, or tables; a path "
        "or URL, or all files of a split recording.",
    ),
]
ResultFiles = Annotated[
    list[str],
    typer.Argument(
        metavar="RESULT|FOLDER...",
        parser=parsers.named,
        help="Results of `imucalib run`, folders of them, or - for stdin.",
    ),
]
AllowRemoteScan = Annotated[
    bool,
    _log(
        "--allow-remote-scan",
        help="Make a temporary copy of a remote log that cannot be read in parts.",
    ),
]
Verbose = Annotated[
    bool, output_option("-v", "--verbose", help="Print what was read over the network.")
]
Quiet = Annotated[
    bool,
    output_option("-q", "--quiet", callback=be_quiet, help="Print only errors on stderr."),
]
"""It acts by itself: see output.remark."""


# Nobody compares or prints options: without __eq__ and __repr__ --help is 5 ms faster.
@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RecordingOptions:
    """What to read and on which robot; the names are those of CalibrationRequest."""

    imu_topics: list[str] = _topics(
        "imu",
        "--imu-topic",
        help="IMU to calibrate. Repeatable.",
        show_default="all in the log",
    )
    gyro_topics: list[str] = _topics(
        "imu",
        "--gyro-topic",
        help="Gyroscope whose accelerometer has another topic; the IMU has the name of the "
        "gyroscope's topic. Repeatable.",
    )
    accel_topics: list[str] = _topics(
        "imu",
        "--accel-topic",
        help="Accelerometer of this gyroscope. Repeatable, in the same order.",
    )
    joint_topics: list[str] = _topics(
        "joints",
        "--joint-topic",
        help="Joint states to use. Repeatable.",
        show_default="all",
    )
    pose_topics: list[str] = _topics(
        "pose",
        "--pose-topic",
        help="Poses (tf, odometry, motion capture) to use. Repeatable.",
    )
    clock: Literal["auto", "header", "log"] = _log(
        "auto",
        help="Use header stamps or receive times; auto uses header stamps unless they are broken.",
    )
    accel_unit: Literal["auto", "m/s2", "g", "mg"] = _log(
        "auto", help="Unit of the accelerometer; auto detects it from gravity at rest."
    )
    gyro_unit: Literal["auto", "rad/s", "deg/s"] = _log(
        "auto", help="Unit of the gyroscope; auto detects it from how fast the robot turns."
    )
    accel_sign: Literal["auto", "up", "down"] = _log(
        "auto",
        help="Direction of the accelerometer at rest; auto uses up, the convention of ROS, unless "
        "down fits the motion.",
    )
    csv_columns: CsvColumns = None
    joint_columns: JointColumnsOption = None
    part_from: PartFrom = None
    part_to: PartTo = None
    allow_remote_scan: AllowRemoteScan = False
    urdf: LogPath | None = _robot(
        None,
        metavar="FILE|URL",
        parser=parsers.path_or_url,
        help="The robot's URDF, - for stdin, or a .xacro (pip install 'imucalib\\[xacro]'); "
        "without it the log's /robot_description or its frames must give the motion.",
    )
    description_topics: list[str] = _topics(
        "text",
        "--description-topic",
        rich_help_panel=ROBOT,
        help="Topic of the URDF in the log, if several fit.",
    )
    joint_prefix: str | None = _robot(
        None,
        metavar="PREFIX",
        help="Prefix that joint names have in the log but not in the URDF, or the reverse.",
        show_default="found automatically",
    )
    parents: list[str] = _frame(
        [],
        "--parent",
        metavar="FRAME|IMU=FRAME",
        parser=parsers.parent,
        help="Link or frame that carries the IMU; for one of several IMUs IMU=FRAME, with the "
        "topic or frame_id of the IMU. Repeatable.",
        show_default="the one that holds the frame_id of the IMU's messages",
    )
    base_imu: str | None = _robot(
        None,
        metavar="TOPIC",
        autocompletion=complete.topics("imu"),
        help="IMU that measures how a robot without a fixed base moves, or how the body moves "
        "that carries another IMU; the others are calibrated against it.",
        show_default="the IMU on the URDF's root, if no other source gives its motion",
    )
    imu_link: str | None = _frame(
        None,
        metavar="LINK",
        help="The IMU's link in the URDF.",
        show_default="the frame_id of the IMU's messages",
    )
    world: str | None = _frame(
        None, help="Frame that does not move.", show_default="the root of the frames"
    )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class KnownOptions:
    """What is known beforehand; names that MatchedOptions has too mean the same.

    None is the default of the method, or of the run that is solved again.
    """

    accel_bias_std: float | None = _bias(
        None,
        "--accel-bias",
        help="Accelerometer bias: unknown (free), zero (none), or zero within STD m/s², 1 sigma.",
    )
    gyro_bias_std: float | None = _bias(
        None,
        "--gyro-bias",
        help="Gyroscope bias: unknown (free), zero (none), or zero within STD rad/s, 1 sigma.",
    )
    time_offset: float | None = _known(
        None,
        metavar="auto|none|SECONDS",
        parser=parsers.time_offset,
        help="IMU stamp - robot stamp of the same instant: estimated (auto), zero (none), or "
        "known.",
        show_default="auto",
    )
    gravity: Gravity | None = _known(
        None,
        metavar="tilt|fixed|none|NORM",
        parser=parsers.gravity,
        help="tilt: the direction is estimated; fixed: along -z of the world; none: no gravity; "
        "NORM: tilt with exactly this norm, m/s².",
        show_default="tilt; fixed with paper",
    )
    tilt_std: float | None = _known(
        None,
        metavar="DEG",
        parser=parsers.degrees,
        help="How accurately the world frame is known to be level, 1 sigma.",
        show_default="unknown",
    )
    robot: Robot | None = _known(
        None,
        metavar="nominal|exact|ANGLE,LENGTH",
        parser=parsers.robot,
        help="Errors of the URDF: nominal: their size is learnt from the log; exact: none; "
        "ANGLE,LENGTH, such as 0.05deg,0.5mm: 1 sigma of joint zeros and axes, and of lengths.",
        show_default="nominal",
    )
    fix: Components | None = _known(
        None,
        metavar="tx,ty,tz,rx,ry,rz",
        parser=parsers.components,
        help="Components that are held at the URDF's pose, or at --initial, in the parent frame.",
        show_default="none",
    )
    planar: bool = _known(
        False,
        "--planar",
        help="The robot drives on a plane and turns only about its upright axis. This motion "
        "does not determine the height: it is held, as by --fix tz where z is upright.",
    )
    prior_std: PoseStd | None = _pose_std(
        None,
        help="How accurately the URDF's pose, or --initial, is known beforehand, 1 sigma.",
        show_default="unknown",
    )
    base_std: PoseStd | None = _pose_std(
        None,
        help="How accurately the URDF's pose of the --base-imu in its link is known, 1 sigma.",
        show_default="learnt, like the robot's lengths and zeros",
    )
    initial: Pose | None = _known(
        None,
        metavar='"X Y Z R P Y"',
        parser=parsers.pose,
        help="Pose that --fix, --prior-std and the published method start from, m and rad.",
        show_default="the URDF's joint",
    )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class EstimatorOptions(KnownOptions):
    """How to estimate; names that MatchedOptions or PaperOptions have too mean the same."""

    imu_model: str | None = _known(
        None,
        metavar="NAME|FILE",
        autocompletion=complete.imu_models,
        help="Model of the IMU: a name from configs/imus (bmi088, adis16448 ...) or a file. Its "
        "data sheet gives weak priors of the biases and limits of the errors of scales and axes, "
        "and its noise is compared with the log's.",
    )
    method: Literal["matched", "paper"] = _estimator(
        "matched", help="matched: our estimator; paper: the published one."
    )
    window: WindowChoice | None = _estimator(
        None,
        metavar="SAMPLES|DURATION|auto",
        parser=parsers.window,
        help="Filter window: 51, 0.2s, 200ms or auto.",
        show_default="auto; 11 with paper",
    )
    degree: int = _estimator(3, min=2, max=9, help="Degree of the filters' polynomial, 2 to 9.")
    max_offset: float | None = _estimator(
        None,
        metavar="SECONDS",
        parser=parsers.largest_offset,
        help="Largest time offset of the search, at most 600 s.",
        show_default="1.0",
    )
    sensor_model: Literal["auto", "ideal"] | None = _estimator(
        None,
        help="auto: also estimate errors of the sensor and the clocks; ideal: assume none.",
        show_default="auto",
    )
    exclusion_threshold: float | None = _paper(
        None,
        "--exclude",
        metavar="THRESHOLD",
        parser=parsers.threshold,
        help="Exclude samples whose derived acceleration exceeds this, m/s²; 0 keeps all.",
        show_default="the default of the method",
    )
    residual: Literal["l1", "components"] | None = _paper(
        None,
        help="l1: one sum for each instant; components: its six parts.",
        show_default="l1",
    )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ExtraFiles:
    """Files beside the result; cli/extras.py makes each, by the field's name."""

    statistics: Path | None = file_option(
        "FILE.npz",
        help="Also write the statistics of the log: imucalib combine solves them again, alone "
        "or with those of other logs.",
    )
    report: Path | None = file_option(
        "FILE.html",
        ".htm",
        help="Also write an HTML page: the verdict, the pose to copy, and plots of the data "
        "behind them.",
    )
    residuals: Path | None = file_option(
        "FILE.csv|.parquet",
        help="Also write measured and predicted values over time; column time_s is the time axis.",
    )
    debug_mcap: Path | None = file_option(
        "FILE.mcap",
        help="Also write measured and predicted values, residuals and the moving robot for "
        "Foxglove and Rerun, and a layout, FILE.foxglove.json.",
    )
    plot: Path | None = file_option(
        "FILE.svg|.pdf|.png",
        help="Also draw measured and predicted values and the residuals, on one page for papers.",
    )


def flag_of(name: str) -> str:
    """The option of a field of ExtraFiles."""
    return f"--{name.replace('_', '-')}"


if TYPE_CHECKING:
    ExtrasForEachLog = Any
else:
    ExtrasForEachLog = make_dataclass(
        "ExtrasForEachLog",
        [
            (
                each.name,
                bool,
                output_option(False, flag_of(each.name), help=f"For each log. {each.default.help}"),
            )
            for each in fields(ExtraFiles)
        ],
        eq=False,
        repr=False,
    )
    """The same for many logs: whether each log gets such a file."""


def with_groups(command: Callable[..., None]) -> Callable[..., None]:
    """The command with each parameter that is a dataclass replaced by the fields of it.

    Typer reads a command's options from its signature; the command itself gets the dataclasses.
    """
    groups: dict[str, type[Any]] = {}
    parameters: list[inspect.Parameter] = []
    for parameter in inspect.signature(command, eval_str=True).parameters.values():
        kind: Any = parameter.annotation
        if isinstance(kind, type) and is_dataclass(kind):
            groups[parameter.name] = kind
            hints = get_type_hints(kind, include_extras=True)
            parameters += [
                parameter.replace(name=each.name, default=each.default, annotation=hints[each.name])
                for each in fields(kind)
            ]
        else:
            parameters.append(parameter)

    def ungrouped(**given: Any) -> None:
        for name, group in groups.items():
            given[name] = group(**{each.name: given.pop(each.name) for each in fields(group)})
        command(**given)

    ungrouped.__name__, ungrouped.__doc__ = command.__name__, command.__doc__
    ungrouped.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    ungrouped.__annotations__ = {p.name: p.annotation for p in parameters}
    return ungrouped
