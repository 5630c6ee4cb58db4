"""What the options of a command ask for, as the estimator and its jobs take it."""

from __future__ import annotations

import math
from inspect import signature
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace

from imucalib_cli.cli.parsers import imu_name
from imucalib_cli.errors import ChoiceError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import typer

    from imucalib_cli.cli.options import EstimatorOptions, KnownOptions, RecordingOptions
    from imucalib_cli.estimate.options import MatchedOptions, PaperOptions, PosePrior
    from imucalib_cli.jobs.input.request import CalibrationRequest, ExpectedImu
    from imucalib_cli.logs.reader import LogPath
    from imucalib_cli.results.requirement import Tolerance

PLANAR = (2,)
"""Components of the pose that driving on a plane does not determine, without the motion: tz."""


def calibration_request(
    ctx: typer.Context,
    logs: Sequence[LogPath],
    recording: RecordingOptions,
    estimator: EstimatorOptions,
    require: Tolerance | None = None,
) -> CalibrationRequest:
    """The request that the options make.

    Raises:
        ChoiceError: An option contradicts another or belongs to the other method, or there is no
            such IMU.
        InputError: The user's own data sheet cannot be used.
    """
    from imucalib_cli.jobs.input.request import CalibrationRequest, part_asked
    from imucalib_cli.signals.imu.units import Units

    asked: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in vars(recording).items()
        if name in CalibrationRequest.__struct_fields__ and value is not None
    }
    asked["parent"], asked["parents"] = _parents(recording.parents)
    units = Units(accel=recording.accel_unit, gyro=recording.gyro_unit, sign=recording.accel_sign)
    return CalibrationRequest(
        logs=tuple(logs),
        units=units,
        estimator=_estimator_options(ctx, estimator),
        imu=_expected_imu(estimator),
        require=require,
        part=part_asked(recording.part_from, recording.part_to),
        planar=estimator.planar,
        **asked,
    )


def _parents(given: Sequence[str]) -> tuple[str | None, tuple[tuple[str, str], ...]]:
    """The parent of all IMUs, and parents of single IMUs; ChoiceError where one has two."""
    of_all = [text for text in given if "=" not in text]
    of_one = [(imu, frame) for imu, _, frame in (t.rpartition("=") for t in given if "=" in t)]
    if len(of_all) > 1 or len(dict(of_one)) < len(of_one):
        raise ChoiceError(
            f"--parent {' --parent '.join(given)}: give one parent for each IMU; for one of "
            "several IMUs name its topic or frame_id: --parent IMU=FRAME"
        )
    return of_all[0] if of_all else None, tuple(of_one)


def options_given(ctx: typer.Context) -> dict[str, str]:
    """The options on the command line, each with the name of its parameter."""
    return {
        parameter.opts[-1]: parameter.name or ""
        for parameter in ctx.command.params
        if (source := ctx.get_parameter_source(parameter.name or "")) is not None
        and source.name == "COMMANDLINE"
    }


_MATCHED_ONLY = {
    *("fix", "planar", "prior_std", "base_imu"),
    *("statistics", "residuals", "debug_mcap", "plot", "kinematics_report"),
}
"""Parameters of the matched method beside the fields of its options."""
_OF_BOTH = {"gravity"}
"""Fields of one method's options whose parameter the other has too."""


def _estimator_options(
    ctx: typer.Context, estimator: EstimatorOptions
) -> MatchedOptions | PaperOptions:
    from imucalib_cli.estimate.options import MatchedOptions, PaperOptions

    is_matched = estimator.method == "matched"
    matched, paper = (set(signature(kind).parameters) for kind in (MatchedOptions, PaperOptions))
    others = paper - matched if is_matched else (matched - paper | _MATCHED_ONLY) - _OF_BOTH
    for option, name in options_given(ctx).items():
        if name in others:
            raise ChoiceError(
                f"{option} belongs to --method {'paper' if is_matched else 'matched'}: add that, "
                f"or leave {option} out"
            )
    options = MatchedOptions(**_given(estimator)) if is_matched else _published(estimator)
    samples = options.window.samples
    if samples is not None and samples <= options.degree:
        raise ChoiceError(
            f"--window of {samples} samples cannot smooth with --degree {options.degree}: "
            f"take at least {(options.degree + 1) | 1} samples"
        )
    return options


