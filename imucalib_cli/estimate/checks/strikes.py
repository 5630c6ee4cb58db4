"""Strikes: short bursts of specific force far above the rest, as the feet of a walker make."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from imucalib_cli.findings import Finding, note
from imucalib_cli.signals.samples import STANDARD_GRAVITY
from imucalib_cli.signals.stretches import all_hold, stretches_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.estimate.solution.fit import Fit

_FORCE: Final = 5.0
"""Least specific force of a strike, relative to the log's median and to gravity: arms, drones and
whole vehicles stay below 5 g, but for a crash or a hole in the road."""
_LONGEST: Final = 0.1
"""s: what lasts longer is driven, not struck."""
_RINGING: Final = 0.05
"""s: bursts closer to each other are one strike."""
_SHARE: Final = 0.05
"""Of the windows, that have a strike: one strike in 4 s or so. A hole now and then is an outlier;
strikes that come with every step are a part of the motion."""


def strikes(topic: str, fit: Fit) -> Iterator[Finding]:
    """Strikes, if they are many, whether their windows fit the rest or not."""
    windowing = fit.model.windowing
    grid, plan = windowing.grid, windowing.plan
    force = np.linalg.norm(grid.accel, axis=1)
    least = _FORCE * max(float(np.median(force[grid.usable])), STANDARD_GRAVITY)
    quiet = stretches_of((force <= least) | ~grid.usable)
    ringing = quiet.where((quiet.lengths * grid.dt < _RINGING) & (quiet.first > 0))
    bursts = stretches_of(((force > least) & grid.usable) | ringing.mask(len(force)))
    bursts = bursts.where(bursts.lengths * grid.dt < _LONGEST)
    struck = ~all_hold(~bursts.mask(len(force)), fit.centres - plan.length // 2, plan.length)
    if struck.mean() > _SHARE:
        yield note(
            "imu.strikes",
            topic=topic,
            count=len(bursts),
            largest=float(force[bursts.mask(len(force))].max()),
            windows=int(struck.sum()),
            total=len(struck),
            left_out=int((struck & (fit.weights <= 0.0)).sum()),
        )
