"""Damage that knows nothing of the format: what disks, cables and crashes do."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from random import Random

ODD_NUMBERS = (
    0, 1, 2, 3, 4, 7, 8, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 1 << 20, 0x7FFFFFFF, 1 << 31,
    0xFFFFFFFF, 1 << 32, 1 << 40, (1 << 63) - 1, 1 << 63, (1 << 64) - 1,
)  # fmt: skip
"""Lengths, counts and offsets on which code goes wrong."""


def odd_number(rng: Random, size: int, near: int = 0) -> bytes:
    """A number of ``size`` bytes: an odd one, or one close to ``near``."""
    value = rng.choice(ODD_NUMBERS) if rng.random() < 0.6 else near + rng.randint(-9, 9)
    order = "little" if rng.random() < 0.9 else "big"
    return (value % (1 << 8 * size)).to_bytes(size, order)  # type: ignore[arg-type]


def damage(content: bytes, rng: Random) -> tuple[bytes, str]:
    """One to four faults; the content and what was done to it."""
    data = bytearray(content)
    done = []
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        if not data:
            break
        name = rng.choice(tuple(_FAULTS))
        at = _position(len(data), rng)
        _FAULTS[name](data, at, rng)
        done.append(f"{name} at {at}")
    return bytes(data), ", ".join(done)


def _position(size: int, rng: Random) -> int:
    """Heads, tails and indexes are where lengths live."""
    match rng.randrange(4):
        case 0:
            return rng.randrange(min(size, 700))
        case 1:
            return size - 1 - rng.randrange(min(size, 3000))
        case _:
            return rng.randrange(size)


def _cut(data: bytearray, at: int, _rng: Random) -> None:
    del data[at:]


def _flip(data: bytearray, at: int, rng: Random) -> None:
    data[at] ^= 1 << rng.randrange(8)


def _number(data: bytearray, at: int, rng: Random) -> None:
    size = rng.choice((1, 2, 4, 8))
    data[at : at + size] = odd_number(rng, size, near=data[at])[: len(data) - at]


def _insert(data: bytearray, at: int, rng: Random) -> None:
    data[at:at] = rng.randbytes(rng.choice((1, 4, 13, 512, 5000)))


def _remove(data: bytearray, at: int, rng: Random) -> None:
    del data[at : at + rng.choice((1, 4, 13, 512, 4096, 50_000))]


def _repeat(data: bytearray, at: int, rng: Random) -> None:
    data[at:at] = data[at : at + rng.choice((1, 4, 13, 512, 4096, 50_000))]


def _wipe(data: bytearray, at: int, rng: Random) -> None:
    """A sector or a page that was never written, or holds another file's bytes."""
    size = rng.choice((512, 4096, 65536))
    at = at // size * size
    here = len(data[at : at + size])
    data[at : at + size] = rng.choice((bytes(here), b"\xff" * here, rng.randbytes(here)))


def _zero_tail(data: bytearray, at: int, _rng: Random) -> None:
    data[at:] = bytes(len(data) - at)


def _swap(data: bytearray, at: int, rng: Random) -> None:
    size = rng.choice((8, 512, 4096))
    other = rng.randrange(len(data))
    first, second = data[at : at + size], data[other : other + size]
    size = min(len(first), len(second))
    if abs(at - other) >= size:
        data[at : at + size], data[other : other + size] = second[:size], first[:size]


_FAULTS = {
    "cut": _cut,
    "flip": _flip,
    "number": _number,
    "insert": _insert,
    "remove": _remove,
    "repeat": _repeat,
    "wipe": _wipe,
    "zero tail": _zero_tail,
    "swap": _swap,
}
