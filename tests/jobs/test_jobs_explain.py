"""From files to the cause of a poor fit: the user's command is answered with the right one."""

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from imucalib_cli.diagnose.diagnose import diagnose
from imucalib_cli.diagnose.hypotheses import PoorFit
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.findings import warning
from imucalib_cli.jobs.calibrate import calibrate
from imucalib_cli.jobs.input.motion import Sources, find_motion, other_frames
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.logs.clock import Clock
from imucalib_cli.logs.part import Part
from imucalib_cli.robot.frames import Edge
from imucalib_cli.robot.path import Track
from imucalib_cli.signals.imu import repair
from imucalib_cli.signals.imu.units import Factor
from imucalib_cli.study.recordings import streams_of
from tests.simulate.simulate_samples import recorded

SAMPLES = Path(__file__).parents[2] / "sample_data"
LOG, URDF = SAMPLES / "rihibot.mcap", SAMPLES / "rihibot.urdf"


def test_imu_that_never_rests_is_not_refused_for_its_unit(monkeypatch: pytest.MonkeyPatch) -> None:
    """In eight of a thousand cuts of 30 s of hand-held motion, the calmest moments are no rest."""
    suspect = warning("imu.accel_unit_unknown", topic="/imu/data", norm=12.2)
    factor = Factor(unit="m/s2", value=1.0, finding=suspect)
    monkeypatch.setattr(repair, "accel_factor", lambda *_, **__: factor)
    log = SAMPLES / "broad_21_cut.mcap"
    request = CalibrationRequest(logs=(log,), parent="sensor_body", part=Part(end=15.0))
    (result,) = calibrate(request).results
    codes = [each.code for each in result.diagnostics.findings]
    assert "residual.beyond_noise" in codes  # so that a cause is searched for
    assert suspect.code not in codes
    assert result.status == "ok"


@pytest.mark.slow
@pytest.mark.parametrize("told", ["tool", "bar_link"])
def test_tf_frames_are_tried_like_links(told: str) -> None:
    imu, path = streams_of(recorded("barbot", duration=25.0, imu_rate=125, robot_rate=125))
    (track,) = path.tracks
    half = 0.4 * np.sin(1.3 * track.t)
    values = np.zeros((len(track.t), 7))
    values[:, 1], values[:, 4], values[:, 6] = 0.2, np.sin(half), np.cos(half)
    tool = Track(name="/tf (bar_link -> tool)", kind="pose", t=track.t, values=values)
    body = replace(track, name="/tf (world -> bar_link)")
    sources = Sources(
        clock=Clock(kind="header", origin_ns=0),
        joints=(),
        edges=(
            Edge(parent="world", child="bar_link", track=body),
            Edge(parent="bar_link", child="tool", track=tool),
        ),
        topics={body.name: "/tf", tool.name: "/tf"},
    )
    options = MatchedOptions(gravity="none")
    request = CalibrationRequest(logs=(), parent=told, estimator=options)
    motion = find_motion(sources, "imu_link", request)
    estimate = calibrate_matched(imu, motion.path, options)
    frames, path_to = other_frames(sources, request)
    case = PoorFit(
        samples=imu,
        path=motion.path,
        options=options,
        estimate=estimate,
        frames=frames,
        path_to=path_to,
    )
    if told == "bar_link":
        assert estimate.trusted
        assert diagnose(case) == ()
    else:
        assert not estimate.trusted
        (found,) = diagnose(case)
        assert found.values["names"] == ("bar_link",)
        assert "rerun with --parent bar_link" in found.message
