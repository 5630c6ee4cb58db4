"""The pictures of docs/motion.md: what each motion teaches, from simulated logs of one arm.

To draw them again: ``python -m docs.motions``. It takes a minute.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.digits import figures
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.simulate.config import Move
from imucalib_cli.simulate.load import load_grade, load_system
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import PhysicsOptions
from imucalib_cli.simulate.physics import record
from imucalib_cli.simulate.recording import JointRecord
from imucalib_cli.study.recordings import streams_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.arrays import Floats

PICTURES = Path(__file__).parent / "motion"
SECONDS = 40.0
TICKS = (0, 10, 20, 30, 40)
MOVE, REST = 1.5, 0.5  # s
ANGLE = 50.0  # deg
HOME = np.array([0.0, -70.0, 100.0, -120.0, -90.0, 0.0])  # deg
ALL_AT_ONCE = ANGLE * np.array(
    [
        [1.0, 0.4, -0.5, -0.9, 0.7, 1.2],
        [-0.6, -0.4, 0.5, 0.8, -1.0, -0.9],
        [0.5, 0.6, 0.3, -0.6, -0.6, 0.4],
        [-1.0, 0.0, -0.6, 0.9, 0.9, -1.3],
        [0.2, -0.5, 0.5, 0.4, -0.8, 0.9],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ]
)
UNKNOWN = np.array([0.1] * 3 + [np.radians(10.0)] * 3)
"""A larger σ is no knowledge of a mount, m and rad."""


@dataclass(frozen=True)
class Motion:
    """Moves of the arm from its home, repeated until the log is full."""

    title: str
    targets: Floats
    """(M, 6), deg from home."""
    slower: float = 1.0
    """How many times as long each move and rest takes."""


def _in_turn(*joints: int) -> Floats:
    """Each joint to one side, to the other, and home."""
    steps = np.zeros((len(joints), 3, 6))
    for place, joint in enumerate(joints):
        steps[place, :2, joint] = ANGLE, -ANGLE
    return steps.reshape(-1, 6)


MOTIONS = {
    "base-joint": Motion("The base joint alone", _in_turn(0)),
    "last-joint": Motion("The last joint alone", _in_turn(5)),
    "two-joints": Motion("Two wrist joints, one after the other", _in_turn(4, 5)),
    "each-joint": Motion("Every joint, one after the other", _in_turn(*range(6))),
    "all-joints": Motion("All joints at once", ALL_AT_ONCE),
    "slowly": Motion("All joints at once, four times as slowly", ALL_AT_ONCE, slower=4.0),
}


@dataclass(frozen=True, eq=False)
class Lesson:
    """What a log of a motion taught."""

    joints: Floats
    """(N, 6), deg from home, N evenly over the log."""
    share: Floats
    """(24, 6), share of each stretch in what is known of tx .. rz."""
    std_so_far: Floats
    """(48, 6), m and rad."""
    std: Floats
    """(6,), m and rad."""

    @property
    def known(self) -> list[bool]:
        """Of each component, whether the motion determines it."""
        return [bool(std < unknown) for std, unknown in zip(self.std, UNKNOWN, strict=True)]


@cache
def lesson(name: str) -> Lesson:
    """Simulate a motion with a MEMS IMU and a good encoder, and calibrate."""
    system, motion = load_system("rihibot"), MOTIONS[name]
    assert system.arm is not None  # noqa: S101
    moves = tuple(
        Move(
            to_deg=tuple((HOME + target).tolist()),
            seconds=motion.slower * MOVE,
            rest=motion.slower * REST,
        )
        for target in motion.targets
    )
    home = tuple(HOME.tolist())
    # A log that is longer than the plan goes on with the second move.
    first = Move(to_deg=home, seconds=0.5, rest=0.0)
    arm = replace(system.arm, start_deg=home, start_rest=0.5, moves=(first, *moves))
    physics = PhysicsOptions(duration=SECONDS, imu_rate=200.0, robot_rate=100.0)
    clean = record(replace(system, arm=arm), physics)
    noise = replace(load_grade("mems"), encoder_noise=2e-5)
    estimate = calibrate_matched(
        *streams_of(corrupt(clean, noise, seed=1)), MatchedOptions(), details=True
    )
    assert estimate.details is not None  # noqa: S101
    assert estimate.covariance is not None  # noqa: S101
    stretches = estimate.details.stretches
    assert stretches is not None  # noqa: S101
    (robot,) = clean.robot
    assert isinstance(robot, JointRecord)  # noqa: S101
    return Lesson(
        joints=np.degrees(robot.position[::10]) - HOME,
        share=stretches.share.reshape(-1, 2, 6).sum(axis=1),
        std_so_far=stretches.std_so_far,
        std=np.sqrt(np.diag(estimate.covariance)),
    )


LEFT, WIDTH, RIGHT = 100, 480, 140
JOINTS_HIGH, ROW = 64, 18
BLUE, ORANGE, GREEN, GREY = "#2f86c1", "#d55e00", "#1a9a72", "#808080"
ROWS = [f"{kind} {axis}" for kind in ("along", "about") for axis in "xyz"]


def taught_by(name: str) -> str:
    """The joints of a motion over time, and when it teaches which component, as SVG."""
    found = lesson(name)
    top = JOINTS_HIGH + 16
    foot = top + len(ROWS) * ROW
    parts = [_arm(found.joints), *_lines(found.joints)]
    cells = found.share / found.share.max(axis=0)
    cell = WIDTH / len(cells)
    for row, label in enumerate(ROWS):
        y, known = top + row * ROW, found.known[row]
        parts.append(_text(LEFT - 8, y + 13, label, "end"))
        parts.append(f'<rect x="{LEFT}" y="{y}" width="{WIDTH}" height="{ROW - 3}" class="row"/>')
        parts.append(_text(LEFT + WIDTH + 8, y + 13, _sigma(found, row)))
        parts += [
            f'<rect x="{LEFT + column * cell:.0f}" y="{y}" width="{cell:.0f}" height="{ROW - 3}" '
            f'fill="{BLUE}" opacity="{share:.1f}"/>'
            for column, share in enumerate(cells[:, row].tolist())
            if known and share >= 0.05
        ]
    parts += [_text(LEFT + WIDTH * at / SECONDS, foot + 14, f"{at:g} s", "middle") for at in TICKS]
    told = ", ".join(f"{label} {_sigma(found, row)}" for row, label in enumerate(ROWS))
    return _svg(f"{MOTIONS[name].title}. 1 sigma {told}", foot + 20, parts)


def enough() -> str:
    """1 sigma of the position along its worst axis as the log goes on, as SVG."""
    high, width = 220, 360
    least, most = np.log10([0.1, 100.0])
    shown = {"slowly": (GREEN, "2 3"), "two-joints": (ORANGE, "6 3"), "all-joints": (BLUE, "none")}

    def place(seconds: Floats, millimetres: Floats) -> str:
        x = LEFT + width * seconds / SECONDS
        y = high * (most - np.log10(np.minimum(millimetres, 100.0))) / (most - least) + 8
        return " ".join(f"{a:.0f},{b:.0f}" for a, b in zip(x, y, strict=True))

    parts = []
    for value in (0.1, 1.0, 10.0, 100.0):
        (y,) = place(np.zeros(1), np.array([value])).split(",")[1:]
        parts.append(f'<path d="M{LEFT} {y}h{width}" class="line"/>')
        parts.append(_text(LEFT - 8, float(y) + 4, f"{value:g} mm", "end"))
    for name, (colour, dash) in shown.items():
        worst = 1e3 * lesson(name).std_so_far[:, :3].max(axis=1)
        seconds = np.linspace(0.0, SECONDS, len(worst) + 1)[1:]
        points = place(seconds, worst)
        parts.append(
            f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="2" '
            f'stroke-dasharray="{dash}"/>'
        )
        end = float(points.split(",")[-1])
        parts.append(_text(LEFT + width + 6, end + 4, MOTIONS[name].title, colour=colour))
    parts += [_text(LEFT + width * at / SECONDS, high + 26, f"{at:g} s", "middle") for at in TICKS]
    return _svg("1 sigma of the position along its worst axis over the duration", high + 32, parts)


def _sigma(found: Lesson, row: int) -> str:
    if not found.known[row]:
        return "not determined"
    if row < 3:
        return f"± {figures(1e3 * float(found.std[row]), 2)} mm"
    return f"± {figures(float(np.degrees(found.std[row])), 2)}°"


def _arm(joints: Floats) -> str:
    """The arm as a chain of its joints; those that move are filled."""
    places = [(16, 58), (16, 44), (34, 14), (60, 26), (70, 36), (76, 48)]
    links = " ".join(f"{x},{y}" for x, y in places)
    dots = [
        f'<circle cx="{x}" cy="{y}" r="4" class="{"moves" if moves else "rests"}"/>'
        for (x, y), moves in zip(places, np.ptp(joints, axis=0) > 1.0, strict=True)
    ]
    return (
        f'<path d="M6 66h20" class="line"/><polyline points="{links}" class="line"/>{"".join(dots)}'
    )


def _lines(joints: Floats) -> list[str]:
    """The angles of the joints that move."""
    largest = np.abs(joints).max()
    x = LEFT + WIDTH * np.linspace(0.0, 1.0, len(joints))
    y = JOINTS_HIGH * (0.5 - 0.45 * joints / largest) + 4
    parts = [f'<path d="M{LEFT} {JOINTS_HIGH / 2 + 4:.0f}h{WIDTH}" class="line"/>']
    for joint in np.flatnonzero(np.ptp(joints, axis=0) > 1.0):
        points = " ".join(f"{a:.0f},{b:.0f}" for a, b in zip(x, y[:, joint], strict=True))
        parts.append(f'<polyline points="{points}" class="joint"/>')
    parts.append(_text(LEFT + WIDTH + 8, JOINTS_HIGH / 2 + 8, f"joints, up to {largest:.0f}°"))
    return parts


def _text(x: float, y: float, words: str, anchor: str = "start", colour: str = GREY) -> str:
    return f'<text x="{x:.0f}" y="{y:.0f}" text-anchor="{anchor}" fill="{colour}">{words}</text>'


def _svg(label: str, height: float, parts: Sequence[str]) -> str:
    """Greys and colours that can be seen on white and on black."""
    style = (
        f".line {{ stroke: {GREY}; fill: none; opacity: 0.6; }} "
        f".row {{ fill: {GREY}; opacity: 0.12; }} "
        f".joint {{ stroke: {ORANGE}; fill: none; stroke-width: 1.2; }} "
        f".moves {{ fill: {ORANGE}; }} .rests {{ fill: {GREY}; }}"
    )
    body = "\n".join(parts)
    size = f"0 0 {LEFT + WIDTH + RIGHT} {height:.0f}"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{size}" '
        f'font-family="sans-serif" font-size="13" role="img" aria-label="{label}">\n'
        f"<style>{style}</style>\n{body}\n</svg>\n"
    )


def pictures() -> dict[str, str]:
    """Every picture by its name."""
    return {**{name: taught_by(name) for name in MOTIONS}, "enough": enough()}


if __name__ == "__main__":
    for name, picture in pictures().items():
        (PICTURES / f"{name}.svg").write_text(picture, encoding="utf-8")
