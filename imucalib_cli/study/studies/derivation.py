"""Figures 5 to 7: the derived acceleration against the measured one (section 4.2 of the paper)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.estimate.options import PaperOptions, WindowChoice
from imucalib_cli.paper.filters import filtered_instants
from imucalib_cli.robot.rotations import rotvec_from_matrix
from imucalib_cli.signals.kernels import MARGIN, convolve_at, matched_filter
from imucalib_cli.signals.trajectory import Trajectory
from imucalib_cli.simulate.load import load_system
from imucalib_cli.study.experiment import Section, grid
from imucalib_cli.study.figures import COLOURS, new_figure, save_svg
from imucalib_cli.study.method_runs import Pose, Recorded, wrong_guess
from imucalib_cli.study.recordings import clean_recording, streams_of
from imucalib_cli.study.tables import Claim, chosen, number, text

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes

    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.simulate.recording import Recording
    from imucalib_cli.study.experiment import Cell, Draw
    from imucalib_cli.study.tables import Row


FILTERS = ("paper", "matched")
PLATES = {
    5: ("barbot", "no initial error"),
    6: ("barbot", "initial error"),
    7: ("rihibot", "no initial error"),
}
"""The paper's figures by number: system, and whether the guess is off."""
_COLUMNS = (
    ("figure", lambda line: _plate(line[0]["figure"])),
    text("window"),
    text("filter"),
    number("exclusion", "excluded over"),
    *(number(key, key) for key in ("signal", "all")),
    number("starts_stops", "near starts and stops"),
    *(number(key, key) for key in ("elsewhere", "largest")),
    number("kept", "of what is kept"),
    ("excluded", lambda line: f"{line[0]['excluded']:.1%}"),
)
_DEGREE = PaperOptions().degree
_MOST_POINTS = 1500
"""Points per curve in a figure."""
_MARKS = 300
"""Of excluded samples."""


def _plate(figure: int) -> str:
    return f"{figure}: {', '.join(PLATES[figure])}"


@dataclass(frozen=True, kw_only=True)
class Zoom:
    """First and last instant of the enlarged panels, s, by system."""

    barbot: tuple[float, float]
    rihibot: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class DerivationCriteria:
    """Criteria of the claims, relative to the signal."""

    match: float
    """Largest mismatch with which curves match almost perfectly."""
    mismatch: float
    """Smallest clear mismatch."""
    gravity: float
    """Smallest difference that is more than minimal."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """Derived and measured acceleration of the IMU along the world's x axis, by one filter."""

    t: Floats
    """(N,), s."""
    position: Floats
    """(N,), m, of the IMU with the guessed pose."""
    derived: Floats
    """(N,), m/s²."""
    measured: Floats
    """(N,), m/s², smoothed by this filter, without gravity."""
    kept: Bools
    """(N,), whether the filter's method uses the instant."""

    @property
    def mismatch(self) -> Floats:
        """(N,), derived less measured, m/s²."""
        return self.derived - self.measured


