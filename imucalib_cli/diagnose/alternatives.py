"""One criterion for every gross alternative: the same lean fit, and the evidence for it.

Each alternative changes the path, the time offset or the readings by one fault, and is fitted like
what was given. The one with the most evidence is named if that is decisive and if it explains as
well as a right model, together with all those that the log cannot distinguish from it.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Final, get_args

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.diagnose import edits
from imucalib_cli.diagnose.hypotheses import (
    Hypothesis,
    Kind,
    double_faults,
    other_bases,
    single_faults,
)
from imucalib_cli.diagnose.sensor_axes import reoriented
from imucalib_cli.errors import InputError
from imucalib_cli.estimate.attempts import best_attempt
from imucalib_cli.estimate.effects import JointCurve
from imucalib_cli.estimate.model.kinematic_noise import own_noise
from imucalib_cli.estimate.model.windows import Windowing
from imucalib_cli.estimate.solution.fit import MIN_WINDOWS, lean_fit, whole_fit
from imucalib_cli.estimate.solution.scales import DECISIVE
from imucalib_cli.estimate.unknowns import LEAN, TABLE, Unknown
from imucalib_cli.signals.offset import coarse_time_offset
from imucalib_cli.signals.prepare import clean_imu
from imucalib_cli.signals.timing.lag import LEAST_OVERLAP
from imucalib_cli.signals.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.diagnose.hypotheses import PoorFit
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.estimate.solution.fit import Fit
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.prepare import CleanImu
    from imucalib_cli.signals.samples import ImuSamples


_SECONDS: Final = 60.0
"""s: the liveliest stretch of so long is enough to find gross faults."""
_FAR: Final = 60.0
"""s: largest difference of stamps that is searched. Clocks set by hand differ by less, or by
hours."""
_STRETCH: Final = 5.0
"""s: half of the range of one search for the offset: moves look alike, and the best correlation of
all may be that of the wrong move."""
_GOOD: Final = (0.1, 0.03)
"""Shares of acceleration and rotation that a right model, with the worst sensor and robot that are
sold, leaves unexplained."""
_ALIKE: Final = 0.1
"""Share of the rotation that the right link leaves on a robot three times as bad as that."""
_NOISES: Final = 3.0
"""Residuals up to so many times the sensor's own noise are good, whatever their share. Tuned."""
_FALL: Final = 2.0
"""Least fall of one sensor's residual: a cause that leaves half of it is not the cause. Tuned."""
_FAR_FALL: Final = 5.0
"""Least fall of all residuals that contradict what was given from which a cause is named though it
leaves more than a right model does: a further error, as of slow motion, does not excuse so much.
Tuned."""
_WHOLE: Final = 4
"""How many hypotheses are fitted with every unknown, where none is good without: each costs as much
as the log's own fit."""
_KEPT: Final[dict[Kind | None, int]] = {
    "zero": 4,
    "offset": 5,
    "base_frame": 4,
    "base_clock": 3,
    None: 8,
}
"""How many hypotheses are fitted, of those whose rates correlate most with the IMU's: each costs a
lean fit."""
_SAME_RATES: Final = frozenset({"offset", "inverse", "conjugate", "unit", "base_sign"})
"""Kinds that may leave the rates as given, so that their correlation says nothing."""


def _zero(joint: str | None) -> Unknown:
    """The zero of one joint, or of each, with a wide prior."""
    entry, effect = next(
        (each, each.effect)
        for each in TABLE
        if each.name == "joint_zero" and isinstance(each.effect, JointCurve)
    )
    return replace(entry, std=1.0, scale=None, effect=replace(effect, only=joint))


