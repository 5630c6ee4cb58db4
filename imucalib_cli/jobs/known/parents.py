"""The link that carries an IMU: given by the user, or found from the IMU's own motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucalib_cli.diagnose.carrier import Carriers, find_carriers
from imucalib_cli.errors import ChoiceError, ImucalibError
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.jobs.input.motion import other_frames
from imucalib_cli.shown import meant
from imucalib_cli.signals.samples import samples_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.jobs.input.motion import Sources
    from imucalib_cli.jobs.input.request import CalibrationRequest
    from imucalib_cli.logs.streams import ImuStream
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples


def named_parent(imu: ImuStream, request: CalibrationRequest) -> str | None:
    """The parent that the user names for one IMU, if they do."""
    named = dict(request.parents)
    keys = (imu.name, imu.topic, imu.frame_id)
    return next((named[key] for key in keys if key in named), None)


def check_parents(imus: Sequence[ImuStream], request: CalibrationRequest) -> None:
    """Check that every IMU for which the user names a parent is in the log.

    Raises:
        ChoiceError: One is not.
    """
    known = {key for imu in imus for key in (imu.name, imu.topic, imu.frame_id)}
    for name, parent in request.parents:
        if name not in known:
            listed = ", ".join(f"{imu.name} (frame '{imu.frame_id}')" for imu in imus)
            raise ChoiceError(
                f"--parent {name}={parent}: no such IMU, but {listed}{meant(name, sorted(known))}"
            )


def find_parents(imu: ImuStream, sources: Sources, request: CalibrationRequest) -> Carriers:
    """Links that move as an IMU does."""
    frames, path_to = other_frames(sources, request)
    options = request.estimator
    if not isinstance(options, MatchedOptions):
        options = MatchedOptions()

    def repaired(path: KinematicPath) -> ImuSamples:
        samples = samples_of(imu, sources.clock)
        try:
            return request.repaired(samples, path).samples
        except ImucalibError:
            return samples

    return find_carriers(repaired, options, frames, path_to)


def with_answer(
    error: ImucalibError, carriers: Carriers, unread: tuple[str, ...] = ()
) -> ImucalibError:
    """An error that asks for the parent, with the links that the IMU's own motion suggests.

    ``unread`` are pose topics that were not read.
    """
    if error.reason is None:
        return error
    if carriers.links:
        moves = " or ".join(map(str, carriers.links))
        several = ", the log cannot tell which" if len(carriers.links) > 1 else ""
        parents = " or ".join(f"--parent {each.frame}" for each in carriers.links)
        text = f"{error.reason}; it moves like {moves}{several}: {parents}"
    elif carriers.still:
        text = (
            f"{error.reason}; it stands still while the robot moves, so that this log does not "
            "tell where it is: choose another --imu-topic, or record while what carries it moves"
        )
    elif unread:
        text = (
            f"{error.reason}, and no link moves as it does: if {' or '.join(unread)} has the pose "
            f"of the robot's base, read it too: --pose-topic {unread[0]}"
        )
    else:
        return error
    return ChoiceError(text, topic=error.topic, option=error.option)