@dataclass(frozen=True, kw_only=True)
class DerivationStudy(Recorded):
    """Section 4.2 and figures 5 to 7."""

    name = "derivation"
    line = ("figure", "window", "filter", "exclusion")
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

    def sections(self) -> list[Section]:
        """The mismatches of every figure, by either filter at every window."""
        note = (
            f"Near: within {self.margin:g} s of a jerk over {self.jerk:g} m/s³. "
            "Excluded: dropped by the method as starts and stops."
        )
        title = "Derived less measured acceleration along x, root mean square, m/s²"
        runs = grid(figure=PLATES, window=self.windows, filter=FILTERS)
        return [Section(title, runs, _COLUMNS, note)]

    def repeats(self, run: Cell) -> list[Cell]:
        """The published filter with every exclusion; the other excludes nothing."""
        return grid(exclusion=self.exclusions if run["filter"] == "paper" else [None])

    def measure(self, cell: Cell) -> list[Row]:
        """Difference of derived and measured acceleration, near starts and stops and elsewhere."""
        setting = cell["figure"], cell["filter"], cell["window"]
        found = self._compared(*setting, cell["exclusion"] or 0.0)
        brusque, apart = self._brusque(found), found.mismatch
        system, weightless = PLATES[cell["figure"]][0], None
        if load_system(system).gravity:  # the same motion without gravity
            light = self._compared(*setting, gravity=0.0)
            weightless = _rms(light.mismatch[~self._brusque(light)])
        return [
            cell
            | {
                "signal": _rms(found.derived),
                "all": _rms(apart),
                "starts_stops": _rms(apart[brusque]),
                "elsewhere": _rms(apart[~brusque]),
                "largest": float(np.abs(apart).max()),
                "kept": _rms(apart[found.kept]),
                "excluded": float(np.mean(~found.kept)),
                "weightless": weightless,
                "system": system,
            }
        ]

    def figures(self, rows: Sequence[Row]) -> dict[str, Draw]:
        """One for each figure of the paper."""
        del rows
        return {f"figure-{number}": partial(self._draw, number) for number in PLATES}

    def _draw(self, number: int, path: Path) -> None:
        system, guess = PLATES[number]
        window, drawn = self.drawn_window, self.drawn_exclusion
        draw_comparison(
            path,
            f"{system}, {guess}, window of {window} samples",
            {name: self._compared(number, name, window, drawn) for name in FILTERS},
            getattr(self.zoom, system),
        )

    def _compared(
        self,
        figure: int,
        name: str,
        window: int,
        exclusion: float = 0.0,
        *,
        gravity: float | None = None,
    ) -> Comparison:
        system, error = PLATES[figure]
        recording = clean_recording(system, replace(self.physics, gravity=gravity))
        sizes = self.initial_translation, self.initial_rotation_deg
        wrong = sizes if error == "initial error" else (0.0, 0.0)
        guess = wrong_guess(recording, *wrong, self.initial_seed)
        if name == "matched":
            return compared_by_matched(recording, guess, window)
        return compared_by_paper(recording, guess, window, exclusion)

    def _brusque(self, found: Comparison) -> Bools:
        """Instants (N,), even in time, within the margin of a jerk: starts and stops."""
        dt = float(np.median(np.diff(found.t)))
        sudden = np.abs(np.gradient(found.measured, dt)) > self.jerk
        reach = np.ones(2 * max(round(self.margin / dt), 1) + 1)
        return np.asarray(np.convolve(sudden, reach, mode="same") > 0.0)

    def verdicts(self, rows: Sequence[Row]) -> dict[str, Iterator[Claim]]:
        """What the paper says about its figures."""
        return {"Claims of section 4.2": self._claims(rows)}

    def _claims(self, rows: Sequence[Row]) -> Iterator[Claim]:
        criteria = self.claims

        def share(row: Row, key: str) -> float:
            return float(row[key] / row["signal"])

        for name in FILTERS:
            for window in self.windows:
                mine = chosen(rows, filter=name, window=window)
                # The exclusion changes neither the filters nor these figures.
                bar, wrong, arm = (chosen(mine, figure=number)[0] for number in PLATES)
                calm, near = share(bar, "elsewhere"), share(bar, "starts_stops")
                off, true = share(wrong, "all"), share(bar, "all")
                heavy, light = share(arm, "elsewhere"), share(arm, "weightless")
                yield Claim(
                    words=f"{name}: figure 5, window {window}: matches almost perfectly "
                    f"({criteria.match:.0%} of the signal) but for starts and stops",
                    found=f"{calm:.2%} elsewhere, {near:.2%} near starts and stops",
                    met=calm <= criteria.match,
                )
                yield Claim(
                    words=f"{name}: figure 6, window {window}: an initial error is a clear "
                    f"mismatch (over {criteria.mismatch:.0%} of the signal)",
                    found=f"{off:.2%} of the signal; {true:.2%} without",
                    met=off > criteria.mismatch,
                )
                yield Claim(
                    words=f"{name}: figure 7, window {window}: gravity has minimal impact (less "
                    f"than {criteria.gravity:.0%} of the signal, away from starts and stops)",
                    found=f"{heavy:.2%} elsewhere, {light:.2%} without gravity",
                    met=abs(heavy - light) < criteria.gravity,
                )