class Trial(Struct, frozen=True, eq=False, dict=True):
    """How well one model explains the IMU."""

    hypothesis: Hypothesis
    fit: Fit

    @cached_property
    def left(self) -> Floats:
        """(2,), residual of a window, m/s² and rad/s, trimmed root mean square."""
        values = self.fit.windows.residuals.values
        return np.array([trimmed_rms(values[:, :3]), trimmed_rms(values[:, 3:])])

    @cached_property
    def total(self) -> Floats:
        """(2,), what the kinematics say: acceleration without gravity, and rotation."""
        moves = self.fit.windows.residuals
        return np.array([trimmed_rms(moves.acceleration), trimmed_rms(moves.rate)])

    @property
    def noise(self) -> Floats:
        """(2,), residual of a window by the sensor's own white noise."""
        return own_noise(self.fit.model.windowing)

    @property
    def shares(self) -> Floats:
        """(2,), share of the acceleration and of the rotation left unexplained."""
        return self.left / np.maximum(self.total, _NOISES * self.noise)

    @property
    def offset(self) -> float:
        """IMU stamp - robot stamp, s."""
        return self.fit.model.shifts(self.fit.state)[1][0]

    @property
    def explains(self) -> Bools:
        """(2,), whether it explains acceleration and rotation as well as a right model."""
        return np.asarray((self.shares < _GOOD) | (self.left < _NOISES * self.noise))

    @property
    def good(self) -> bool:
        """Whether it explains both."""
        return bool(self.explains.all())

    @property
    def turns_alike(self) -> bool:
        """Whether it explains the rotation, which a wrong link does not."""
        return bool(self.shares[1] < _ALIKE)

    def falls_from(self, given: Trial) -> bool:
        """Whether it is decisively better than what was given."""
        falls = self._falls(given)
        return bool(falls.max() > _FALL) and self.fit.evidence_over(given.fit) > DECISIVE

    def falls_far_from(self, given: Trial) -> bool:
        """Whether it explains most of all that contradicts what was given."""
        far = self._falls(given) > _FAR_FALL
        return bool((far | given.explains).all()) and not given.good and self.falls_from(given)

    def _falls(self, given: Trial) -> Floats:
        return np.asarray(np.hypot(given.left, self.noise) / np.hypot(self.left, self.noise))


class Fitter(Struct, frozen=True, eq=False):
    """The liveliest stretch of an IMU, and the windows in which alternatives are fitted."""

    options: MatchedOptions
    windowing: Windowing
    """As given."""

    def trajectory(self, path: KinematicPath) -> Trajectory:
        """Trajectory of a path, its stamps taken as those of the path as given.

        Raises:
            InputError: A track has too few usable samples.
        """
        return Trajectory.of(path).with_ticks(self.windowing.trajectory.use_ticks)

    def coarse(
        self, path: KinematicPath, about: float = 0.0, most: float | None = None
    ) -> tuple[float, float]:
        """Coarse time offset, s, and the correlation of the rates at it, whatever the mount.

        It is searched within ``most`` of ``about``, s; by default as far as the options say.

        Raises:
            InputError: A track has too few usable samples.
        """
        grid = replace(self.windowing.grid, t0=self.windowing.grid.t0 - about)
        most = self.options.max_offset if most is None else most
        (offset, *_), lag = coarse_time_offset(grid, self.trajectory(path), most)
        return about + offset, -1.0 if lag is None else lag.correlation

    def trials(self, hypotheses: Iterable[tuple[Hypothesis, float]]) -> Iterator[Trial]:
        """Fit hypotheses, each from a time offset on, where enough windows are shared."""
        for hypothesis, offset in hypotheses:
            trial = self._trial(hypothesis, offset)
            if trial is not None:
                yield trial

    def _trial(self, hypothesis: Hypothesis, offset: float) -> Trial | None:
        grid = self.windowing.grid
        if hypothesis.accel is not None and hypothesis.gyro is not None:
            grid = replace(
                grid, accel=grid.accel @ hypothesis.accel.T, gyro=grid.gyro @ hypothesis.gyro.T
            )
        options = self.options
        if self.windowing.trajectory.path.base_imu is None:
            options = options.along(hypothesis.path)
        table = (*LEAN, _zero(hypothesis.names[0])) if hypothesis.kind == "zero" else LEAN
        try:
            windowing = Windowing(grid, self.trajectory(hypothesis.path), self.windowing.plan)
            lean = lean_fit(windowing, options, offset, table, rough=True)
            rough = Trial(hypothesis, lean)
            if rough.good or (hypothesis.kind == "link" and rough.turns_alike):
                # A better fit could make it decisive.
                lean = lean_fit(windowing, options, lean, table)
        except InputError:
            return None
        if hypothesis.kind == "zero":
            found = lean.of("joint_zero")
            zero = hypothesis.sizes[0] + found[0].sum()
            sizes, detail = (float(np.angle(np.exp(1j * zero))),), (float(found[1].sum()),)
            hypothesis = replace(hypothesis, sizes=sizes, detail=detail)
        if hypothesis.kind == "base_clock":
            later = hypothesis.sizes[0] + float(lean.of("base_time_offset")[0].sum())
            hypothesis = replace(hypothesis, sizes=(later,))
        return Trial(hypothesis, lean)


def trimmed_rms(values: Floats) -> float:
    """Root mean square size of rows without the largest 5 %, which are contacts and shocks."""
    squares = np.sort((values**2).sum(axis=1))
    return float(np.sqrt(np.mean(squares[: max(int(len(squares) * 0.95), 1)])))