def changed_options(known: KnownOptions) -> Callable[[MatchedOptions], MatchedOptions]:
    """A function that replaces options of an earlier run by the options given now.

    Raises:
        ChoiceError: An option contradicts another.
    """
    given = _given(known, *(PLANAR if known.planar else ()))
    return lambda options: replace(options, **given)


def _given(known: KnownOptions, *more: int) -> dict[str, Any]:
    """Fields of MatchedOptions that are given; ``more`` components of the pose are fixed too."""
    from imucalib_cli.estimate.options import MatchedOptions

    if known.tilt_std is not None and known.gravity in {"fixed", "none"}:
        raise ChoiceError(f"--tilt-std has no effect with --gravity {known.gravity}: leave one out")
    given = given_fields(known, MatchedOptions)
    if isinstance(known.gravity, float):
        del given["gravity"]
        given |= {"gravity_norm": known.gravity, "gravity_std": 0.0}
    if known.base_std is not None:
        given["base_std"] = tuple(known.base_std)
    prior = _pose_prior(known, (*(known.fix or ()), *more))
    return given if prior is None else {**given, "pose": prior}


def _published(estimator: EstimatorOptions) -> PaperOptions:
    from imucalib_cli.estimate.options import PaperOptions

    if estimator.gravity == "tilt":
        raise ChoiceError("--gravity tilt belongs to --method matched: use fixed, none or a norm")
    given = given_fields(estimator, PaperOptions)
    if estimator.gravity not in {None, "fixed"}:
        given["gravity_norm"] = 0.0 if estimator.gravity == "none" else estimator.gravity
    if estimator.initial is not None:
        given |= {"R_initial": estimator.initial.R, "t_initial": estimator.initial.t}
    return PaperOptions(**given)


def given_fields(options: object, kind: type[Any]) -> dict[str, Any]:
    """Options that are given and that a type calls by the same name."""
    values = {name: getattr(options, name, None) for name in signature(kind).parameters}
    return {name: value for name, value in values.items() if value is not None}


def _pose_prior(estimator: KnownOptions, held: Sequence[int]) -> PosePrior | None:
    """The prior of the pose, with some components held; its place may come from the URDF later.

    --planar holds a component that is known only with the robot's motion.
    """
    from imucalib_cli.estimate.options import PosePrior

    std = list(estimator.prior_std or [math.inf] * 6)
    for place in held:
        std[place] = 0.0
    known = estimator.initial
    if all(map(math.isinf, std)) and not (estimator.planar and known):
        if known is not None:
            raise ChoiceError(
                "--initial belongs to --fix, --prior-std or --method paper: the matched method "
                "needs no guess, so leave it out"
            )
        return None
    R, t = (None, None) if known is None else known
    return PosePrior(std=tuple(std), R_parent_imu=R, t_parent_imu=t)


def _expected_imu(estimator: EstimatorOptions) -> ExpectedImu | None:
    """The IMU that the user names, with priors of the biases that no option gives."""
    name = estimator.imu_model
    if name is None:
        return None
    if name.startswith("/") and not name.endswith((".yaml", ".yml")):
        raise ChoiceError(
            f"--imu-model {name}: expected the name of an IMU such as bmi088, or a YAML file; "
            "--imu-topic takes a topic"
        )
    from imucalib_cli.jobs.input.request import ExpectedImu
    from imucalib_cli.signals.imu.data_sheet import load_imu_model

    stated = {"accel": estimator.accel_bias_std, "gyro": estimator.gyro_bias_std}
    priors: Any = tuple(sensor for sensor, std in stated.items() if std is None)
    return ExpectedImu(model=load_imu_model(imu_name(name)), priors=priors)
