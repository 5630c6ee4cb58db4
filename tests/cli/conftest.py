"""A stand-in for the estimators, and a recording for it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.cli.stand_in import Estimator

if TYPE_CHECKING:
    from pathlib import Path

    from tests.conftest import Imucalib, LogWriter


@pytest.fixture
def estimator(monkeypatch: pytest.MonkeyPatch) -> Estimator:
    fake = Estimator()
    monkeypatch.setattr("imucalib_cli.jobs.calibrate._estimate", fake)
    return fake


@pytest.fixture
def arm_log(log_writer: LogWriter) -> Path:
    return log_writer.imu().joints().text().write()


@pytest.fixture
def run_arm(imucalib: Imucalib, arm_log: Path, arm_urdf: Path) -> Imucalib:
    """`imucalib run` on that log, with options."""
    return imucalib.with_("run", arm_log, "--urdf", arm_urdf)
