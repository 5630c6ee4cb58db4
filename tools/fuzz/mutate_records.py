"""What damage to records has in common, whichever file they are of."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

from tools.fuzz.mutate_bytes import damage

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from random import Random


@dataclass(kw_only=True)
class Record:
    """A record, which may be a chunk of others."""

    body: bytes
    inner: list[Any] = field(default_factory=list)
    lie: bool = False
    """The body stays as it is, though the inner records say otherwise."""

    @property
    def kind(self) -> int:
        """Its opcode."""
        raise NotImplementedError


R = TypeVar("R", bound=Record)


def damage_records(
    records: list[R], faults: Mapping[str, Callable[[list[R], int, Random], None]], rng: Random
) -> str:
    """One to three faults, in chunks or outside; what was done."""
    done = []
    for _ in range(rng.choice((1, 1, 2, 3))):
        chunks = [each for each in records if each.inner]
        home: list[R] = records
        if chunks and rng.random() < 0.6:
            home = rng.choice(chunks).inner
        if not home:
            continue
        name = rng.choice(tuple(faults))
        at = rng.randrange(len(home)) if rng.random() < 0.7 else _rare(home, rng)
        done.append(f"{name} of record {at} (kind {home[at].kind})")
        faults[name](home, at, rng)
    return ", ".join(done)


def _rare(home: list[R], rng: Random) -> int:
    """A record of a kind of which there are few, such as schemas and the footer."""
    kind = rng.choice(sorted({each.kind for each in home}))
    return rng.choice([k for k, each in enumerate(home) if each.kind == kind])


def drop(home: list[Any], at: int, rng: Random) -> None:
    """Leave records out."""
    del home[at : at + rng.choice((1, 1, 3, 20))]


def repeat(home: list[Any], at: int, rng: Random) -> None:
    """Write records twice or thrice."""
    home[at:at] = home[at : at + rng.choice((1, 1, 3, 20))] * rng.choice((1, 1, 2))


def move(home: list[Any], at: int, rng: Random) -> None:
    """Put a record elsewhere."""
    home.insert(rng.randrange(len(home)), home.pop(at))


def inside(home: list[Any], at: int, rng: Random) -> None:
    """Damage the bytes of a record."""
    home[at].body, _ = damage(home[at].body, rng)
    home[at].lie = True
