"""CSV tables: an IMU or half of one, joints or poses, one row per time, columns named in a header.

Columns are recognised by name, in the spellings of common tools (:data:`_SPELLINGS`). Joints are
called ``joint.NAME``, or anything in a file that has only joints.
"""

from __future__ import annotations

import math
import re
from array import array
from itertools import chain
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from msgspec import Struct, field

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.findings import warning
from imucalib_cli.logs.damage import Tally
from imucalib_cli.logs.reader import HEAD, Catalogue, LogFile, Piece

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence
    from pathlib import Path

    from imucalib_cli.logs.messages.table import Kind, Labels
    from imucalib_cli.logs.reader import Channel, Sink
    from imucalib_cli.logs.streams import Progress

_SPELLINGS = {
    "gyro": ("xyz", "g|w|gyr|gyro|gyroscope|omega|angular_velocity|w_rs_s"),
    "accel": ("xyz", "a|acc|accel|accelerometer|linear_acceleration|a_rs_s"),
    "position": ("xyz", "|p|t|pos|position|translation|p_rs_r"),
    "quaternion": ("xyzw", "q|r|quat|rot|quaternion|orientation|rotation|attitude|q_rs"),
}
"""Axes of each quantity, and the possible prefixes: gx, gyro_x, angular_velocity.x."""
_KINDS: dict[Kind, tuple[str, str, tuple[str, ...], Labels]] = {
    "imu": ("sensor_msgs/Imu", "/imu", ("gyro", "accel"), {"frame_id": ""}),
    "joints": ("sensor_msgs/JointState", "/joint_states", (), {"frame_id": ""}),
    "pose": (
        "geometry_msgs/PoseStamped",
        "/pose",
        ("position", "quaternion"),
        {"frame_id": "world"},
    ),
}
"""Message type, suffix of the topic, quantities and texts; joints have columns of any name."""
_ALONE = frozenset({"gyro", "accel"})
"""Quantities that are a stream without the others of their kind: half of an IMU, whose other half
is in another table."""
_PLACES = {
    prefix + separator + axis: (quantity, number)
    for quantity, (axes, prefixes) in _SPELLINGS.items()
    for prefix in prefixes.split("|")
    for separator in (("", "_", ".") if prefix else ("",))
    for number, axis in enumerate(axes)
}
_UNITS = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9}
"""Nanoseconds."""
_UNIT_WORDS = {
    **dict.fromkeys(("ns", "nsec", "nanoseconds"), "ns"),
    **dict.fromkeys(("us", "µs", "usec", "microseconds"), "us"),
    **dict.fromkeys(("ms", "msec", "milliseconds"), "ms"),
    **dict.fromkeys(("s", "sec", "seconds"), "s"),
}
_OF_ROBOTS = frozenset({"", "-", "1", "m", "rad"})
"""Units of joints and poses that are read as they are; of IMUs the values show the unit."""
_TIME = re.compile(r"(?:t|time|stamp|timestamp)(?:_(ns|us|ms|s))?")
_JOINT = re.compile(r"joint[.:/](.+)")
_LONGEST_STEP_S = 1.0
"""Rows as far apart, if the unit of their times is assumed, show that it is another one: IMUs,
encoders and trackers send at more than 1 Hz, and a count of milliseconds has this step."""
_SHORTEST_STEP_S = 1e-4
"""Rows nearer to each other in a unit show that it is another one: no IMU sends at over 10 kHz."""
_MORE = "..."
"""In place of the names of the last columns, which are not used."""
_SHOWN = 100
"""Letters of a row in a message."""
NAMES = (
    "name a column t (or t_ns), and gx gy gz ax ay az of an IMU, joint.NAME of joints, or "
    "x y z qx qy qz qw of a pose"
)
"""Advice for a table with unknown columns."""
_NO_TIME = "has no time column: name one t, or t_ns, t_us, t_ms or t_s by its unit"
_EARLIEST = ((10**16, "ns"), (10**13, "us"), (10**10, "ms"))
"""Times since 1970 above these limits are in these units: in a larger one they are after 2286."""


