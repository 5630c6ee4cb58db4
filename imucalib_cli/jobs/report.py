"""Render a report: from an outcome, a stored result, or a file of statistics."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.estimate.checks.segments import parts_of_log
from imucalib_cli.jobs.result_files import read_result_file
from imucalib_cli.report.figures import Material
from imucalib_cli.report.page import page
from imucalib_cli.results.statistics_file import read_statistics

if TYPE_CHECKING:
    from imucalib_cli.jobs.calibrate import Outcome


def report(outcome: Outcome) -> str:
    """HTML about every calibrated IMU, at least one; of a request with details."""
    materials = []
    for each in outcome.calibrated:
        stamps = {each.samples.topic: each.samples.t}
        stamps |= {track.name: track.t for track in each.motion.path.tracks}
        details = each.estimate.details
        materials.append(Material(result=each.result, details=details, stamps=stamps))
    return page(materials)


def report_of_file(name: str) -> str:
    """HTML of a stored result, ``-`` for standard input, or of a file of statistics.

    Some figures need the log and are left out.

    Raises:
        InputError: The file cannot be read or holds no result.
    """
    if not name.endswith(".npz"):
        return page([Material(result=result) for result in read_result_file(name)])
    log, stretches = read_statistics(Path(name)), None
    covariance = log.result.uncertain_pose.covariance
    if covariance is not None:
        stretches = parts_of_log(log.statistics, np.sqrt(np.diag(covariance)))
    spectra = log.statistics.spectra
    return page([Material(result=log.result, spectra=spectra, stretches=stretches)])
