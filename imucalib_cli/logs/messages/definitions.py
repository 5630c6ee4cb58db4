"""The fields of a message type by its definition: .msg, a JSON schema, descriptors of protobuf.

Structs within structs are spelled out, with paths by dots. Nothing is named yet: see
:mod:`.shapes`.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from msgspec import Struct, field

from imucalib_cli.logs.messages.table import (
    NUMBER_TYPES,
    Numbers,
    Stamp,
    Structs,
    Text,
    Texts,
    header,
    normalise_type,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sized

    from imucalib_cli.logs.messages.table import Field, NumberType

_DEEPEST = 12
_MOST_FIELDS = 5000
"""Limits of a definition, which may be damaged, when its structs are spelled out."""
_PRIMITIVES: dict[str, NumberType] = {
    "float64": "f8",
    "float32": "f4",
    **{f"int{8 * int(each[1])}": each for each in NUMBER_TYPES if each[0] == "i"},
    **{f"uint{8 * int(each[1])}": each for each in NUMBER_TYPES if each[0] == "u"},
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
}
_TIMES = frozenset({"time", "duration", "builtin_interfaces/Time", "builtin_interfaces/Duration"})
_HEADERS = frozenset({"Header", "std_msgs/Header"})
TIME_PARTS = {10**9: ("sec", "secs", "seconds"), 1: ("nanosec", "nsec", "nsecs", "nanos")}
"""Nanoseconds of each part of a time, and its possible names."""
_FIELD = re.compile(
    r"(?P<type>[A-Za-z][\w/]*)(?:<=\d+)?(?P<array>\[(?:<=)?\d*\])?\s+(?P<name>[A-Za-z]\w*)(?P<more>.*)"
)


class DefinitionError(Exception):
    """A definition that cannot be read."""


def fields_of(type_name: str, encoding: str, definition: str) -> tuple[Field, ...]:
    """The fields of a type, unnamed, by its definition as a log embeds it.

    Raises:
        DefinitionError: It cannot be read, or the package that reads it is not installed.
    """
    spell = {"json": _of_json, "protobuf": _of_protobuf}.get(encoding, _of_msg)
    return spell(type_name, definition, _Spelling(is_cdr=encoding == "cdr"))


class _Spelling(Struct):
    """State of spelling out a definition, with a limit for one that refers to itself."""

    is_cdr: bool
    count: int = 0
    structs: dict[str, list[tuple[str, str, str]]] = field(default_factory=dict)
    """Type, array and name of the fields of each type."""

    def enter(self, fields: Sized, depth: int) -> None:
        """Count a struct with its fields: structs without any nest as fast as others."""
        self.count += 1 + len(fields)
        if depth > _DEEPEST or self.count > _MOST_FIELDS:
            raise DefinitionError("the definition is too large")


def _of_msg(type_name: str, definition: str, spelling: _Spelling) -> tuple[Field, ...]:
    first, *others = re.split(r"^=+[ \t\r]*\n", definition, flags=re.MULTILINE)
    spelling.structs[type_name] = list(_lines(first))
    for other in others:
        head, _, rest = other.partition("\n")
        spelling.structs[normalise_type(head.removeprefix("MSG:").strip())] = list(_lines(rest))
    return _msg_struct(type_name, "", spelling, 0)


def _lines(text: str) -> Iterator[tuple[str, str, str]]:
    for line in text.splitlines():
        text = line.partition("#")[0].strip()
        known = _FIELD.fullmatch(text)
        if known is None:
            if text and "=" not in text:
                raise DefinitionError(f"'{text}' is not a field")
        elif not known["more"].lstrip().startswith("="):  # else a constant
            yield normalise_type(known["type"]), known["array"] or "", known["name"]


def _msg_struct(type_name: str, prefix: str, spelling: _Spelling, depth: int) -> tuple[Field, ...]:
    if type_name not in spelling.structs:
        raise DefinitionError(f"{type_name} is not defined")
    package = type_name.rpartition("/")[0]
    spelling.enter(spelling.structs[type_name], depth)
    fields: list[Field] = []
    for kind, array, name in spelling.structs[type_name]:
        path = f"{prefix}{name}"
        full = kind if "/" in kind or kind in _PRIMITIVES else f"{package}/{kind}"
        count = int(array[1:-1]) if array[1:-1].isdigit() else None
        if not array or kind in _PRIMITIVES:
            leaves = _msg_leaves(kind, path, count if array else 1)
            fields += leaves or _msg_struct(full, f"{path}.", spelling, depth + 1)
        elif kind == "string" and count is None:
            fields.append(Texts(path))
        else:
            inner = _msg_leaves(kind, "", 1) or _msg_struct(full, "", spelling, depth + 1)
            if not inner or count == 0:  # nothing would end a sequence of nothing
                raise DefinitionError(f"{path} has elements without bytes")
            fields.append(Structs(path, inner, count))
    if not fields and spelling.is_cdr:  # a struct without fields has one byte on the wire
        fields.append(Numbers(f"{prefix}structure_needs_at_least_one_member", 1, type="u1"))
    return tuple(fields)


def _msg_leaves(kind: str, path: str, count: int | None) -> tuple[Field, ...]:
    """The fields of a type that needs no definition; none for another struct."""
    if kind in _PRIMITIVES:
        return (Numbers(path, count, type=_PRIMITIVES[kind]),)
    if kind in _HEADERS:
        return header(path)
    if kind in _TIMES:
        return (Stamp(path, is_stamp=False),)
    if kind == "string":
        return (Text(path, is_name=False),)
    if kind == "wstring":
        raise DefinitionError("wstring cannot be read")
    return ()


def _is_time(parts: Iterable[str]) -> bool:
    return all(set(names).intersection(parts) for names in TIME_PARTS.values())


def _of_json(_: str, definition: str, spelling: _Spelling) -> tuple[Field, ...]:
    import json  # late: few logs have such schemas

    try:
        schema = json.loads(definition or "{}")
    except (ValueError, RecursionError) as error:
        raise DefinitionError("no JSON schema") from error
    return _json_struct(schema, schema, "", spelling, 0)


def _json_struct(
    schema: Any, whole: Any, prefix: str, spelling: _Spelling, depth: int
) -> tuple[Field, ...]:
    properties = schema.get("properties") if isinstance(schema, dict) else None
    if not isinstance(properties, dict):
        return ()
    spelling.enter(properties, depth)
    fields: list[Field] = []
    for name, schema_of in properties.items():
        path, described = f"{prefix}{name}", _referred(schema_of, whole)
        kind = described.get("type")
        if kind == "object":
            if _is_time(described.get("properties") or ()):
                fields.append(Stamp(path, is_stamp=False))
            else:
                fields += _json_struct(described, whole, f"{path}.", spelling, depth + 1)
        elif kind == "array":
            items = _referred(described.get("items"), whole)
            if items.get("type") == "object":
                inner = _json_struct(items, whole, "", spelling, depth + 1)
                fields.append(Structs(path, inner))
            elif items.get("type") == "string":
                fields.append(Texts(path))
            else:
                fields.append(Numbers(path, None))
        elif kind == "string":
            fields.append(Text(path))
        elif kind in {"number", "integer"}:
            fields.append(Numbers(path, 1))
    return tuple(fields)


def _referred(schema: Any, whole: Any) -> dict[str, Any]:
    """A schema, or the one within the whole that it refers to."""
    if not isinstance(schema, dict):
        return {}
    reference = schema.get("$ref")
    if not isinstance(reference, str):
        return schema
    found = whole
    for name in reference.removeprefix("#").strip("/").split("/"):
        found = found.get(name) if isinstance(found, dict) else None
    return found if isinstance(found, dict) else {}


def _of_protobuf(type_name: str, definition: str, spelling: _Spelling) -> tuple[Field, ...]:
    from imucalib_cli.logs.messages.protobuf import message_class

    return _protobuf_struct(message_class(type_name, definition).DESCRIPTOR, "", spelling, 0)


def _protobuf_struct(
    descriptor: Any, prefix: str, spelling: _Spelling, depth: int
) -> tuple[Field, ...]:
    spelling.enter(descriptor.fields, depth)
    fields: list[Field] = []
    for each in descriptor.fields:
        path, inner = f"{prefix}{each.name}", each.message_type
        if each.is_repeated if hasattr(each, "is_repeated") else each.label == each.LABEL_REPEATED:
            if inner is not None:
                structs = _protobuf_struct(inner, "", spelling, depth + 1)
                fields.append(Structs(path, structs))
            else:
                is_text = each.cpp_type == each.CPPTYPE_STRING
                fields.append(Texts(path) if is_text else Numbers(path, None))
        elif inner is not None and inner.full_name.startswith("google.protobuf."):
            fields.append(Stamp(path, is_stamp=False))
        elif inner is not None:
            if len(inner.fields) == 2 and _is_time({part.name for part in inner.fields}):
                fields.append(Stamp(path, is_stamp=False))
            else:
                fields += _protobuf_struct(inner, f"{path}.", spelling, depth + 1)
        elif each.cpp_type == each.CPPTYPE_STRING:
            fields.append(Text(path))
        else:
            fields.append(Numbers(path, 1))
    return tuple(fields)
