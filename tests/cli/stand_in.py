"""A stand-in for the estimators, and answers of the commands that compare."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jsonschema
import numpy as np
import yaml

from imucalib_cli.errors import InputError
from imucalib_cli.estimate.entries import Unobservable
from imucalib_cli.findings import TEXT, warning
from tests.results.results_samples import make_estimate

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate
    from tests.conftest import Printed

ROOT = Path(__file__).parents[2]
ANSWERS = jsonschema.Draft202012Validator(
    json.loads((ROOT / "docs/comparison.schema.json").read_text())
)
ESTIMATE = make_estimate(
    R_parent_imu=np.eye(3),
    t_parent_imu=np.array([0.06, 0.0, 0.0]),
    covariance=np.diag([1e-8] * 3 + [1e-10] * 3),
    time_offset=0.012,
    findings=(warning(TEXT, text="the moon is full"),),
)
SIDEWAYS = Unobservable(
    kind="translation", direction_parent=[0.0, 1.0, 0.0], std=None, motion="roll"
)


class Estimator:
    """Stands in for the estimators and remembers what it was asked."""

    def __init__(self) -> None:
        self.estimate = ESTIMATE
        self.calls: list[tuple[Any, Any, Any]] = []
        self.fail_on: int | None = None

    def __call__(self, samples: Any, path: Any, options: Any, **_: Any) -> Estimate:
        self.calls.append((samples, path, options))
        if self.fail_on == len(self.calls):
            raise InputError("too short")
        return self.estimate

    @property
    def options(self) -> Any:
        return self.calls[-1][2]


def answers(printed: Printed) -> tuple[list[dict[str, Any]], str]:
    """Documents of an answer that keep to the schema, and the other messages."""
    documents = list(yaml.safe_load_all(printed.out))
    for document in documents:
        ANSWERS.validate(document)
    return documents, printed.err
