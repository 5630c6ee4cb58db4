"""Options of the estimator as typed, turned into those of the method that was chosen."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imucalib_cli.cli.quantities import (
    parse_choice,
    parse_components,
    parse_number,
    parse_pose,
    parse_pose_std,
    parse_prior,
    parse_seconds,
    parse_window,
)
from imucalib_cli.errors import ChoiceError

if TYPE_CHECKING:
    from imucalib_cli.estimate.options import MatchedOptions, PaperOptions, PosePrior

_ESTIMATE, _PAPER = "How to estimate", "Only with --method paper"
_MATCHED_ONLY = (
    "time_offset",
    "max_offset",
    "accel_bias",
    "gyro_bias",
    "tilt_std",
    "fix",
    "prior_std",
    "sensor_model",
    "robot",
)
_LONGEST_OFFSET = 600.0
"""s: clocks further apart than this share no log; a search needs memory by its width."""
_PAPER_ONLY = ("exclude", "residual")


@dataclass(frozen=True, kw_only=True)
class EstimatorTexts:
    """Options of the estimator as the user wrote them; None where nothing."""

    method: Annotated[
        str,
        typer.Option(
            metavar="matched|paper",
            help="Our estimator, or the published one.",
            rich_help_panel=_ESTIMATE,
        ),
    ] = "matched"
    window: Annotated[
        str | None,
        typer.Option(
            metavar="SAMPLES|DURATION|auto",
            help="Filter window: 51, 0.2s, 200ms or auto.",
            show_default="auto; 11 with paper",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None
    degree: Annotated[
        int,
        typer.Option(
            min=2, max=9, help="Degree of the filters' polynomial.", rich_help_panel=_ESTIMATE
        ),
    ] = 3
    time_offset: Annotated[
        str | None,
        typer.Option(
            "--time-offset",
            metavar="auto|none|SECONDS",
            help="IMU stamp - robot stamp of the same instant: found, zero, or known.",
            show_default="auto",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None
    max_offset: Annotated[
        str | None,
        typer.Option(
            "--max-offset",
            metavar="SECONDS",
            help="Largest time offset that is looked for.",
            show_default="1.0",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None
    accel_bias: Annotated[
        str | None,
        typer.Option(
            "--accel-bias",
            metavar="free|none|STD",
            help="Accelerometer bias: unknown, zero, or zero within STD m/s².",
            show_default="free",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None
    gyro_bias: Annotated[
        str | None,
        typer.Option(
            "--gyro-bias",
            metavar="free|none|STD",
            help="Gyroscope bias: unknown, zero, or zero within STD rad/s.",
            show_default="free",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None
    gravity: Annotated[
        str | None,
        typer.Option(
            metavar="tilt|fixed|none|NORM",
            help="Direction found; along -z of the world; no gravity; or tilt with exactly this "
            "norm, m/s².",
            show_default="tilt; fixed with paper",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None
    tilt_std: Annotated[
        str | None,
        typer.Option(
            "--tilt-std",
            metavar="DEG",
            help="How level the world is known to be, 1 sigma.",
            show_default="unknown",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None
    fix: Annotated[
        str | None,
        typer.Option(
            metavar="tx,ty,tz,rx,ry,rz",
            help="Components held at the URDF's pose, or at --initial; parent frame.",
            show_default="none",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None
    prior_std: Annotated[
        str | None,
        typer.Option(
            "--prior-std",
            metavar="2mm,0.5deg|tx=1mm,rz=0.2deg",
            help="How well the URDF's pose, or --initial, is known beforehand, 1 sigma.",
            show_default="unknown",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None
    initial: Annotated[
        str | None,
        typer.Option(
            metavar='"X Y Z R P Y"',
            help="Pose that --fix, --prior-std and the published method begin from, m and rad.",
            show_default="the URDF's joint",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None
    imu_model: Annotated[
        str | None,
        typer.Option(
            "--imu-model",
            "--imu",
            metavar="NAME|FILE",
            help="Which IMU it is, as configs/imus has it: bmi088, adis16448 ...; its data sheet "
            "gives weak priors of the biases, and its noise is compared with the log's.",
            show_default="unknown",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None
    sensor_model: Annotated[
        str | None,
        typer.Option(
            "--sensor-model",
            metavar="auto|ideal",
            help="Find the sensor's and the clocks' own errors too; or take them not to exist.",
            show_default="auto",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None
    robot: Annotated[
        str | None,
        typer.Option(
            metavar="nominal|exact|DEG,MM",
            help="How good the URDF is: learnt from the log; without any error; or its joint "
            "zeros and lengths good to these, 1 sigma.",
            show_default="nominal",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None
    exclude: Annotated[
        str | None,
        typer.Option(
            metavar="THRESHOLD",
            help="Change of the derived acceleration, m/s², that excludes a sample; 0 keeps all.",
            show_default="the method's",
            rich_help_panel=_PAPER,
        ),
    ] = None
    residual: Annotated[
        str | None,
        typer.Option(
            metavar="l1|components",
            help="One sum for each instant, or its six parts.",
            show_default="l1",
            rich_help_panel=_PAPER,
        ),
    ] = None


def estimator_options(texts: EstimatorTexts) -> MatchedOptions | PaperOptions:
    """Check and convert what the user wrote.

    Raises:
        ChoiceError: A value is not understood, or belongs to the other method.
    """
    method, degree = texts.method, texts.degree
    parse_choice("--method", method, ("matched", "paper"))
    foreign = _PAPER_ONLY if method == "matched" else _MATCHED_ONLY
    for field in fields(texts):
        if field.name in foreign and getattr(texts, field.name) is not None:
            other = "paper" if method == "matched" else "matched"
            option = "--" + field.name.replace("_", "-")
            raise ChoiceError(
                f"{option} belongs to --method {other}: add that, or leave {option} out"
            )
    options = _matched(degree, texts) if method == "matched" else _paper(degree, texts)
    samples = options.window.samples
    if samples is not None and samples <= degree:
        raise ChoiceError(
            f"--window of {samples} samples cannot smooth with --degree {degree}: "
            f"take at least {(degree + 1) | 1} samples"
        )
    return options


def _matched(degree: int, texts: EstimatorTexts) -> MatchedOptions:
    from imucalib_cli.estimate.options import MatchedOptions

    given: dict[str, Any] = {"degree": degree}
    if texts.window is not None:
        given["window"] = parse_window(texts.window)
    if texts.time_offset not in {None, "auto"}:
        given["time_offset"] = _time_offset(str(texts.time_offset))
    if texts.max_offset is not None:
        given["max_offset"] = _positive_seconds("--max-offset", texts.max_offset)
    if texts.accel_bias is not None:
        given["accel_bias_std"] = parse_prior("--accel-bias", texts.accel_bias)
    if texts.gyro_bias is not None:
        given["gyro_bias_std"] = parse_prior("--gyro-bias", texts.gyro_bias)
    if texts.gravity in {"tilt", "fixed", "none"}:
        given["gravity"] = texts.gravity
    elif texts.gravity is not None:
        given |= {"gravity_norm": _norm(texts.gravity), "gravity_std": 0.0}
    if texts.tilt_std is not None:
        given["tilt_std"] = _tilt(texts)
    given |= _quality(texts)
    given["pose"] = _pose_prior(texts)
    return MatchedOptions(**given)


def _quality(texts: EstimatorTexts) -> dict[str, Any]:
    """How good sensor and robot are."""
    given: dict[str, Any] = {}
    if texts.sensor_model is not None:
        given["sensor_model"] = parse_choice(
            "--sensor-model", texts.sensor_model, ("auto", "ideal")
        )
    if texts.robot is not None:
        given["robot"] = _robot(texts.robot)
    return given


def _robot(text: str) -> str | tuple[float, float]:
    if text in {"nominal", "exact"}:
        return text
    allowed = "nominal, exact, or how good joint zeros and lengths are, such as 0.05deg,0.5mm"
    std = parse_pose_std("--robot", text, allowed)
    zero, length = std[3], std[0]
    if not (0.0 < zero < math.inf and 0.0 < length < math.inf):
        raise ChoiceError(f"--robot {text}: expected {allowed}")
    return zero, length


def _pose_prior(texts: EstimatorTexts) -> PosePrior | None:
    """What the user knows of the pose; where it is about may be left to the URDF."""
    from imucalib_cli.estimate.options import PosePrior

    std = [math.inf] * 6
    if texts.prior_std is not None:
        std = parse_pose_std("--prior-std", texts.prior_std)
    if texts.fix is not None:
        for place in parse_components("--fix", texts.fix):
            std[place] = 0.0
    if all(math.isinf(value) for value in std):
        if texts.initial is not None:
            raise ChoiceError(
                "--initial belongs to --fix, --prior-std or --method paper: the matched method "
                "needs no guess, so leave it out"
            )
        return None
    if texts.initial is None:
        return PosePrior(std=tuple(std))
    known = _initial(texts.initial)
    return PosePrior(
        std=tuple(std), R_parent_imu=known["R_initial"], t_parent_imu=known["t_initial"]
    )


def _paper(degree: int, texts: EstimatorTexts) -> PaperOptions:
    from imucalib_cli.estimate.options import PaperOptions

    given: dict[str, Any] = {"degree": degree}
    if texts.window is not None:
        given["window"] = parse_window(texts.window)
    if texts.gravity == "none":
        given["gravity_norm"] = 0.0
    elif texts.gravity == "tilt":
        raise ChoiceError("--gravity tilt belongs to --method matched: use fixed, none or a norm")
    elif texts.gravity not in {None, "fixed"}:
        given["gravity_norm"] = _norm(str(texts.gravity))
    if texts.exclude is not None:
        allowed = "a threshold in m/s², or 0 to exclude nothing"
        threshold = parse_number("--exclude", texts.exclude, allowed)
        if threshold < 0.0:
            raise ChoiceError(f"--exclude {texts.exclude}: is negative; expected {allowed}")
        given["exclusion_threshold"] = threshold
    if texts.residual is not None:
        given["residual"] = parse_choice("--residual", texts.residual, ("l1", "components"))
    if texts.initial is not None:
        given |= _initial(texts.initial)
    return PaperOptions(**given)


def _initial(text: str) -> dict[str, Any]:
    xyz, rpy = parse_pose("--initial", text)

    import numpy as np

    from imucalib_cli.robot.rotations import matrix_from_rpy

    return {"t_initial": np.array(xyz), "R_initial": matrix_from_rpy(rpy)}


def _time_offset(text: str) -> float:
    if text == "none":
        return 0.0
    return parse_seconds("--time-offset", text, "auto, none, or seconds such as -0.042 or -42ms")


def _positive_seconds(option: str, text: str) -> float:
    value = parse_seconds(option, text)
    if not 0.0 < value <= _LONGEST_OFFSET:
        raise ChoiceError(
            f"{option} {text}: expected more than 0 and at most {_LONGEST_OFFSET:g} s"
        )
    return value


def _norm(text: str) -> float:
    allowed = "tilt, fixed, none, or the norm in m/s² such as 9.81"
    norm = parse_number("--gravity", text, allowed)
    if norm <= 0.0:
        raise ChoiceError(f"--gravity {text}: must be positive; expected {allowed}")
    return norm


def _tilt(texts: EstimatorTexts) -> float:
    if texts.gravity in {"fixed", "none"}:
        raise ChoiceError(f"--tilt-std means nothing with --gravity {texts.gravity}")
    degrees = parse_number("--tilt-std", str(texts.tilt_std), "degrees, such as 0.5")
    if degrees <= 0.0:
        raise ChoiceError("--tilt-std must be positive; for no tilt at all use --gravity fixed")
    return math.radians(degrees)
