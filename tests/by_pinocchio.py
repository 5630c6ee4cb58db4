"""Motion of frames by pinocchio: truth that owes nothing to the package."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from msgspec import Struct

from imucalib_cli.arrays import Floats


class Motion(Struct, frozen=True, kw_only=True, eq=False):
    """A frame: pose in the world, rates and classical acceleration in its own axes."""

    R: Floats
    p: Floats
    omega: Floats
    alpha: Floats
    acceleration: Floats


def follow(model: Any, frames: Sequence[int], q: Floats, v: Floats, a: Floats) -> list[Motion]:
    """The motion of frames of a model through configurations, velocities and accelerations."""
    data, R = model.createData(), np.empty((len(frames), len(q), 3, 3))
    vectors = np.empty((4, len(frames), len(q), 3))
    for k in range(len(q)):
        pin.forwardKinematics(model, data, q[k], v[k], a[k])
        pin.updateFramePlacements(model, data)
        for n, frame in enumerate(frames):
            R[n, k] = data.oMf[frame].rotation
            vectors[:, n, k] = (
                data.oMf[frame].translation,
                pin.getFrameVelocity(model, data, frame, pin.LOCAL).angular,
                pin.getFrameAcceleration(model, data, frame, pin.LOCAL).angular,
                pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL).linear,
            )
    return [
        Motion(R=R[n], p=p, omega=omega, alpha=alpha, acceleration=acceleration)
        for n, (p, omega, alpha, acceleration) in enumerate(vectors.swapaxes(0, 1))
    ]
