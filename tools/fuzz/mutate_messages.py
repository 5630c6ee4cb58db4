"""Damage to messages of a sound recording before it is written: stamps, values, lengths, order.

What these do a sensor, driver, network or recorder may do to part of a log. None changes where
the IMU is, so a result that is ``ok`` must still be right.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from tools.fuzz.mutate_bytes import damage, odd_number
from tools.fuzz.seeds import IMU, JOINTS, Message, as_said

if TYPE_CHECKING:
    from collections.abc import Sequence
    from random import Random

    from tests.logs.logs_samples import Said

_ODD_VALUES = (
    0.0, -0.0, 1.0, -1.0, 1e-310, 1e9, 1e20, -1e155, 1e300, 1.7e308,
    float("nan"), float("inf"), float("-inf"), 9.80665, 360.0, 0.1,
)  # fmt: skip
_NS = 1_000_000_000
ValuesChange = Callable[[list[float]], list[float]]
MessageChange = Callable[[Message], Message]


def damage_messages(messages: Sequence[Message], kind: str, rng: Random) -> tuple[list[Said], str]:
    """One to three faults, each of a share of one topic's messages; and what was done."""
    left = list(messages)
    done = []
    for _ in range(rng.choice((1, 1, 2, 3))):
        which, told = _share(left, rng)
        name = rng.choice((*_IN_VALUES, *_IN_MESSAGES, *_IN_ORDER))
        left = _faulty(name, left, which, rng)
        done.append(f"{name} of {told}")
        if not left:
            break
    said = as_said(tuple(left), kind)
    if rng.random() < 0.3 and said:
        which = [k for k in range(len(said)) if rng.random() < rng.choice((0.002, 0.3))]
        for k in which:
            said[k].raw = _raw(said[k].raw or b"", rng)
        done.append(f"raw bytes of {len(which)}")
    return said, ", ".join(done)


def _share(messages: list[Message], rng: Random) -> tuple[list[int], str]:
    """Places of some messages of one topic: scattered ones or a run of them."""
    topic = rng.choice(sorted({each.topic for each in messages}))
    of_topic = [k for k, each in enumerate(messages) if each.topic == topic]
    share = rng.choice((0.0, 0.003, 0.01, 0.05, 0.2, 0.5))
    if rng.random() < 0.5:
        count = max(1, round(share * len(of_topic)))
        start = rng.randrange(len(of_topic))
        chosen = of_topic[start : start + count]
        return chosen, f"{len(chosen)} of {topic} in a row"
    chosen = [k for k in of_topic if rng.random() < share] or [rng.choice(of_topic)]
    return chosen, f"{len(chosen)} of {topic}"


def _numbers(message: Message) -> tuple[int, int]:
    """Where the numbers that matter begin, and how many there are (CDR, as the scenes have it)."""
    if message.type == IMU:
        return len(message.cdr) - 8 * 37, 37
    if message.type == JOINTS:
        return len(message.cdr) - 8 - 8 * 6, 6
    return len(message.cdr) - 8 * 7, 7


def values_of(message: Message) -> list[float]:
    """The numbers of a message that matter."""
    start, count = _numbers(message)
    return list(struct.unpack_from(f"<{count}d", message.cdr, start))


def with_values(message: Message, values: Sequence[float]) -> Message:
    """The same message with others."""
    start, count = _numbers(message)
    fitting = [*values, *[0.0] * count][:count]  # a topic may hold messages of two types by now
    packed = struct.pack(f"<{count}d", *fitting)
    return replace(message, cdr=message.cdr[:start] + packed + message.cdr[start + 8 * count :])


def _stamp(message: Message) -> int:
    seconds, nanoseconds = struct.unpack_from("<iI", message.cdr, _stamp_at(message))
    return int(seconds) * _NS + int(nanoseconds)


def _stamp_at(message: Message) -> int:
    return 8 if message.type.endswith("TFMessage") else 4


