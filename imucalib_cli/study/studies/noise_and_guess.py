"""Tables 2 and 3: calibrations on folds of moves, each with several seeds.

Whole moves of the plan are held out, not samples. Table 2 (section 4.4 of the paper) varies the
noise of the IMU. Its open question is why errors grow on the arm and not on the bar. It is put to
the test by stamps that are late by less and by more than a sample period, with and without gravity,
and by bars of other inertia. Table 3 (section 4.5) varies the error of the initial guess.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import chain, cycle, pairwise
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.simulate.config import Arm, FreeBody
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import NoiseOptions, Vector
from imucalib_cli.simulate.recording import Record, rows_kept
from imucalib_cli.study.experiment import Section, grid
from imucalib_cli.study.method_runs import (
    METHODS,
    OURS,
    PUBLISHED,
    Recorded,
    paper_settings,
    run_methods,
    setting_words,
    wrong_guess,
)
from imucalib_cli.study.recordings import clean_recording
from imucalib_cli.study.tables import (
    DEGREES,
    ERROR_COLUMNS,
    MILLIMETRES,
    Claim,
    Column,
    answered,
    chosen,
    column,
    count,
    digits,
    exceeds,
    in_best_setting,
    mean,
    mean_error,
    number,
    text,
    worst,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from imucalib_cli.simulate.config import SystemConfig
    from imucalib_cli.simulate.recording import Recording
    from imucalib_cli.study.experiment import Cell
    from imucalib_cli.study.tables import Row

ARM, BAR = "rihibot", "barbot"
JUDGED = "paper, components"
"""The method whose figures answer the open question: its minimum is the same from every guess."""
GUESSED = (*PUBLISHED, "matched")
"""The methods of table 3."""
_NOISE_COLUMNS = (
    number("offset", "late ms", 1e3),
    number("accel", "σ_a m/s²"),
    number("gyro", "σ_ω rad/s"),
    text("method"),
    text("setting", "its setting"),
    *ERROR_COLUMNS,
    count("answers", answered),
)
_ROUNDING = 1e-6
"""s, tolerance of the duration of a plan."""
_WRIST_JOINTS = 3
"""Number of joints at the end of an arm that are its wrist."""


@dataclass(frozen=True, kw_only=True)
class FoldedStudy(Recorded):
    """A study on folds of moves."""

    systems: tuple[str, ...]
    folds: int
    seeds: int
    paper_windows: tuple[int, ...]
    paper_exclusions: tuple[float, ...]

    def repeats(self, run: Cell) -> list[Cell]:
        """Every fold with every seed."""
        del run
        return grid(fold=range(self.folds), seed=range(self.seeds))

    def seed_of(self, cell: Cell) -> int:
        """A seed for each run of a condition: folds see other draws too (section 4.4)."""
        return int(cell["fold"] * self.seeds + cell["seed"])

    def calibrate(
        self,
        methods: Sequence[str],
        cell: Cell,
        clean: Recording,
        noise: NoiseOptions,
        *,
        noise_seed: int,
        initial_error: tuple[float, float],
    ) -> list[Row]:
        """Run methods on a recording without a fold, from a guess off by m and degrees."""
        moves = moves_of(clean.system, self.duration or clean.system.duration)
        held_out = stratified_folds(moves, self.folds)[cell["fold"]]
        guess = wrong_guess(clean, *initial_error, self.seed_of(cell))
        recording = without(corrupt(clean, noise, noise_seed), held_out)
        settings = paper_settings(self.paper_windows, self.paper_exclusions)
        return [
            cell | row | {"setting": setting_words(setting)}
            for setting, row in run_methods(methods, recording, guess, settings)
        ]


def steadily_small(rows: list[Row]) -> tuple[int, float]:
    """Badness of a setting: number of missing answers, then geometric mean of translation."""
    errors = column(rows, "translation")
    return len(rows) - len(errors), float(np.mean(np.log(errors))) if errors else math.inf


@dataclass(frozen=True, kw_only=True)
class Stretch:
    """One move of the plan with the standstill after it."""

    start: float
    """s."""
    stop: float
    kind: str
    """wrist or arm; force or torque."""


def moves_of(system: SystemConfig, duration: float) -> list[Stretch]:
    """Moves of the plan of a system within a duration, in order; they cover all of it."""
    mover = system.mover
    if isinstance(mover, Arm):
        targets = [mover.start_deg, *(move.to_deg for move in mover.moves)]
        wrist_alone = [a[:-_WRIST_JOINTS] == b[:-_WRIST_JOINTS] for a, b in pairwise(targets)]
        moves = [
            ("wrist" if wrist else "arm", move.seconds + move.rest)
            for move, wrist in zip(mover.moves, wrist_alone, strict=True)
        ]
        again = 1
    elif isinstance(mover, FreeBody):
        seconds = mover.push + mover.stop + mover.pause
        moves = [("torque" if any(p.torque) else "force", seconds) for p in mover.pushes]
        again = 0
    else:
        raise InputError(f"{system.name} walks: only an arm or a free body moves and rests in turn")
    t = mover.start_rest
    stretches = []
    # As the simulation repeats its plan.
    for kind, seconds in chain(moves, cycle(moves[again:] or moves)):
        if t >= duration - _ROUNDING:
            break
        stretches.append(Stretch(start=t, stop=min(t + seconds, duration), kind=kind))
        t += seconds
    # Standstill at the start belongs to the first move, the last sample to the last move.
    stretches[0] = replace(stretches[0], start=0.0)
    stretches[-1] = replace(stretches[-1], stop=np.inf)
    return stretches


def stratified_folds(moves: Sequence[Stretch], count: int) -> list[list[Stretch]]:
    """The moves of each fold; every kind is distributed in turn, so that folds are similar."""
    folds: list[list[Stretch]] = [[] for _ in range(count)]
    for kind in sorted({move.kind for move in moves}):
        for place, move in enumerate(move for move in moves if move.kind == kind):
            folds[place % count].append(move)
    return [sorted(fold, key=lambda move: move.start) for fold in folds]


def without(recording: Recording, held_out: Sequence[Stretch]) -> Recording:
    """A recording without some of its moves: gaps in every stream."""

    def left(record: Record) -> Record:
        kept = np.ones(len(record.t), dtype=bool)
        for move in held_out:
            kept &= (record.t < move.start) | (record.t >= move.stop)
        return rows_kept(record, kept)

    robot = tuple(map(left, recording.robot))
    return replace(recording, imu=left(recording.imu), robot=robot)


@dataclass(frozen=True, kw_only=True)
class Criteria:
    """Criteria of the claims about noise."""

    rotation_deg: float
    same: float
    """Share by which two means may differ and still be called the same."""
    little: float
    """Growth below this share of the arm's growth is called little."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A system, perhaps with changes."""

    name: str
    system: str
    gravity: float | None = None
    """m/s²; None is the system's own, as below."""
    inertia: Vector | None = None
    """kg m²."""
    robot_phase: float = 0.0
    """Share of a period by which the robot's instants come after those of the IMU."""
    offsets: tuple[float, ...] = (0.0,)
    """s, by which stamps of the IMU are late."""