def _rms(values: Floats) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def compared_by_paper(
    recording: Recording, guess: Pose, window: int, exclusion: float
) -> Comparison:
    """The published filter: derivatives of the pose, and measurements smoothed as published."""
    imu, path = streams_of(recording)
    options = PaperOptions(window=WindowChoice(samples=window), exclusion_threshold=exclusion)
    instants, _, _ = filtered_instants(imu, path, options, guess.R, guess.t)
    x = np.concatenate([guess.t, rotvec_from_matrix(guess.R)])
    norm = float(np.linalg.norm(recording.gravity_world))
    derived, measured = instants.accelerations(x, norm)
    _, p = Trajectory.of(path).poses(instants.t)
    return Comparison(
        t=instants.t,
        position=(p + instants.R @ guess.t)[:, 0],
        derived=derived[:, 0],
        measured=measured[:, 0],
        kept=instants.kept,
    )


def compared_by_matched(recording: Recording, guess: Pose, window: int) -> Comparison:
    """The matched filters: the kernel of the derivative averages the measurements; no gaps."""
    imu, path = streams_of(recording)
    trajectory = Trajectory.of(path)
    inside = trajectory.covered(imu.t)
    t = imu.t[inside]
    R, p = trajectory.poses(t)
    p_world_imu = p + R @ guess.t
    accel = np.einsum("nij,nj->ni", R @ guess.R, imu.accel[inside])
    accel += recording.gravity_world
    filters = matched_filter(window, _DEGREE, 2, float(np.median(np.diff(t))))
    first = np.arange(MARGIN, len(t) - window - MARGIN + 1)
    centres = first + window // 2
    derived = convolve_at(p_world_imu, filters.derivative, first)
    measured = convolve_at(accel, filters.average, first - MARGIN)
    return Comparison(
        t=t[centres],
        position=p_world_imu[centres, 0],
        derived=derived[:, 0],
        measured=measured[:, 0],
        kept=np.ones(len(centres), dtype=bool),
    )


def draw_comparison(
    path: Path, title: str, found: dict[str, Comparison], zoom: tuple[float, float]
) -> None:
    """Draw a figure of the paper for each filter, side by side; parts from zoom, s, enlarged."""
    figure, panels = new_figure(4, len(found), size=(10.0, 10.0))
    for place, (name, one) in enumerate(found.items()):
        panel = panels[place :: len(found)]
        panel[0].set_title(f"{name} filter")
        near = (one.t >= zoom[0]) & (one.t <= zoom[1])
        _line(panel[0], one.t, one.position, COLOURS[2], "position")
        panel[0].set_ylabel("x, m")
        for axes, shown in ((panel[1], np.ones_like(near)), (panel[2], near)):
            _line(axes, one.t[shown], one.derived[shown], COLOURS[1], "derived")
            _line(axes, one.t[shown], one.measured[shown], COLOURS[0], "measured", linestyle="--")
            t, y = one.t[shown & ~one.kept], one.derived[shown & ~one.kept]
            if len(t):
                every = max(len(t) // _MARKS, 1)
                look: dict[str, Any] = {"linestyle": "", "marker": "x", "markersize": 3.0}
                axes.plot(t[::every], y[::every], color=COLOURS[6], label="excluded", **look)
            axes.set_ylabel("acceleration, m/s²")
        _line(panel[3], one.t[near], one.mismatch[near], COLOURS[6], "derived less measured")
        panel[3].set_ylabel("m/s²")
        panel[3].set_xlabel("s")
        for axes in panel:
            axes.legend(loc="upper right", fontsize=7)
    bottom = panels[3 * len(found) :]
    limits = [limit for axes in bottom for limit in axes.get_ylim()]
    for axes in bottom:
        axes.set_ylim(min(limits), max(limits))
    figure.suptitle(title)
    save_svg(figure, path)


def _line(
    axes: Axes, t: Floats, y: Floats, colour: str, name: str, *, linestyle: str = "-"
) -> None:
    every = max(len(t) // _MOST_POINTS, 1)
    style: dict[str, Any] = {"linestyle": linestyle, "linewidth": 1.0, "color": colour}
    axes.plot(t[::every], y[::every], label=name, **style)
