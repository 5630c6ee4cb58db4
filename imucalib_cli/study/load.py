"""Parameters of a study: configs/studies/<name>.yaml, or a file of the user's."""

from __future__ import annotations

from dataclasses import MISSING, fields, is_dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from imucalib_cli.configuration import build, read_builtin, read_yaml
from imucalib_cli.errors import InputError
from imucalib_cli.simulate.options import NoiseOptions

if TYPE_CHECKING:
    from pathlib import Path

T = TypeVar("T")

_QUICK = "quick"


def load_parameters(kind: type[T], name: str, file: Path | None, *, quick: bool) -> T:
    """Read a study's parameters; its ``quick`` section replaces some of them for a short run.

    Args:
        kind: Dataclass of the study's parameters.
        name: Of the study.
        file: Instead of the built-in one.
        quick: Whether to take the short run's.

    Raises:
        InputError: A key is missing, unknown or of another type; names it.
    """
    where = f"{name}.yaml" if file is None else str(file)
    raw: dict[str, Any] = read_builtin(f"studies/{name}") if file is None else read_yaml(file)
    short = raw.pop(_QUICK, None)
    if quick and short is None:
        raise InputError(f"{where}: has no section {_QUICK}: state what a short run changes there")
    if not isinstance(short, dict | None):
        raise InputError(f"{where}: {_QUICK}: expected keys and values, found {short!r}")
    parameters = build(kind, raw | short if quick and short else raw, where)
    _see_counts(parameters, where)
    return parameters


def _see_counts(parameters: object, where: str) -> None:
    """Refuse empty lists, but for those that may be left out, and counts below one.

    Raises:
        InputError: Names the key.
    """
    for part in fields(parameters):  # type: ignore[arg-type]
        value = getattr(parameters, part.name)
        if value == () and part.default is MISSING:
            raise InputError(f"{where}: {part.name}: an empty list; there must be one value")
        if part.name.endswith("seed"):
            continue
        for item in value if isinstance(value, tuple) else (value,):
            if isinstance(item, int) and not isinstance(item, bool) and item < 1:
                raise InputError(f"{where}: {part.name}: {item} is no count; 1 or more")
            if is_dataclass(item) and not isinstance(item, NoiseOptions):
                _see_counts(item, f"{where}: {part.name}")
