"""Configurations from the package or from the user's YAML, with every key checked."""

from __future__ import annotations

import math
from dataclasses import MISSING, fields, is_dataclass
from importlib import resources
from pathlib import Path
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.guarded_yaml import YamlError, load_one, read_bounded

if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.abc import Traversable

T = TypeVar("T")


def builtin_names(folder: str = "") -> list[str]:
    """Names, without suffix, of the YAML files of a folder of configs/."""
    names = (Path(file.name) for file in configs_folder().joinpath(folder).iterdir())
    return sorted(name.stem for name in names if name.suffix == ".yaml")


def read_builtin(name: str) -> dict[str, Any]:
    """Content of configs/<name>.yaml; the name may have folders."""
    text = configs_folder().joinpath(f"{name}.yaml").read_text("utf-8")
    loaded: dict[str, Any] = load_one(text)
    return loaded


def read_yaml(path: Path) -> dict[str, Any]:
    """Keys and values of the user's file.

    Raises:
        InputError: It cannot be read or holds something else.
    """
    try:
        with path.open("rb") as file:
            loaded = load_one(read_bounded(file))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; name a readable YAML file") from error
    except (YamlError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not YAML ({error}); see configs/ for examples") from error
    if not isinstance(loaded, dict):
        raise InputError(f"{path}: holds no keys and values; see configs/ for examples")
    return loaded


def load_named(
    kind: type[T], name_or_file: str | Path, names: Sequence[str], *, folder: str, unknown: str
) -> T:
    """Read a dataclass by its name in configs/, or from the user's own YAML file.

    Args:
        kind: The dataclass.
        name_or_file: One of the names, or a path with the suffix of YAML.
        names: The names in the package.
        folder: Their folder in configs/; empty for configs/ itself.
        unknown: Message for another name, with ``{name}`` and ``{names}``.

    Raises:
        ChoiceError: There is no such name.
        InputError: The file cannot be read, or as :func:`build`.
    """
    name = str(name_or_file)
    if Path(name).suffix in {".yaml", ".yml"}:
        return build(kind, read_yaml(Path(name)), name)
    if name not in names:
        raise ChoiceError(unknown.format(name=name, names=", ".join(names)))
    where = f"{folder}/{name}" if folder else name
    return build(kind, read_builtin(where), f"{where}.yaml")


def build(kind: type[T], raw: object, where: str) -> T:
    """Make a dataclass from parsed YAML, with every key and type checked.

    Raises:
        InputError: A key, which it names, is missing, unknown or of another type, or breaks a rule
            of the dataclass, which raises ValueError.
    """
    if not isinstance(raw, dict):
        raise InputError(f"{where}: expected keys and values, found {raw!r}")
    hints = get_type_hints(kind)
    known = {field.name: field for field in fields(kind)}  # type: ignore[arg-type]
    unknown = sorted(set(raw) - set(known), key=str)
    if unknown:
        raise InputError(f"{where}: unknown key {unknown[0]}; known are {', '.join(known)}")
    missing = [
        name
        for name, field in known.items()
        if name not in raw and field.default is MISSING and field.default_factory is MISSING
    ]
    if missing:
        keys = f"key {missing[0]} is" if len(missing) == 1 else f"keys {', '.join(missing)} are"
        raise InputError(f"{where}: {keys} missing; see configs/ for an example")
    values = {n: _convert(hints[n], v, f"{where}: {n}") for n, v in raw.items()}
    try:
        return kind(**values)
    except ValueError as error:  # a rule of the dataclass
        raise InputError(f"{where}: {error}") from error


def _convert(hint: Any, value: object, where: str) -> Any:
    origin, args = get_origin(hint), get_args(hint)
    if origin is UnionType:  # the only unions are "or None"
        return None if value is None and NoneType in args else _convert(args[0], value, where)
    if isinstance(hint, type) and is_dataclass(hint):
        return build(hint, value, where)
    if origin is tuple and isinstance(value, list):
        kinds = [args[0]] * len(value) if args[-1] is Ellipsis else list(args)
        if len(kinds) == len(value):
            return tuple(_convert(k, v, where) for k, v in zip(kinds, value, strict=True))
    # bool is an int in Python, but not here
    if hint is float and type(value) in {int, float} and math.isfinite(value):  # type: ignore[arg-type]
        return float(value)  # type: ignore[arg-type]
    if (hint in {bool, int, str} and type(value) is hint) or (origin is Literal and value in args):
        return value
    raise InputError(f"{where}: {value!r} does not fit; see configs/ for an example")


def configs_folder() -> Traversable:
    """The repository's configs/, installed as imucalib_cli.configs."""
    try:
        return resources.files("imucalib_cli.configs")
    except ModuleNotFoundError:  # run from the source tree without an install
        return Path(__file__).parents[1] / "configs"
