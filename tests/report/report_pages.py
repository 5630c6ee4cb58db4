"""Pages of sample recordings, made once for all tests of the report."""

import json
import re
from functools import cache
from pathlib import Path
from typing import Any

from imucalib_cli.jobs.calibrate import Outcome, calibrate
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.jobs.report import report

SAMPLE = Path(__file__).parents[2] / "sample_data"


REQUEST = CalibrationRequest(
    logs=(SAMPLE / "rihibot.mcap",), urdf=SAMPLE / "rihibot.urdf", details=True
)


@cache
def outcome(name: str) -> Outcome:
    """Of a sample: an arm by its joints, or a tracked body."""
    if name == "rihibot":
        return calibrate(REQUEST)
    log = next(SAMPLE.glob(f"{name}.*[gp]"))
    return calibrate(CalibrationRequest(logs=(log,), parent="sensor_body", details=True))


@cache
def page_of(name: str) -> str:
    """Its report."""
    return report(outcome(name))


def data_of(page: str) -> dict[str, Any]:
    """What the page's script draws."""
    (text,) = re.findall(
        r'<script id="data" type="application/json">(.*?)</script>', page, re.DOTALL
    )
    found: dict[str, Any] = json.loads(text)
    return found
