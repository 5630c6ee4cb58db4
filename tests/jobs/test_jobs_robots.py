"""Robots of several shapes: the link that carries the IMU is found, and where the IMU is."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from imucalib_cli.errors import ChoiceError
from imucalib_cli.jobs.calibrate import calibrate
from imucalib_cli.jobs.request import CalibrationRequest
from tests.jobs.robots import SHAPES, random_mount, record
from tests.slow import slow_after

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("storage", slow_after(1, ["mcap2", "bag-lz4"]))
@pytest.mark.parametrize(
    "name", slow_after(1, sorted(SHAPES, key=lambda name: len(SHAPES[name].joints)))
)
def test_the_link_is_named_and_the_pose_found(name: str, storage: str, tmp_path: Path) -> None:
    shape, mount = SHAPES[name], random_mount(len(name))
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(shape.urdf())
    log = record(
        shape, tmp_path / "log", mount=mount, storage=storage, joint_prefix="r1_", seconds=20.0
    )
    request = CalibrationRequest(logs=(log,), urdf=urdf)
    (error,) = calibrate(request).failures
    assert isinstance(error, ChoiceError)
    joined = f" (rigidly joined: {', '.join(shape.alike)})" if shape.alike else ""
    assert str(error).endswith(f"moves like {shape.carrier}{joined}: --parent {shape.carrier}")

    request = CalibrationRequest(logs=(log,), urdf=urdf, parent=shape.carrier)
    (result,) = calibrate(request).results
    assert result.status == "ok"
    assert result.std is not None
    sigma = np.array(result.std.translation_mm, dtype=np.float64) / 1e3
    assert np.all(np.abs(result.pose.t - mount.translation) < 4.0 * sigma)
    assert sigma.max() < 5e-3
