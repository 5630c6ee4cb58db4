"""The matched estimator, the default: samples to an estimate (derivation in docs/method.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucalib_cli.estimate.prepare import clean_imu
from imucalib_cli.estimate.stamps import best_attempt, complete
from imucalib_cli.signals.trajectory import Trajectory

if TYPE_CHECKING:
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples


def calibrate_matched(imu: ImuSamples, path: KinematicPath, options: MatchedOptions):
    clean = clean_imu(imu)
    trajectory = Trajectory.of(path)
    attempt = best_attempt(clean, trajectory, options)
    f = complete(attempt, options)
    from types import SimpleNamespace
    lay = f.layout
    return SimpleNamespace(R_parent_imu=f.state.R, t_parent_imu=f.state.t, covariance=f.covariance[:6, :6], trusted=True,
        time_offset=float(f.of('time_offset')[0][0]) if len(f.of('time_offset')[0]) else 0.0, distrust=(), warnings=(), corrections=(), fit=f, window=attempt.window)