def _with_stamp(message: Message, ns: int) -> Message:
    at = _stamp_at(message)
    seconds = max(-(1 << 31), min(ns // _NS, (1 << 31) - 1))
    packed = struct.pack("<iI", seconds, ns % _NS)
    return replace(message, cdr=message.cdr[:at] + packed + message.cdr[at + 8 :])


def _odd(rng: Random) -> ValuesChange:
    """Numbers that nobody measures."""
    column, value = rng.randrange(37), rng.choice(_ODD_VALUES)

    def change(values: list[float]) -> list[float]:
        values[column % len(values)] = value
        return [value] * len(values) if rng.random() < 0.2 else values

    return change


def _scaled(rng: Random) -> ValuesChange:
    """Another unit, sign or gain for a while."""
    factor = rng.choice((-1.0, 0.0, 1.01, 0.5, 1.1, 57.29577951308232, 0.10197162129779283))
    first, count = rng.randrange(37), rng.choice((1, 3, 37))

    def change(values: list[float]) -> list[float]:
        start = first % len(values)
        values[start : start + count] = [factor * v for v in values[start : start + count]]
        return values

    return change


def _shifted(rng: Random) -> ValuesChange:
    """Values with an offset for a while: a slipped encoder, a jumping bias."""
    offset, column = rng.choice((1e-4, 0.01, 0.1, 1.0, 6.283185307179586)), rng.randrange(37)

    def change(values: list[float]) -> list[float]:
        values[column % len(values)] += offset
        return values

    return change


def _frozen(_rng: Random) -> ValuesChange:
    held: list[float] = []

    def change(values: list[float]) -> list[float]:
        held[:] = held or values
        return held

    return change


def _turned(rng: Random) -> ValuesChange:
    """Values exchanged between fields for a while."""
    shift = rng.randrange(1, 7)
    return lambda values: [*values[shift:], *values[:shift]]


def _stamped(rng: Random, first: Message) -> MessageChange:
    how, start = rng.randrange(6), _stamp(first)
    shift = rng.choice((-3600, -1, -0.02, -0.001, 0.004, 0.5, 30, 1e9))

    def change(message: Message) -> Message:
        ns = _stamp(message)
        stamps = (
            0,
            start,
            ns + round(shift * _NS),
            ns + round(rng.uniform(-abs(shift), abs(shift)) * _NS),
            2 * start - ns,
            rng.choice((-1, 1, (1 << 62), -(1 << 62), 10**18)),
        )
        return _with_stamp(message, stamps[how])

    return change


def _received(rng: Random, first: Message) -> MessageChange:
    how = rng.randrange(4)

    def change(message: Message) -> Message:
        later = message.log_ns + rng.randrange(10**9)
        times = (0, first.log_ns, later, rng.choice((1, (1 << 62), 2**31 * _NS)))
        return replace(message, log_ns=times[how])

    return change


def _renamed(rng: Random, _first: Message) -> MessageChange:
    """Letters of frame ids and joint names."""
    old, new = rng.choice(((b"imu", b"IMU"), (b"wrist_1", b"wrist_2"), (b"body", b"bodx"),
                           (b"_", b"\x1b"), (b"o", b"\xff"), (b"e", b"\x00")))  # fmt: skip

    def change(message: Message) -> Message:
        start, _ = _numbers(message)
        return replace(message, cdr=message.cdr[:start].replace(old, new) + message.cdr[start:])

    return change


def _elsewhere(rng: Random, _first: Message) -> MessageChange:
    """On another topic, or said to be of another type."""
    topic = rng.choice(("/imu", "/joint_states", "/tf", "/other", "", "/é\n"))
    return lambda message: replace(message, topic=topic)


def _dropped(messages: list[Message], which: list[int], _rng: Random) -> list[Message]:
    gone = set(which)
    return [each for k, each in enumerate(messages) if k not in gone]


def _repeated(messages: list[Message], which: list[int], rng: Random) -> list[Message]:
    again = set(which)
    count = rng.choice((2, 2, 5))
    return [each for k, each in enumerate(messages) for _ in range(count if k in again else 1)]


def _reordered(messages: list[Message], which: list[int], rng: Random) -> list[Message]:
    moved = [messages[k] for k in which]
    rng.shuffle(moved)
    for k, message in zip(which, moved, strict=True):
        messages[k] = message
    return messages


def _exchanged(messages: list[Message], which: list[int], _rng: Random) -> list[Message]:
    """Payloads in another order than their stamps."""
    payloads = [values_of(messages[k]) for k in reversed(which)]
    for k, values in zip(which, payloads, strict=True):
        messages[k] = with_values(messages[k], values)
    return messages


def _raw(payload: bytes, rng: Random) -> bytes:
    match rng.randrange(5):
        case 0:
            return b""
        case 1:
            return payload[: rng.randrange(len(payload) + 1)]
        case 2:
            at = rng.randrange(min(len(payload), 40) + 1)
            return payload[:at] + odd_number(rng, 4) + payload[at + 4 :]
        case 3:
            return payload + rng.randbytes(rng.choice((1, 3, 4, 100)))
        case _:
            return damage(payload, rng)[0] if payload else b""


_IN_VALUES: dict[str, Callable[[Random], ValuesChange]] = {
    "values": _odd,
    "scale": _scaled,
    "offset": _shifted,
    "freeze": _frozen,
    "turn": _turned,
}
_IN_MESSAGES: dict[str, Callable[[Random, Message], MessageChange]] = {
    "stamps": _stamped,
    "receive times": _received,
    "rename": _renamed,
    "move": _elsewhere,
}
_IN_ORDER: dict[str, Callable[[list[Message], list[int], Random], list[Message]]] = {
    "drop": _dropped,
    "repeat": _repeated,
    "reorder": _reordered,
    "exchange": _exchanged,
}


def _faulty(name: str, messages: list[Message], which: list[int], rng: Random) -> list[Message]:
    """Messages with a fault in some of them."""
    if name in _IN_ORDER:
        return _IN_ORDER[name](messages, which, rng)
    if name in _IN_VALUES:
        changed = _IN_VALUES[name](rng)
        for k in which:
            messages[k] = with_values(messages[k], changed(values_of(messages[k])))
    else:
        change = _IN_MESSAGES[name](rng, messages[which[0]])
        for k in which:
            messages[k] = change(messages[k])
    return messages
