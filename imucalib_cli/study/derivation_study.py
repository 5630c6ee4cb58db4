"""Figures 5 to 7: the derived acceleration against the measured one (section 4.2 of the paper)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.study.claims import Claim, claims_table
from imucalib_cli.study.conditions import Recorded
from imucalib_cli.study.derivation import (
    Comparison,
    compared_by_matched,
    compared_by_paper,
    near_changes,
)
from imucalib_cli.study.derivation_figure import draw_comparison
from imucalib_cli.study.experiment import Figure
from imucalib_cli.study.guesses import Guess, wrong_guess
from imucalib_cli.study.load import load_parameters
from imucalib_cli.study.summary import chosen, column, digits
from imucalib_cli.study.systems import clean_recording
from imucalib_cli.study.table import Table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from imucalib_cli.simulate.recording import Recording
    from imucalib_cli.study.experiment import Cell, Row, Study

FILTERS = ("paper", "matched")
PLATES = {
    5: ("barbot", "no initial error"),
    6: ("barbot", "initial error"),
    7: ("rihibot", "no initial error"),
}
"""The paper's figures by number: system, and whether the guess is off."""


@dataclass(frozen=True, kw_only=True)
class Zoom:
    """First and last instant of an enlarged panel, s, by system."""

    barbot: tuple[float, float]
    rihibot: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class DerivationCriteria:
    """By which claims are judged, all as shares of the signal."""

    match: float
    """A mismatch up to which curves match almost perfectly."""
    mismatch: float
    """One over which they clearly do not."""
    gravity: float
    """Least difference that is more than minimal."""


@dataclass(frozen=True, kw_only=True)
class DerivationParameters(Recorded):
    """As configs/studies/derivation.yaml states them, with units."""

    windows: tuple[int, ...]
    drawn_window: int
    exclusions: tuple[float, ...]
    drawn_exclusion: float
    margin: float
    jerk: float
    initial_translation: float
    initial_rotation_deg: float
    initial_seed: int
    zoom: Zoom
    claims: DerivationCriteria