class _Group(Struct, eq=False):
    """The columns of one stream, and the values of its rows."""

    kind: Kind
    columns: tuple[int, ...]
    """In the order of the quantities, or of the joints."""
    joints: tuple[str, ...] = ()
    quantities: tuple[str, ...] = ()
    """Those of the kind that the columns hold."""
    named: bool = True
    """Whether the names of its columns say what it is; else it may be any table."""
    times: array[int] = field(default_factory=lambda: array("q"))
    """ns."""
    values: array[float] = field(default_factory=lambda: array("d"))
    bad: int = 0
    """Rows with cells that are not numbers."""

    def take(self, stamp: int, cells: list[str]) -> bool:
        """Keep the numbers of a row; False if they are none.

        Rows of empty cells are skipped: tables of several sensors joined by time have them.
        """
        texts = [cells[each] for each in self.columns]
        try:
            values = [float(each) for each in texts]
        except ValueError:
            self.bad += any(texts)
            return not any(texts)
        self.times.append(stamp)
        self.values.extend(values)
        return True

    def piece(self) -> Piece:
        """All rows."""
        times = np.array(self.times, dtype=np.int64)
        values = np.array(self.values).reshape(len(times), len(self.columns))
        _, _, quantities, texts = _KINDS[self.kind]
        numbers = {}
        for quantity in quantities:
            width = len(_SPELLINGS[quantity][0])
            if quantity in self.quantities:
                numbers[quantity], values = values[:, :width], values[:, width:]
            else:
                numbers[quantity] = np.full((len(times), width), np.nan)
        if self.joints:
            numbers, texts = {"position": values}, {"name": self.joints, **texts}
        return Piece(np.arange(len(times)), times, times, texts, numbers)


