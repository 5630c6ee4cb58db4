"""``--require``: a result whose sigma is larger than required is not trusted."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.findings import untrusted
from imucalib_cli.results.pose import POSE_PARTS
from imucalib_cli.tree import plain

if TYPE_CHECKING:
    from imucalib_cli.estimate.entries import Kind
    from imucalib_cli.estimate.estimate import Estimate

_WORTH_RECORDING = 100.0
"""Times the duration, beyond which a longer log is no advice."""


class Tolerance(Struct, frozen=True, kw_only=True):
    """A bound on translation and on rotation; infinite where none is given."""

    translation: float = math.inf
    """m."""
    rotation: float = math.inf
    """rad."""

    def of(self, kind: Kind) -> float:
        """The bound on one of the two."""
        return self.translation if kind == "translation" else self.rotation

    def words_of(self, kind: Kind) -> str:
        """Such as ``5 mm`` or ``0.5 deg``."""
        _, unit, scale = POSE_PARTS[kind]
        return f"{self.of(kind) * scale:.6g} {unit}"

    def __str__(self) -> str:
        """Such as ``5 mm and 0.5 deg``."""
        return f"{self.words_of('translation')} and {self.words_of('rotation')}"


def require(estimate: Estimate, parent: str, tolerance: Tolerance) -> Estimate:
    """Distrust an estimate whose largest 1 sigma over the parent's axes exceeds a tolerance.

    A method that states no covariance cannot meet a requirement, so it is distrusted too.
    """
    if estimate.covariance is None:
        bounds = {kind: plain(tolerance.of(kind)) for kind in POSE_PARTS}
        finding = untrusted("require.no_sigma", **bounds, method=estimate.method)
        return replace(estimate, findings=(*estimate.findings, finding))
    stds = np.sqrt(np.diag(estimate.covariance))
    missed: dict[str, float | str] = {}
    excess = 1.0
    for kind, (part, *_) in POSE_PARTS.items():
        std, bound = stds[part], tolerance.of(kind)
        # negated comparison, so that a sigma that is not a number does not pass
        if not float(np.max(std)) <= bound:
            axis = int(np.argmax(np.nan_to_num(std, nan=np.inf)))
            worst = float(std[axis])
            missed |= {kind: bound, f"{kind}_sigma": worst, f"{kind}_axis": "xyz"[axis]}
            excess = max(excess, worst / bound if math.isfinite(worst) else math.inf)
    if not missed:
        return estimate
    longer = max(excess**2, 1.1)
    remedy: dict[str, str | float | None] = {"remedy": "faster", "longer": None}
    if estimate.unobservable:
        remedy["remedy"] = "motion"
    elif longer <= _WORTH_RECORDING:
        remedy = {"remedy": "longer", "longer": longer}
    finding = untrusted("require.sigma", parent=parent, **remedy, **missed)
    return replace(estimate, findings=(*estimate.findings, finding))