@dataclass(frozen=True)
class DerivationStudy:
    """Section 4.2 and figures 5 to 7."""

    config: DerivationParameters
    name: str = "derivation"

    def cells(self) -> list[Cell]:
        """Every figure by either filter at every window."""
        return [
            {"figure": figure, "filter": name, "window": window, "exclusion": exclusion}
            for figure in PLATES
            for window in self.config.windows
            for name in FILTERS
            for exclusion in (self.config.exclusions if name == "paper" else (None,))
        ]

    def measure(self, cell: Cell) -> list[Row]:
        """How far derived and measured acceleration are apart, near starts and stops and not."""
        figure, window = int(cell["figure"] or 0), int(cell["window"] or 0)
        limit = column([cell], "exclusion")
        found = self._compared(figure, str(cell["filter"]), window, *limit)
        recording, _ = self._case(figure)
        brusque = self._brusque(found)
        apart = np.abs(found.mismatch)
        row: Row = {
            "signal": _rms(found.derived),
            "all": _rms(found.mismatch),
            "starts_stops": _rms(found.mismatch[brusque]),
            "elsewhere": _rms(found.mismatch[~brusque]),
            "largest": float(apart.max()),
            "kept": _rms(found.mismatch[found.kept]),
            "excluded": float(np.mean(~found.kept)),
            "weightless": self._weightless(figure, str(cell["filter"]), window),
            "system": recording.system.name,
        }
        return [cell | row]

    def _weightless(self, figure: int, name: str, window: int) -> float | None:
        """Mismatch elsewhere of the same motion without gravity, m/s²; None where there is none."""
        if not self._case(figure)[0].gravity_world.any():
            return None
        found = self._compared(figure, name, window, gravity=0.0)
        return _rms(found.mismatch[~self._brusque(found)])

    def _brusque(self, found: Comparison) -> NDArray[np.bool_]:
        """Samples near starts and stops."""
        return near_changes(found.t, found.measured, self.config.jerk, self.config.margin)

    def tables(self, rows: Sequence[Row]) -> list[Table]:
        """The mismatches, and what the paper says about its figures."""
        lines = []
        for row in rows:
            figure = int(row["figure"] or 0)
            lines.append(
                (
                    f"{figure}: {', '.join(PLATES[figure])}",
                    str(row["window"]),
                    str(row["filter"]),
                    digits(column([row], "exclusion")[0]) if row["filter"] == "paper" else "-",
                    *(
                        digits(column([row], key)[0])
                        for key in ("signal", "all", "starts_stops", "elsewhere", "largest", "kept")
                    ),
                    f"{column([row], 'excluded')[0]:.1%}",
                )
            )
        table = Table(
            title="Derived less measured acceleration along x, root mean square, m/s²",
            header=(
                "figure",
                "window",
                "filter",
                "excluded over",
                "signal",
                "all",
                "near starts and stops",
                "elsewhere",
                "largest",
                "of what is kept",
                "excluded",
            ),
            rows=tuple(lines),
            note=(
                f"Near: within {self.config.margin:g} s of a jerk over {self.config.jerk:g} m/s³. "
                "Excluded: dropped by the method as starts and stops."
            ),
        )
        return [table, claims_table("Claims of section 4.2", self._claims(rows))]

    def figures(self, rows: Sequence[Row]) -> list[Figure]:
        """One a figure of the paper."""
        del rows
        return [Figure(f"figure-{number}", partial(self._draw, number)) for number in PLATES]

    def _draw(self, number: int, path: Path) -> None:
        system, guess = PLATES[number]
        window, drawn = self.config.drawn_window, self.config.drawn_exclusion
        zoom = self.config.zoom.barbot if system == "barbot" else self.config.zoom.rihibot
        draw_comparison(
            path,
            f"{system}, {guess}, window of {window} samples",
            {name: self._compared(number, name, window, drawn) for name in FILTERS},
            zoom,
        )

    def _case(self, figure: int, gravity: float | None = None) -> tuple[Recording, Guess]:
        system, error = PLATES[figure]
        recording = clean_recording(system, replace(self.config.physics, gravity=gravity))
        wrong = float(error == "initial error")
        return recording, wrong_guess(
            recording,
            wrong * self.config.initial_translation,
            wrong * math.radians(self.config.initial_rotation_deg),
            self.config.initial_seed,
        )

    def _compared(
        self,
        figure: int,
        name: str,
        window: int,
        exclusion: float = 0.0,
        gravity: float | None = None,
    ) -> Comparison:
        recording, guess = self._case(figure, gravity)
        if name == "matched":
            return compared_by_matched(recording, guess, window)
        return compared_by_paper(recording, guess, window, exclusion)

    def _claims(self, rows: Sequence[Row]) -> list[Claim]:
        made, criteria = [], self.config.claims
        for name in FILTERS:
            for window in self.config.windows:
                mine = chosen(rows, filter=name, window=window)
                # What is excluded changes neither the filters nor these figures.
                bar, wrong, arm = (chosen(mine, figure=number)[0] for number in PLATES)
                calm, near = _share(bar, "elsewhere"), _share(bar, "starts_stops")
                off, true = _share(wrong, "all"), _share(bar, "all")
                heavy, light = _share(arm, "elsewhere"), _share(arm, "weightless")
                made += [
                    Claim(
                        words=f"{name}: figure 5, window {window}: matches almost perfectly "
                        f"({criteria.match:.0%} of the signal) but for starts and stops",
                        found=f"{calm:.2%} elsewhere, {near:.2%} near starts and stops",
                        met=calm <= criteria.match,
                    ),
                    Claim(
                        words=f"{name}: figure 6, window {window}: an initial error is a clear "
                        f"mismatch (over {criteria.mismatch:.0%} of the signal)",
                        found=f"{off:.2%} of the signal; {true:.2%} without",
                        met=off > criteria.mismatch,
                    ),
                    Claim(
                        words=f"{name}: figure 7, window {window}: gravity has minimal impact "
                        f"(less than {criteria.gravity:.0%} of the signal, away from starts and "
                        "stops)",
                        found=f"{heavy:.2%} elsewhere, {light:.2%} without gravity",
                        met=abs(heavy - light) < criteria.gravity,
                    ),
                ]
        return made


def _share(row: Row, key: str) -> float:
    """A mismatch over the signal."""
    return column([row], key)[0] / column([row], "signal")[0]


def _rms(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def load(file: Path | None, *, quick: bool) -> Study:
    """The study with its parameters."""
    return DerivationStudy(load_parameters(DerivationParameters, "derivation", file, quick=quick))
