"""A recording for the stand-in of the estimators."""

import shutil
from pathlib import Path

import pytest

from tests.conftest import Imucalib, LogWriter


@pytest.fixture(scope="session")
def arm_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return LogWriter(tmp_path_factory.mktemp("arm") / "log").imu().joints().text().write().parent


@pytest.fixture
def arm_log(arm_recording: Path, tmp_path: Path) -> Path:
    """A copy, which a test may change."""
    (log,) = shutil.copytree(arm_recording, tmp_path / "recording").glob("*.mcap")
    return log


@pytest.fixture
def run_arm(imucalib: Imucalib, arm_log: Path, arm_urdf: Path) -> Imucalib:
    """`imucalib run` on that log, with options."""
    return imucalib.with_("run", arm_log, "--urdf", arm_urdf)