@dataclass(frozen=True, kw_only=True)
class NoiseStudy(FoldedStudy):
    """Section 4.4 and Table 2."""

    name = "noise"
    line = ("case", "accel", "gyro", "offset", "method")
    accel: tuple[float, ...]
    gyro: tuple[float, ...]
    adis: tuple[float, ...]
    initial_translation: float
    initial_rotation_deg: float
    aside_accel: tuple[float, ...]
    timing: tuple[Case, ...] = ()
    bodies: tuple[Case, ...] = ()
    claims: Criteria

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.accel) != len(self.gyro):
            raise ValueError("accel and gyro need as many levels each: they are paired")
        if 0.0 not in self.accel or 0.0 not in self.gyro or len(self.gyro) < 2:
            raise ValueError("accel and gyro need 0 and other levels: each varies alone")
        for case in (*self.timing, *self.bodies):
            if replace(self.case(case.name), offsets=case.offsets) != case:
                raise ValueError(f"two cases are named {case.name} and differ")

    def case(self, name: str) -> Case:
        """The case of a name; systems are cases too."""
        systems = (Case(name=system, system=system) for system in self.systems)
        return next(c for c in (*systems, *self.timing, *self.bodies) if c.name == name)

    def sections(self) -> list[Section]:
        """Levels of noise for each system, then what the open question asks."""
        levels = {
            "accelerometer noise, gyroscope without": [(level, 0.0) for level in self.accel],
            "gyroscope noise, accelerometer without": [(0.0, level) for level in self.gyro],
            "both": list(zip(self.accel, self.gyro, strict=True)),
        }
        runs = {
            f"{system}: {words}": [
                {"case": system, "offset": 0.0, "accel": accel, "gyro": gyro}
                for accel, gyro in pairs
            ]
            for system in self.systems
            for words, pairs in levels.items()
        }
        asides = {"stamps of the IMU that are late": self.timing, "inertia": self.bodies}
        for words, cases in asides.items():
            for case in cases:
                runs[f"{case.name}: {words}"] = grid(
                    case=[case.name], offset=case.offsets, accel=self.aside_accel, gyro=[0.0]
                )
        return [Section(title, each, _NOISE_COLUMNS) for title, each in runs.items()]

    def measure(self, cell: Cell) -> list[Row]:
        """All methods on one fold with one seed."""
        case = self.case(cell["case"])
        changes = {key: getattr(case, key) for key in ("gravity", "inertia", "robot_phase")}
        return self.calibrate(
            METHODS,
            cell,
            clean_recording(case.system, replace(self.physics, **changes)),
            NoiseOptions(
                accel_white=cell["accel"],
                gyro_white=cell["gyro"],
                time_offset=cell["offset"],
            ),
            noise_seed=self.seed_of(cell),
            initial_error=(self.initial_translation, self.initial_rotation_deg),
        )

    def shown(self, rows: Sequence[Row]) -> list[Row]:
        """Each condition in its best setting."""
        return in_best_setting(rows, mean_error(), *self.line)

    def verdicts(self, rows: Sequence[Row]) -> dict[str, Iterator[Claim]]:
        """What the paper says of noise, and what it supposes."""
        return {
            "Claims of section 4.4": self._claims(rows),
            "The open question of section 4.4": self._answers(rows),
        }

    def _claims(self, rows: Sequence[Row]) -> Iterator[Claim]:
        """Each claim for each method, without late stamps; one setting a system and method."""
        rows = in_best_setting(chosen(rows, offset=0.0), steadily_small, "case", "method")
        for method in (*OURS, *PUBLISHED):
            arm, bar = (chosen(rows, method=method, case=case) for case in (ARM, BAR))
            if arm:
                yield from self._claims_of_the_arm(method, arm)
            if arm and bar:
                still, grown = _growth(bar, self.accel)
                arm_still, arm_grown = _growth(arm, self.accel)
                little = self.claims.little
                yield Claim(
                    words=f"{method}: BarBot: translation errors grow little with σ_a (less than "
                    f"{little:.0%} of RiHIBot's growth)",
                    found=f"{digits(still)} to {digits(grown)} mm; RiHIBot {digits(arm_still)} to "
                    f"{digits(arm_grown)} mm",
                    met=exceeds(little * (arm_grown - arm_still), grown - still),
                )

    def _claims_of_the_arm(self, method: str, arm: list[Row]) -> Iterator[Claim]:
        criteria, of_arm = self.claims, f"{method}: RiHIBot"
        turned = {
            level: DEGREES * worst(chosen(arm, accel=0.0, gyro=level), "rotation")
            for level in self.gyro
        }
        beyond = [level for level, angle in turned.items() if angle >= criteria.rotation_deg]
        averaged = DEGREES * worst(chosen(arm, accel=0.0), "averaged_rotation")
        most_turned = float(np.max(list(turned.values())))
        found = f"at most {digits(most_turned)} deg (mean |rpy| {digits(averaged)} deg)"
        if beyond:
            found += f"; not at σ_ω = {', '.join(f'{level:g}' for level in beyond)} rad/s"
        yield Claim(
            words=f"{of_arm}, σ_a = 0: rotation below {criteria.rotation_deg} deg at "
            "every σ_ω, in every calibration",
            found=found,
            met=exceeds(criteria.rotation_deg, most_turned),
        )
        still = _error(arm, 0.0, 0.0)
        changes = [(*_change(arm, level), level) for level in self.gyro[1:]]
        change, error, level = max(changes, key=lambda c: c[0] - 2.0 * c[1])
        yield Claim(
            words=f"{of_arm}, σ_a = 0: gyroscope noise does not raise the translation "
            f"error at any σ_ω (means by {criteria.same:.0%} at most, but for two standard errors)",
            found=f"{digits(still)} mm without; at worst {'+' * (change > 0)}{digits(change)} mm, "
            f"standard error {digits(error)}, at σ_ω = {level:g}",
            met=exceeds(criteria.same * still, change - 2.0 * error),
        )
        least, most = self.accel[0], self.accel[-1]
        start, grown = _growth(arm, self.accel)
        together = _error(arm, most, self.gyro[-1])
        yield Claim(
            words=f"{of_arm}: translation errors grow with σ_a (more than {criteria.same:.0%})",
            found=f"{digits(start)} mm at σ_a = {least:g}, {digits(grown)} mm at {most:g}",
            met=exceeds(grown, (1.0 + criteria.same) * start),
        )
        yield Claim(
            words=f"{of_arm}: both noises together are as accelerometer noise alone "
            f"(means within {criteria.same:.0%})",
            found=f"{digits(together)} mm together, {digits(grown)} mm alone",
            met=exceeds(criteria.same * grown, abs(together - grown)),
        )

        def angle(level: float) -> str:
            return digits(DEGREES * mean(chosen(arm, accel=level, gyro=0.0), "rotation"))

        # Claims whose bounds did not reach us: the figures alone.
        angles = ", ".join(f"{angle(level)} at {level:g}" for level in self.accel)
        yield Claim(
            words=f"{of_arm}: rotation errors rise at the largest σ_a only (which is not "
            "known to us)",
            found=f"{angles} m/s², deg",
            met=None,
        )
        errors = ", ".join(
            f"{digits(_error(arm, level))} mm and {angle(level)} deg at {level:g}"
            for level in self.adis
        )
        yield Claim(
            words=f"{of_arm}: small errors at the ADIS16495's 0.0002 (m/s², or g, which "
            "is 0.00196; the bounds are not known to us)",
            found=f"{errors} m/s²",
            met=None,
        )

    def _answers(self, rows: Sequence[Row]) -> Iterator[Claim]:
        """What the paper supposes behind the growth of errors, and what an estimated offset does.

        The published method is in one setting throughout, the best over all of it.
        """
        same, little, accel = self.claims.same, self.claims.little, self.aside_accel
        cases = {case.name for case in (*self.timing, *self.bodies)} | {ARM}
        asides = [
            row for row in chosen(rows, gyro=0.0) if row["case"] in cases and row["accel"] in accel
        ]
        rows = in_best_setting(asides, steadily_small, "method")

        def from_to(case: str, offset: float) -> tuple[float, float]:
            return _growth(chosen(rows, method=JUDGED, case=case, offset=offset), accel)

        in_time = from_to(ARM, 0.0)
        growth = in_time[1] - in_time[0]
        of_arm = f"{digits(in_time[0])} to {digits(in_time[1])} mm"
        span = f"σ_a {accel[0]:g} to {accel[-1]:g} m/s²"
        for case in self.timing:
            for offset in case.offsets:
                if (case.name, offset) == (ARM, 0.0):
                    continue
                still, grown = from_to(case.name, offset)
                yield Claim(
                    words=f"{JUDGED}: {case.name}, stamps {offset * 1e3:g} ms late: errors grow "
                    f"more than on RiHIBot in time ({span})",
                    found=f"{digits(still)} to {digits(grown)} mm; RiHIBot in time {of_arm}",
                    met=exceeds(grown - still, (1.0 + same) * growth),
                )
        for case in self.timing:
            late = max(case.offsets)
            if late <= 0.0:
                continue
            ours = chosen(rows, method="matched", case=case.name)
            before, after = (
                _error(chosen(ours, offset=offset), accel[0]) for offset in (0.0, late)
            )
            yield Claim(
                words=f"matched: {case.name}: estimating the offset takes away what late stamps do",
                found=f"{digits(after)} mm at {late * 1e3:g} ms, {digits(before)} mm in time; "
                f"{JUDGED}: {digits(from_to(case.name, late)[0])} mm",
                met=exceeds(before, 0.0) and after <= (1.0 + same) * before,
            )
        for body in self.bodies:
            still, grown = from_to(body.name, 0.0)
            yield Claim(
                words=f"{JUDGED}: {body.name}: translation errors grow little with σ_a ({span})",
                found=f"{digits(still)} to {digits(grown)} mm; RiHIBot {of_arm}",
                met=exceeds(little * growth, grown - still),
            )


