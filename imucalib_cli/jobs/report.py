"""From what a run leaves, or from a result alone, to a page to look at."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.estimate.again import stretches_of
from imucalib_cli.jobs.result_files import read_result_file
from imucalib_cli.report.figures import Material
from imucalib_cli.report.page import page
from imucalib_cli.results.statistics_file import read_statistics

if TYPE_CHECKING:
    from imucalib_cli.jobs.calibrate import Calibrated, Outcome
    from imucalib_cli.results.statistics_file import StoredLog


def report(outcome: Outcome) -> str:
    """HTML about every IMU that could be calibrated, at least one; of a request with details."""
    return page([_material(each) for each in outcome.calibrated])


def report_of_file(name: str) -> str:
    """HTML of a stored result, ``-`` for standard input, or of a file of statistics.

    What is not in it needs the log.

    Raises:
        InputError: The file cannot be read or holds no result.
    """
    if name.endswith(".npz"):
        return page([_of_statistics(read_statistics(Path(name)))])
    return page([Material(result=result) for result in read_result_file(name)])


def _of_statistics(log: StoredLog) -> Material:
    covariance = log.result.uncertain_pose.covariance
    return Material(
        result=log.result,
        spectra=log.statistics.spectra,
        stretches=None
        if covariance is None
        else stretches_of(log.statistics, np.sqrt(np.diag(covariance))),
    )


def _material(calibrated: Calibrated) -> Material:
    samples, tracks = calibrated.samples, calibrated.motion.path.tracks
    return Material(
        result=calibrated.result,
        details=calibrated.estimate.details,
        stamps={samples.topic: samples.t} | {track.name: track.t for track in tracks},
    )
