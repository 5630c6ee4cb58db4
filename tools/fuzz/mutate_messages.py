"""Damage to messages of a sound recording before it is written: stamps, values, lengths, order.

What these do a sensor, driver, network or recorder may do to part of a log. None changes where
the IMU is, so a result that is ``ok`` must still be right.
"""

from __future__ import annotations

import struct
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


def damage_messages(messages: Sequence[Message], kind: str, rng: Random) -> tuple[list[Said], str]:
    """One to three faults, each of a share of one topic's messages; and what was done."""
    left = list(messages)
    done = []
    for _ in range(rng.choice((1, 1, 2, 3))):
        which, told = _share(left, rng)
        name = rng.choice(tuple(_FAULTS))
        left = _FAULTS[name](left, which, rng)
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


def _each(messages: list[Message], which: list[int], change: object) -> list[Message]:
    assert callable(change)
    for k in which:
        messages[k] = change(messages[k])
    return messages


def _value(messages: list[Message], which: list[int], rng: Random) -> list[Message]:
    """Numbers that nobody measures."""
    column, value = rng.randrange(37), rng.choice(_ODD_VALUES)

    def change(message: Message) -> Message:
        values = values_of(message)
        values[column % len(values)] = value
        if rng.random() < 0.2:
            values = [value] * len(values)
        return with_values(message, values)

    return _each(messages, which, change)


def _scaled(messages: list[Message], which: list[int], rng: Random) -> list[Message]:
    """Another unit, sign or gain for a while."""
    factor = rng.choice((-1.0, 0.0, 1.01, 0.5, 1.1, 57.29577951308232, 0.10197162129779283))
    first = rng.randrange(37)
    count = rng.choice((1, 3, 37))

    def change(message: Message) -> Message:
        values = values_of(message)
        start = first % len(values)
        values[start : start + count] = [factor * v for v in values[start : start + count]]
        return with_values(message, values)

    return _each(messages, which, change)


def _shifted(messages: list[Message], which: list[int], rng: Random) -> list[Message]:
    """Values with an offset for a while: a slipped encoder, a jumping bias."""
    offset, column = rng.choice((1e-4, 0.01, 0.1, 1.0, 6.283185307179586)), rng.randrange(37)

    def change(message: Message) -> Message:
        values = values_of(message)
        values[column % len(values)] += offset
        return with_values(message, values)

    return _each(messages, which, change)


def _frozen(messages: list[Message], which: list[int], _rng: Random) -> list[Message]:
    held = values_of(messages[which[0]])
    return _each(messages, which, lambda message: with_values(message, held))


def _turned(messages: list[Message], which: list[int], rng: Random) -> list[Message]:
    """Values exchanged between fields for a while."""
    shift = rng.randrange(1, 7)

    def change(message: Message) -> Message:
        values = values_of(message)
        return with_values(message, [*values[shift:], *values[:shift]])

    return _each(messages, which, change)


def _stamped(messages: list[Message], which: list[int], rng: Random) -> list[Message]:
    how = rng.randrange(6)
    shift = rng.choice((-3600, -1, -0.02, -0.001, 0.004, 0.5, 30, 1e9))
    first = _stamp(messages[which[0]])

    def change(message: Message) -> Message:
        ns = _stamp(message)
        match how:
            case 0:
                ns = 0
            case 1:
                ns = first
            case 2:
                ns += round(shift * _NS)
            case 3:
                ns += round(rng.uniform(-abs(shift), abs(shift)) * _NS)
            case 4:
                ns = 2 * first - ns
            case _:
                ns = rng.choice((-1, 1, (1 << 62), -(1 << 62), 10**18))
        return _with_stamp(message, ns)

    return _each(messages, which, change)


def _received(messages: list[Message], which: list[int], rng: Random) -> list[Message]:
    how = rng.randrange(4)
    first = messages[which[0]].log_ns

    def change(message: Message) -> Message:
        ns = message.log_ns
        match how:
            case 0:
                ns = 0
            case 1:
                ns = first
            case 2:
                ns += rng.randrange(10**9)
            case _:
                ns = rng.choice((1, (1 << 62), 2**31 * _NS))
        return replace(message, log_ns=ns)

    return _each(messages, which, change)


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


def _renamed(messages: list[Message], which: list[int], rng: Random) -> list[Message]:
    """Letters of frame ids and joint names."""
    old, new = rng.choice(((b"imu", b"IMU"), (b"wrist_1", b"wrist_2"), (b"body", b"bodx"),
                           (b"_", b"\x1b"), (b"o", b"\xff"), (b"e", b"\x00")))  # fmt: skip

    def change(message: Message) -> Message:
        start, _ = _numbers(message)
        return replace(message, cdr=message.cdr[:start].replace(old, new) + message.cdr[start:])

    return _each(messages, which, change)


def _elsewhere(messages: list[Message], which: list[int], rng: Random) -> list[Message]:
    """On another topic, or said to be of another type."""
    topic = rng.choice(("/imu", "/joint_states", "/tf", "/other", "", "/é\n"))
    return _each(messages, which, lambda message: replace(message, topic=topic))


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


_FAULTS = {
    "values": _value,
    "scale": _scaled,
    "offset": _shifted,
    "freeze": _frozen,
    "turn": _turned,
    "stamps": _stamped,
    "receive times": _received,
    "drop": _dropped,
    "repeat": _repeated,
    "reorder": _reordered,
    "exchange": _exchanged,
    "rename": _renamed,
    "move": _elsewhere,
}