class CsvFile(LogFile):
    """One table.

    Args:
        path: The file; its header has been looked at.
        topic: Topic of its streams; empty for the file's name.
        unit: Unit of times, if the header does not name it.

    Raises:
        InputError: The unit of its times is not clear, or a joint has two columns.
    """

    FORMAT: ClassVar[str] = "a CSV table"
    IS_TEXT: ClassVar[bool] = True
    COLUMNS: ClassVar[tuple[str, ...]] = ()
    """Names of the columns where the file has no header."""
    HAS_MORE: ClassVar[bool] = False
    """Whether rows may have more cells than these, which are not used."""
    IS_NAMED_BY_USER: ClassVar[bool] = False
    guessed: tuple[str, ...]
    """Columns of unknown names, which are taken for joints."""

    def __init__(self, path: Path, topic: str = "", unit: str = "") -> None:
        super().__init__(path)
        self._topic = topic
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            filled = (line for line in file if line.strip())
            names, separator, lines = _header(filled, self.COLUMNS)
            layout = _layout(names)
            if layout is None:
                raise InputError(f"{path}: its columns are not known: {NAMES}")
            time, named_unit, self._groups = layout
            self.guessed = () if any(each.named for each in self._groups) else tuple(names)
            self._check_columns(names, time)
            self._take(lines, separator, time, named_unit or unit)

    @classmethod
    def matches(cls, head: bytes, path: Path) -> bool:  # noqa: ARG003 - content decides
        """Whether a file begins with a header whose columns are known.

        Columns of other names may be joints if the first row has as many numbers.
        """
        if b"\0" in head:
            return False
        lines = _filled(head)
        if not lines:
            return False
        names, separator, rows = _header(iter(lines), ())
        if cls.COLUMNS:
            more = len(names) - len(cls.COLUMNS)
            return (more == 0 or (more > 0 and cls.HAS_MORE)) and _is_number(names[0])
        layout = _layout(names) if len(names) > 1 and separator != " " else None
        if layout is None or any(group.named for group in layout[2]):
            return layout is not None
        if len(lines) < 3 and len(head) == HEAD:
            return True  # too many columns to see the first row whole
        row = next((line for line in rows if not line.startswith(("#", "%"))), "")
        cells = _cells(row.replace(",", ".") if separator == ";" else row, separator)
        return len(cells) == len(names) and all(map(_is_number, filter(None, cells)))

    @classmethod
    def named_kinds(cls, head: bytes) -> set[Kind]:
        """Streams whose columns a header, or the format, names."""
        layout = _layout(_header(iter(_filled(head)), cls.COLUMNS)[0])
        return set() if layout is None else {each.kind for each in layout[2] if each.named}

    @classmethod
    def with_columns(cls, names: Sequence[str]) -> type[CsvFile]:
        """Return a reader of tables without a header; further columns may be ``...`` at the end.

        Raises:
            ChoiceError: The names do not make up any stream.
        """
        more = tuple(names[-1:]) == (_MORE,)
        named = tuple(names[:-1] if more else names)
        if _layout(named) is None:
            raise ChoiceError(f"--csv-columns {','.join(names)}: {NAMES}")
        known = {"COLUMNS": named, "HAS_MORE": more, "IS_NAMED_BY_USER": True}
        return type("HeadlessCsvFile", (cls,), known)

    @classmethod
    def why_not(cls, head: bytes, name: str) -> str:
        """Why the columns of a table are not known, or not those that the user names."""
        names = _header(iter(_filled(head)), ())[0]
        if b"\0" in head or not cls.IS_NAMED_BY_USER:
            timed = _layout(["t", *names])
            if timed is not None and any(group.named for group in timed[2]):
                return _NO_TIME
            has_numbers = b"\0" not in head and len(names) > 2 and all(map(_is_number, names))
            is_table = name.lower().endswith(".csv") or has_numbers
            headless = ", or use --csv-columns" if has_numbers else ""
            known = f"has no header with known columns: {NAMES}{headless}"
            return known if is_table else ""
        if names and _is_number(names[0]):
            count = len(cls.COLUMNS)
            return (
                f"has rows of {len(names)} cells, and --csv-columns names {count}: name each, - "
                f"for one that is not used, or end with {_MORE} if the last ones are not"
            )
        missing = ", ".join(each for each in cls.COLUMNS if each not in {"-", *names})
        which = f" without the columns {missing}" if missing else " of unknown columns"
        return (
            f"begins with a header{which}, and --csv-columns is for tables without one: rename the "
            "columns there, or remove the header"
        )

    @property
    def channels(self) -> tuple[Channel, ...]:  # type: ignore[override]  # the path may change
        """Streams of an IMU, joint states and poses, depending on the columns."""
        topic = self._topic or "/" + re.sub(r"\W+", "_", self.path.stem)
        catalogue, tallies = Catalogue(), {}
        for number, group in enumerate(self._groups):
            type_name, ending, _, _ = _KINDS[group.kind]
            name = topic + (ending if len(self._groups) > 1 else "")
            catalogue.publishers[number] = (number, name, "text")
            catalogue.schemas[number] = (type_name, "")
            tallies[number] = Tally(group.bad)
            tallies[number].add(np.array(group.times, dtype=np.int64))
        return catalogue.channels(tallies)

    def read(self, wanted: Collection[Channel], sink: Sink, progress: Progress) -> None:
        """Pass the rows of the wanted channels to the sink."""
        for channel in wanted:
            group = self._groups[channel.number]
            sink.add_decoded(channel, group.piece(), group.bad)
        progress(1.0)

    def _take(self, lines: Iterable[str], separator: str, time: int, unit: str) -> None:
        """Read the numbers of all rows."""
        named = bool(unit)
        width = 1 + max(time, *(max(each.columns) for each in self._groups))
        for row, line in enumerate(lines, 1):
            if line.startswith(("#", "%")):
                continue
            cells = _cells(line, separator)
            try:
                unit = unit or _guess(float(cells[time]))
                stamp = _nanoseconds(cells[time], unit)
            except (ValueError, OverflowError, IndexError):
                for group in self._groups:
                    group.bad += 1
                self._lose(row, line, separator)
                continue
            cells += [""] * (width - len(cells))
            taken = [group.take(stamp, cells) for group in self._groups]
            if not all(taken):
                self._lose(row, line, separator)
        if not named and unit:
            self._check_unit(unit)

    def _lose(self, row: int, line: str, separator: str) -> None:
        """Report the first row that cannot be read."""
        if not self.losses:
            comma = separator != "," and "," in line
            values = {"row": row, "text": line.strip()[:_SHOWN], "comma": comma}
            self.losses.append(warning("log.row_unreadable", **values))

    def _check_columns(self, names: Sequence[str], time: int) -> None:
        """Refuse two columns of one quantity, since either may be right, and units not read."""
        cells = [_name_and_unit(each) for each in names]
        unit = cells[time][1]
        if unit and unit not in _UNIT_WORDS:
            raise InputError(
                f"{self.path}: its times are in {unit!r}, which is not known: name their column "
                "t_ns, t_us, t_ms or t_s"
            )
        places = [_PLACES.get(name.lower()) for name, _ in cells]
        for group in self._groups:
            labels = group.joints or tuple(cells[each][0] for each in group.columns)
            what = "the joint" if group.joints else "the same as"
            for column, name in zip(group.columns, labels, strict=True):
                by_name, by_place = labels.count(name), places.count(places[column])
                if (by_name if group.joints else by_place) > 1:
                    raise InputError(f"{self.path}: two columns name {what} {name}: remove one")
                unit = cells[column][1]
                if group.kind != "imu" and unit not in _OF_ROBOTS:
                    raise InputError(
                        f"{self.path}: {name} is in {unit!r}: joints and poses are read in rad "
                        "and m, so convert it"
                    )

    def _check_unit(self, unit: str) -> None:
        """Take a smaller unit if only that one gives the rates of sensors; refuse unclear ones.

        Times since 1970 are recognised by their size, but times since a computer's start in a
        smaller unit may be as large: nanoseconds of twelve days are microseconds of 33 years.
        """
        filled = [each for each in self._groups if len(each.times) > 1]
        steps = [float(np.median(np.diff(each.times))) * 1e-9 for each in filled]
        longest = max(steps, default=0.0)
        if longest < _LONGEST_STEP_S:
            return
        sound = [
            ratio
            for ratio in (_UNITS[unit] // each for each in _UNITS.values())
            if longest <= ratio * _LONGEST_STEP_S and min(steps) >= ratio * _SHORTEST_STEP_S
        ]
        if unit == "s" or len(sound) > 1:
            raise InputError(
                f"{self.path}: its rows would be {longest:g} s apart: give the unit of its "
                "times in the name of their column, t_ns, t_us, t_ms or t_s"
            )
        for group in self._groups if sound else ():
            group.times = array("q", (each // sound[0] for each in group.times))


def _filled(head: bytes) -> list[str]:
    """The lines of a file's first bytes that are not blank."""
    return [line for line in head.decode("utf-8-sig", "replace").splitlines() if line.strip()]


def _header(lines: Iterable[str], columns: Sequence[str]) -> tuple[list[str], str, Iterable[str]]:
    """Column names, separator, and the remaining lines."""
    remaining = iter(lines)
    first = next(remaining, "")
    separator = max(",;\t ", key=lambda each: (each != " ") * first.count(each))
    separator = separator if separator in first else " "
    if columns:
        return list(columns), separator, chain([first], remaining)
    return _cells(first.lstrip("#% \t"), separator), separator, remaining


def _cells(line: str, separator: str) -> list[str]:
    if '"' in line:
        line = line.replace('"', "")
    if separator == " ":
        return line.split()
    return [each.strip() for each in line.split(separator)]


def _layout(names: Sequence[str]) -> tuple[int, str, list[_Group]] | None:
    """Column of the time, its unit (empty if the name does not contain it), and the streams.

    None if there is no time column, or nothing but time.
    """
    cells = [_name_and_unit(each) for each in names]
    bare = [name for name, _ in cells]
    times = {k: known for k, name in enumerate(bare) if (known := _TIME.fullmatch(name.lower()))}
    places: dict[tuple[str, int], int] = {}
    for k, name in enumerate(bare):
        if name.lower() in _PLACES:
            places.setdefault(_PLACES[name.lower()], k)
    groups, named = [], True
    for kind, (_, _, quantities, _) in _KINDS.items():
        whole = {each: _columns(each, places) for each in quantities}
        there = tuple(each for each, columns in whole.items() if columns)
        if there and (there == quantities or _ALONE.issuperset(there)):
            columns = tuple(chain.from_iterable(whole[each] for each in there))
            groups.append(_Group(kind, columns, quantities=there))
    joints = [(known[1], k) for k, name in enumerate(bare) if (known := _JOINT.fullmatch(name))]
    if not groups and not joints:
        named = False
        further = [(name, k) for k, name in enumerate(bare) if k not in times]
        joints = [(name, k) for name, k in further if name.strip("-")]
    if joints:
        known_as, at = zip(*joints, strict=True)
        groups.append(_Group("joints", at, known_as, named=named))
    if not times or not groups:
        return None
    time, known = next(iter(times.items()))
    unit = known[1] or _UNIT_WORDS.get(cells[time][1], "")
    return time, unit, groups


def _name_and_unit(column: str) -> tuple[str, str]:
    """Of ``field.NAME [UNIT]`` or ``NAME (UNIT)``; the unit is empty where none is given."""
    name, _, unit = column.removeprefix("field.").replace("(", "[").partition("[")
    return name.strip(), unit.rstrip(")] ").strip().lower()


def _columns(quantity: str, places: Mapping[tuple[str, int], int]) -> tuple[int, ...]:
    """Columns of all axes of a quantity; none if one is missing."""
    axes = [(quantity, axis) for axis in range(len(_SPELLINGS[quantity][0]))]
    return tuple(places[each] for each in axes) if places.keys() >= set(axes) else ()


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _guess(time: float) -> str:
    """Unit of a time, by its size."""
    if not math.isfinite(time):
        raise ValueError(time)
    return next((unit for least, unit in _EARLIEST if abs(time) >= least), "s")


def _nanoseconds(text: str, unit: str) -> int:
    """A time in ns, exact where written in decimals; ValueError or OverflowError if it is none."""
    whole, _, fraction = text.partition(".")
    if whole.isdecimal() and (fraction.isdecimal() or not fraction):
        found = int(whole) * _UNITS[unit]
        found += int(fraction[:9].ljust(9, "0")) * _UNITS[unit] // 10**9
    else:
        found = round(float(text) * _UNITS[unit])
    if abs(found) >= 1 << 63:
        raise OverflowError(text)
    return found
