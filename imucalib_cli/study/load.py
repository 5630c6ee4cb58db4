"""Parameters of a study: configs/studies/<name>.yaml, or a file of the user's."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

from imucalib_cli.configuration import build, read_builtin, read_yaml
from imucalib_cli.errors import InputError

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
    short = raw.pop(_QUICK, {})
    if not isinstance(short, dict):
        raise InputError(f"{where}: {_QUICK}: expected keys and values, found {short!r}")
    return build(kind, raw | short if quick else raw, where)
