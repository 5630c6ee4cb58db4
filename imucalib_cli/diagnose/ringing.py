"""Does the IMU swing by itself, at one frequency, during and after motion?

A constant hum (fans, pumps) averages out of every window and is no fault. A mount or an arm that
is not rigid answers each move with its own frequency, which the encoders do not see.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from imucalib_cli.diagnose.alternatives import short_windows
from imucalib_cli.estimate.design import Model
from imucalib_cli.findings import Finding, warning
from imucalib_cli.signals.kernels import convolve_at

if TYPE_CHECKING:
    from imucalib_cli.estimate.fit import Lean

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

_SHORT = 0.03
"""s, of the windows that let vibration through."""
_FRAME = 1.0
"""s, of a spectrum: 1 Hz apart."""
_LOWEST, _HIGHEST = 2.5, 0.35
"""Hz, and share of the sample rate."""
_OVER_NEIGHBOURS = 4.0
"""Power of a line over the median of its surroundings."""
_SURROUNDINGS = 1.7
"""Ratio of frequencies."""
_COMES_AND_GOES = 9.0
"""Power of the line in its loudest frames over that in its faintest: a hum is constant."""
_OF_ROBOT = 0.4
"""Share of the line that the kinematics, noisy as they are, have at the same instants."""
_OF_ROBOT_KNOWN = 0.2
"""Noise of that share with which it is known well enough."""
_LEAST = {"accel": 0.01, "gyro": 0.0005}
"""m/s² and rad/s, amplitude worth a sentence."""
_LEAST_FRAMES = 12
"""Three seconds of motion: fewer tell no coming and going."""
_AXES = "xyz"


@dataclass(frozen=True, eq=False)
class _Spectra:
    """Power in each bin of each frame and axis of one sensor; a sine of amplitude a has a²/2."""

    f: Floats
    """(F,), Hz."""
    measured: Floats
    """(N, F, 3), parent-frame axes."""
    derived: Floats
    """(N, F, 3), by the kinematics."""
    shared: Complexes
    """(N, F, 3), cross power of the two."""

    def line(self) -> int | None:
        """Bin of the strongest narrow line that comes and goes and is not the robot's own."""
        power = self.measured.sum(axis=2).mean(axis=0)
        best: tuple[float, int] | None = None
        for index in range(1, len(self.f) - 1):
            if power[index] < max(power[index - 1], power[index + 1]):
                continue
            near = np.abs(np.log(self.f / self.f[index])) < np.log(_SURROUNDINGS)
            near &= np.abs(self.f - self.f[index]) > 1.5
            if not near.any():
                continue
            height = float(power[index] / max(float(np.median(power[near])), 1e-300))
            loud = self.measured[:, index - 1 : index + 2].sum(axis=(1, 2))
            faint, strong = np.percentile(loud, (10, 90))
            if (
                height > _OVER_NEIGHBOURS
                and strong > _COMES_AND_GOES * faint
                and not self._of_robot(slice(index - 1, index + 2))
                and (best is None or height > best[0])
            ):
                best = (height, index)
        return None if best is None else best[1]

    def _of_robot(self, line: slice) -> bool:
        """Whether the kinematics swing along, or are too noisy to tell."""
        own = float(self.measured[:, line].sum())
        share = abs(self.shared[:, line].sum()) / own
        count = self.measured[:, line].size / 4  # frames overlap
        noise = np.sqrt(float(self.derived[:, line].sum()) / own / count)
        return bool(share > _OF_ROBOT or noise > _OF_ROBOT_KNOWN)

    def centre(self, index: int) -> float:
        """Frequency of a line between bins, Hz."""
        part = slice(index - 1, index + 2)
        power = self.measured[:, part].sum(axis=(0, 2))
        return float(self.f[part] @ power / power.sum())

    def amplitude(self, index: int) -> tuple[float, int]:
        """Of a line in its loudest frames, and the axis on which it is largest."""
        power = self.measured[:, index - 1 : index + 2].sum(axis=1)
        strong = np.percentile(power.sum(axis=1), 90)
        return float(np.sqrt(2.0 * strong)), int(np.argmax(power.sum(axis=0)))


def find_ringing(lean: Lean) -> Finding | None:
    """Name the frequency at which the IMU rings after moves, if it does.

    Args:
        lean: The kinematics that explain the motion best, fitted.
    """
    for sensor, spectra in zip(("accel", "gyro"), _spectra(lean), strict=False):
        index = spectra.line()
        if index is None:
            continue
        amplitude, axis = spectra.amplitude(index)
        if amplitude < _LEAST[sensor]:
            continue
        return warning(
            "cause.rings",
            names=(),
            sizes=(spectra.centre(index), amplitude),
            sensor=sensor,
            axis=_AXES[axis],
            parent=lean.model.windowing.trajectory.path.parent,
        )
    return None


def _spectra(lean: Lean) -> tuple[_Spectra, ...]:
    """Of the accelerometer and the gyroscope; nothing where there are too few whole frames."""
    full, state = lean.model.windowing, lean.state
    grid = full.grid
    windowing = short_windows(full, _SHORT, hop=1)
    plan, model = windowing.plan, Model(windowing, lean.model.layout)
    centres = model.centres(state)
    size = 2 * round(_FRAME / grid.dt / 2)
    starts = np.arange(0, len(centres) - size, size // 4)
    starts = starts[centres[starts + size - 1] - centres[starts] == size - 1]
    if len(starts) < _LEAST_FRAMES:
        return ()
    (residuals,) = model.residuals(state, centres)
    f = np.asarray(np.fft.rfftfreq(size, grid.dt), dtype=np.float64)
    kept = (f > _LOWEST) & (f < _HIGHEST / grid.dt)
    found = []
    for values, left, pair in (
        (grid.accel, residuals.values[:, :3], plan.second_derivative),
        (grid.gyro, residuals.values[:, 3:], plan.first_derivative),
    ):
        measured = convolve_at(values, pair.average, centres - len(pair.average) // 2) @ state.R.T
        # What is measured and what is left over make what the kinematics say.
        M, D = (_transform(v, starts, size)[:, kept] for v in (measured, measured + left))
        found.append(_Spectra(f[kept], np.abs(M) ** 2, np.abs(D) ** 2, M.conj() * D))
    return tuple(found)


def _transform(values: Floats, starts: NDArray[np.intp], size: int) -> Complexes:
    """Spectra of frames, (N, F, 3), scaled so that squares are powers."""
    window = np.hanning(size)
    frames = sliding_window_view(values, size, axis=0)[starts]
    frames = frames - frames.mean(axis=-1, keepdims=True)
    spectra = np.fft.rfft(frames * window, axis=-1) * np.sqrt(2.0 / (size * float(window @ window)))
    return np.asarray(np.moveaxis(spectra, 1, 2))