def _error(rows: Sequence[Row], accel: float, gyro: float = 0.0) -> float:
    """Mean translation error, mm."""
    return MILLIMETRES * mean(chosen(rows, accel=accel, gyro=gyro), "translation")


def _growth(rows: Sequence[Row], accel: Sequence[float]) -> tuple[float, float]:
    """Mean translation errors, mm, at the first and the last noise of the accelerometer."""
    return _error(rows, accel[0]), _error(rows, accel[-1])


def _change(arm: list[Row], gyro: float) -> tuple[float, float]:
    """Change of the translation error by gyroscope noise, mm, and its standard error.

    Each run is compared with the run without noise from the same guess on the same fold.
    """
    pairs = []
    for row in chosen(arm, accel=0.0, gyro=gyro):
        quiet = chosen(arm, accel=0.0, gyro=0.0, fold=row["fold"], seed=row["seed"])
        # a run without an answer makes no pair
        for after, before in zip(
            column([row], "translation"), column(quiet, "translation"), strict=False
        ):
            pairs.append(MILLIMETRES * (after - before))
    error = float(np.std(pairs, ddof=1) / math.sqrt(len(pairs))) if len(pairs) > 1 else 0.0
    return float(np.mean(pairs)) if pairs else math.nan, error


@dataclass(frozen=True, kw_only=True)
class InitialErrorStudy(FoldedStudy):
    """Section 4.5 and Table 3."""

    name = "initial-error"
    line = ("initial_translation", "initial_rotation_deg", "method")
    translation: tuple[float, ...]
    rotation_deg: tuple[float, ...]
    accel: float
    gyro: float
    failed_translation: float
    failed_rotation_deg: float
    same_translation: float
    realistic_rotation_deg: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.translation) != len(self.rotation_deg):
            raise ValueError("translation and rotation_deg need as many sizes: they are paired")

    def sections(self) -> list[Section]:
        """For each system translation alone, rotation alone, then both together."""
        sizes = [(size, 0.0) for size in self.translation]
        sizes += [(0.0, size) for size in self.rotation_deg]
        sizes += zip(self.translation, self.rotation_deg, strict=True)

        def of_good(cell: Column) -> Column:
            return cell[0], lambda rows: cell[1](self._good(rows))

        columns = (
            number("initial_translation", "initial m"),
            number("initial_rotation_deg", "initial deg"),
            text("method"),
            text("setting", "its setting"),
            *map(of_good, ERROR_COLUMNS),
            count("failed", lambda row: not self._good([row])),
        )
        note = (
            f"Failed: no answer, or one farther than {self.failed_translation * 1e3:g} mm "
            f"or {self.failed_rotation_deg:g} deg from the truth, another minimum; means "
            "and spreads are of the others. The published method stands in the setting in which "
            "its result depends least on the guess, which need not be its most exact. The matched "
            "method is given no guess."
        )
        return [
            Section(
                f"{system}: error of the initial guess",
                [
                    {"system": system, "initial_translation": size, "initial_rotation_deg": angle}
                    for size, angle in dict.fromkeys(sizes)
                ],
                columns,
                note,
            )
            for system in self.systems
        ]

    def measure(self, cell: Cell) -> list[Row]:
        """All methods on one fold, from one guess; ours gets none."""
        return self.calibrate(
            GUESSED,
            cell,
            clean_recording(cell["system"], self.physics),
            NoiseOptions(accel_white=self.accel, gyro_white=self.gyro),
            # The same noise for all seeds of a fold: only the guess differs between them.
            noise_seed=cell["fold"],
            initial_error=(cell["initial_translation"], cell["initial_rotation_deg"]),
        )

    def shown(self, rows: Sequence[Row]) -> list[Row]:
        """Each method in its steadiest setting, in which its result depends least on the guess.

        It may depend on it much, because the exclusion uses the pose of the guess.
        """
        return in_best_setting(rows, self._unsteadiness, "system", "method")

    def verdicts(self, rows: Sequence[Row]) -> dict[str, Iterator[Claim]]:
        """That the guess does not matter."""
        return {"Claims of section 4.5": self._claims(self.shown(rows))}

    def _good(self, rows: Sequence[Row]) -> list[Row]:
        """Rows with an answer that is in no other minimum."""
        return [
            row
            for row in rows
            if answered(row)
            and row["translation"] <= self.failed_translation
            and row["rotation"] * DEGREES <= self.failed_rotation_deg
        ]

    def _unsteadiness(self, rows: Sequence[Row]) -> tuple[int, float]:
        """Number of failures, and the largest range of the other results on a fold, mm."""
        good = self._good(rows)
        errors = [column(chosen(good, fold=fold), "translation") for fold in range(self.folds)]
        ranges = (MILLIMETRES * (max(e) - min(e)) for e in errors if e)
        return len(rows) - len(good), max(ranges, default=math.nan)

    def _claims(self, rows: Sequence[Row]) -> Iterator[Claim]:
        limit = self.realistic_rotation_deg
        parts = {False: f"initial errors up to {limit:g} deg", True: f"beyond {limit:g} deg"}
        most = MILLIMETRES * self.same_translation
        for cell in grid(system=self.systems, method=GUESSED):
            mine = chosen(rows, **cell)
            for beyond, words in parts.items():
                found = [row for row in mine if (row["initial_rotation_deg"] > limit) is beyond]
                if not found:
                    continue
                failed, widest = self._unsteadiness(found)
                yield Claim(
                    words=f"{cell['method']}: {cell['system']}: {words}: the result does not vary "
                    f"(no failure; within {most:g} mm of each other on each fold)",
                    found=f"{failed} of {len(found)} failed; others within {digits(widest)} "
                    "mm of each other",
                    met=not failed and widest < most,
                )
