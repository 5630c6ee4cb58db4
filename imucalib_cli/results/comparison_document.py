"""The answers of ``verify`` and ``diff`` as plain documents, numbers finite or null."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.results.calibration import SCHEMA
from imucalib_cli.results.difference_words import UNITS
from imucalib_cli.results.document import file_entry, number, pose_entry, to_document, vector_entry

if TYPE_CHECKING:
    from imucalib_cli.results.calibration import Tolerance
    from imucalib_cli.results.difference import Difference, Part, Significance
    from imucalib_cli.results.document import Document
    from imucalib_cli.results.movement import Comparison, Side
    from imucalib_cli.results.verification import Verification


def verification_document(verification: Verification) -> Document:
    """Keys and order of docs/comparison.schema.json, ``comparison: verify``."""
    found = to_document(verification.calibration)
    apart, told = verification.difference, verification.told
    return {
        "schema": SCHEMA,
        "comparison": "verify",
        "verdict": verification.verdict,
        "reason": verification.reason,
        "parent": verification.calibration.parent,
        "child": verification.calibration.child,
        "within": _within(verification.within),
        "translation": {
            "verdict": verification.translation,
            **part_entry(apart, apart.translation),
        },
        "rotation": {"verdict": verification.rotation, **part_entry(apart, apart.rotation)},
        "significance": _strongest(apart),
        "told": {
            "joint": told.joint,
            **pose_entry(told.R_parent_imu, told.t_parent_imu),
            "urdf": None if verification.urdf is None else file_entry(verification.urdf),
        },
        "found": found,
    }


def comparison_document(comparison: Comparison) -> Document:
    """Keys and order of docs/comparison.schema.json, ``comparison: diff``."""
    apart = comparison.difference
    covariance = apart.covariance
    return {
        "schema": SCHEMA,
        "comparison": "diff",
        "verdict": comparison.verdict,
        "reason": comparison.reason,
        "parent": comparison.parent,
        "child": comparison.child,
        "within": None if comparison.within is None else _within(comparison.within),
        "translation": part_entry(apart, apart.translation),
        "rotation": part_entry(apart, apart.rotation),
        "significance": _strongest(apart),
        "test": test_entry(comparison.significance),
        "covariance": None if covariance is None else [vector_entry(row) for row in covariance],
        "warnings": list(comparison.warnings),
        "first": _side(comparison.first),
        "second": _side(comparison.second),
    }


def _within(within: Tolerance) -> Document:
    return {
        "translation_mm": number(within.translation * 1e3),
        "rotation_deg": number(math.degrees(within.rotation)),
    }


def part_entry(apart: Difference, part: Part) -> Document:
    """Translation or rotation of a difference."""
    unit, scale = UNITS[part.kind]
    bounds = None if part.bounds is None else vector_entry(np.array(part.bounds) * scale)
    std = None if part.covariance is None else np.sqrt(np.diag(part.covariance)) * scale
    return {
        f"difference_{unit}": number(part.norm * scale),
        f"sigma_{unit}": None if part.sigma is None else number(part.sigma * scale),
        f"between_{unit}": bounds,
        f"vector_{unit}": vector_entry(part.vector * scale),
        f"std_{unit}": None if std is None else vector_entry(std),
        "unknown_directions": [vector_entry(direction) for direction in part.unknown],
        "test": test_entry(apart.significance(part)),
    }


def test_entry(test: Significance | None) -> Document | None:
    """A chi-squared test, if there is one."""
    if test is None:
        return None
    return {
        "chi2": number(test.chi2),
        "degrees_of_freedom": test.freedom,
        "p_value": number(test.p_value),
    }


def _strongest(apart: Difference) -> Document | None:
    """How many sigma the difference is, and which part is so many."""
    told = [
        (part.norm / part.sigma if part.sigma > 0.0 else math.inf, part.kind)
        for part in apart.parts
        if part.sigma is not None and part.meaningful
    ]
    if not told:
        return None
    sigmas, kind = max(told)
    return {"of": kind, "sigmas": number(sigmas)}


def _side(side: Side) -> dict[str, Any]:
    calibration = side.calibration
    provenance = calibration.provenance
    return {
        "file": side.name,
        "status": calibration.status,
        "parent": calibration.parent,
        "child": calibration.child,
        "imu": provenance.imu_topic,
        "logs": [file_entry(file) for file in provenance.files],
    }