def given_trial(
    samples: ImuSamples,
    path: KinematicPath,
    options: MatchedOptions,
    *,
    reversed_accel: bool = False,
) -> tuple[Fitter, Trial]:
    """Fit what was given to the liveliest stretch of the log.

    With ``reversed_accel`` the accelerometer's readings have the other sign.

    Raises:
        InputError: Too few usable samples or windows.
    """
    # A pose known in one link says nothing in another, and holding it would shift the blame.
    options = replace(options, pose=None, robot="nominal", either_sign=False)
    clean = _liveliest(clean_imu(samples))
    if reversed_accel:
        clean = clean.reversed()
    attempt = best_attempt(clean, Trajectory.of(path), options)
    given = Trial(Hypothesis(kind="offset", path=path), attempt.lean)
    # A time offset that is given may be what is wrong.
    return Fitter(replace(options, time_offset=None), attempt.lean.model.windowing), given


def _liveliest(clean: CleanImu) -> CleanImu:
    """The stretch with the most motion."""
    imu = clean.samples
    t = imu.t
    if t[-1] - t[0] <= _SECONDS:
        return clean
    turning, pushing = (
        ((values - np.median(values, axis=0)) ** 2).sum(axis=1) for values in (imu.gyro, imu.accel)
    )
    # Rotation says more: half of the acceleration is gravity that turns.
    life = turning / max(turning.mean(), 1e-12) + 0.2 * pushing / max(pushing.mean(), 1e-12)
    so_far = np.concatenate([[0.0], np.cumsum(life)])
    starts = np.arange(0, len(t), max(len(t) // 400, 1))
    ends = np.searchsorted(t, t[starts] + _SECONDS)
    best = int(np.argmax(so_far[ends] - so_far[starts]))
    begin = t[starts[best]]
    return clean.at((t >= begin) & (t <= begin + _SECONDS))


def explaining(fitter: Fitter, poor: PoorFit, given: Trial) -> tuple[list[Trial], Trial]:
    """Alternatives that explain decisively: the best, and those the log cannot distinguish from it.

    Where what was given is good, only single faults count.

    Returns:
        The alternatives, and what was given, with the same unknowns.
    """
    single = [*_tried(fitter, single_faults(poor), given)]
    single += fitter.trials(_slight(fitter, poor, given))
    found = _best(given, single)
    if found or given.good:
        return found, given
    links = (trial for trial in single if trial.hypothesis.kind == "link" and trial.turns_alike)
    found = (
        _best(given, _tried(fitter, double_faults(poor), given))
        or _most_likely([each for each in links if each.falls_from(given)], given)
        # With another base fewer joints can be wrong, so it explains other faults too.
        or _best(given, _tried(fitter, other_bases(poor), given))[:1]
        or _most_likely([trial for trial in single if trial.falls_far_from(given)], given)
    )
    better = [trial for trial in single if trial.falls_from(given)]
    if found or not better:
        return found, given
    # With every unknown: further errors, of a robot that bends say, may hide a right model.
    better.sort(key=lambda trial: trial.fit.evidence_over(given.fit), reverse=True)
    given, *whole = (
        replace(trial, fit=whole_fit(trial.fit, trial.fit.options))
        for trial in (given, *better[:_WHOLE])
    )
    return _best(given, whole), given


def alike(fitter: Fitter, hypotheses: Iterable[Hypothesis], given: Trial) -> list[Trial]:
    """Of what was given and alternatives those that explain best: one, or several that tie.

    Where none explains as well as a right model, those under which the robot turns like the IMU.
    """
    trials = [given, *_tried(fitter, hypotheses, given)]
    good = [trial for trial in trials if trial.good]
    return _most_likely(good or [trial for trial in trials if trial.turns_alike], given)


def _slight(fitter: Fitter, poor: PoorFit, given: Trial) -> Iterator[tuple[Hypothesis, float]]:
    """Faults whose size is found by a fit: a zero that is a little off, and the sensors' axes."""
    offset, _ = fitter.coarse(poor.path)
    found, centres = [_small_zero(fitter, poor, offset)], fitter.windowing.centres(offset)
    if len(centres) >= MIN_WINDOWS:
        rows = fitter.windowing.rows(offset, centres[:: max(len(centres) // 150, 1)])
        found.append(reoriented(rows, poor.path, given.fit.state.gravity))
    for hypothesis in found:
        if hypothesis is not None:
            yield hypothesis, fitter.coarse(hypothesis.path)[0]


def _best(given: Trial, trials: Iterable[Trial]) -> list[Trial]:
    explaining = [trial for trial in trials if trial.good and trial.falls_from(given)]
    found = _most_likely(explaining, given)
    # Each trial frees the offset: with another one too, a fault explains nothing beside it.
    if any(trial.hypothesis.kind == "offset" for trial in found):
        found = [
            trial
            for trial in found
            if trial.hypothesis.kind == "offset" or _searched(given, trial.offset)
        ]
    return found


def _most_likely(trials: list[Trial], given: Trial) -> list[Trial]:
    """The trial with most evidence, and those that the log cannot distinguish from it."""
    if not trials:
        return []
    best = max(trials, key=lambda trial: trial.fit.evidence_over(given.fit))
    ties = [trial for trial in trials if best.fit.evidence_over(trial.fit) < DECISIVE]
    ties.sort(key=lambda trial: get_args(Kind).index(trial.hypothesis.kind))
    # The same zero is reached from several angles.
    distinct: dict[tuple[str, tuple[str, ...]], Trial] = {}
    for trial in ties:
        distinct.setdefault((trial.hypothesis.kind, trial.hypothesis.names), trial)
    return list(distinct.values())


def _tried(fitter: Fitter, hypotheses: Iterable[Hypothesis], given: Trial) -> Iterator[Trial]:
    for hypothesis, offset in _screened(fitter, hypotheses):
        if hypothesis.kind == "offset":
            yield from _other_offsets(fitter, hypothesis, given)
        else:
            yield from fitter.trials([(hypothesis, offset)])


def _screened(
    fitter: Fitter, hypotheses: Iterable[Hypothesis]
) -> Iterator[tuple[Hypothesis, float]]:
    """Hypotheses under which the robot turns as fast as the IMU, each with its time offset."""
    ranked: dict[Kind | None, list[tuple[float, Hypothesis, float]]] = {}
    for hypothesis in hypotheses:
        try:
            offset, alike = fitter.coarse(hypothesis.path)
        except InputError:
            continue
        if hypothesis.kind in _SAME_RATES:
            yield hypothesis, offset
        else:
            group = hypothesis.kind if hypothesis.kind in _KEPT else None
            ranked.setdefault(group, []).append((alike, hypothesis, offset))
    for group, some in ranked.items():
        some.sort(key=lambda one: -one[0])
        for _, hypothesis, offset in some[: _KEPT[group]]:
            yield hypothesis, offset


def _other_offsets(fitter: Fitter, hypothesis: Hypothesis, given: Trial) -> Iterator[Trial]:
    """Trials at time offsets beyond those that were searched."""
    found = []
    for centre in np.arange(-_FAR, _FAR + 1.0, 2.0 * _STRETCH):
        offset, alike = fitter.coarse(hypothesis.path, float(centre), _STRETCH)
        robot = np.array(fitter.windowing.trajectory.span) + offset
        imu = fitter.windowing.grid.t[[0, -1]]
        shared = min(robot[1], imu[1]) - max(robot[0], imu[0])
        enough = shared > LEAST_OVERLAP * min(np.ptp(robot), np.ptp(imu))
        if enough and not _searched(given, offset):
            found.append((alike, offset))
    found.sort(reverse=True)
    asked = given.fit.options
    detail = (asked.time_offset, asked.max_offset)
    for trial in fitter.trials((hypothesis, offset) for _, offset in found[: _KEPT["offset"]]):
        if not _searched(given, trial.offset):
            moved = replace(hypothesis, sizes=(trial.offset,), detail=detail)
            yield replace(trial, hypothesis=moved)


def _searched(given: Trial, offset: float) -> bool:
    """Whether the fit as given could have found this time offset."""
    asked = given.fit.options
    if asked.time_offset is not None:
        return abs(offset - asked.time_offset) < 1e-3
    return abs(offset) <= asked.max_offset or abs(offset - given.offset) < _STRETCH / 100.0


def _small_zero(fitter: Fitter, poor: PoorFit, offset: float) -> Hypothesis | None:
    """The joint whose zero is farthest off if all zeros are free."""
    try:
        lean = lean_fit(fitter.windowing, fitter.options, offset, table=(*LEAN, _zero(None)))
    except InputError:
        return None
    found = {
        placed.labels[0]: float(lean.state.x[placed.part][0])
        for placed in lean.model.layout.placed
        if isinstance(placed.unknown.effect, JointCurve)
    }
    name = max(found, key=lambda name: abs(found[name]), default=None)
    if name is None:
        return None
    turned = edits.with_zero(poor.path, name, found[name])
    return Hypothesis(kind="zero", names=(name,), sizes=(found[name],), path=turned)
