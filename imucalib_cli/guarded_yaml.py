"""Read YAML from outside; its size is checked before anything is built.

A few hundred bytes of anchors can expand to gigabytes, and a hundred kilobytes of brackets overflow
the stack of a recursive reader. No file of this tool needs either.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, BinaryIO

import yaml

if TYPE_CHECKING:
    from collections.abc import Hashable

LARGEST = 1 << 22
"""Bytes of a text; a result has some ten thousand for each IMU."""
_DEEPEST = 64
_TOO_DEEP = f"nested more than {_DEEPEST} deep"
_MOST_NODES = 200_000

NUMBERS = (
    (
        "tag:yaml.org,2002:float",
        re.compile(
            r"^[-+]?(?:(?:\.[0-9]+|[0-9]+\.[0-9]*)(?:[eE][-+]?[0-9]+)?|[0-9]+[eE][-+]?[0-9]+"
            r"|\.(?:inf|Inf|INF))$|^\.(?:nan|NaN|NAN)$"
        ),
        list("-+.0123456789"),
    ),
    ("tag:yaml.org,2002:int", re.compile(r"^[-+]?[0-9]+$"), list("-+0123456789")),
)
"""Arguments of add_implicit_resolver for numbers of JSON and YAML 1.2, as 1e-05 but not 1:30."""


class YamlError(ValueError):
    """A text is no YAML, or too much; its message is one line."""


# libyaml, if installed, is ten times as fast
_SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _Loader(_SafeLoader):  # type: ignore[misc]  # one of two classes
    """Reads plain values only; a key that occurs twice in a mapping is an error."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        known: set[tuple[str, str]] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue
            if (key.tag, key.value) in known:
                line = key.start_mark.line + 1
                raise YamlError(f"line {line}: the key {key.value[:40]!r} appears twice")
            known.add((key.tag, key.value))
        mapping: dict[Hashable, Any] = super().construct_mapping(node, deep)
        return mapping

    def construct_int(self, node: yaml.ScalarNode) -> int:
        """A decimal number; 010 is ten."""
        return int(node.value)


_Loader.yaml_implicit_resolvers = {
    first: [pair for pair in resolvers if pair[0] not in {tag for tag, _, _ in NUMBERS}]
    for first, resolvers in _SafeLoader.yaml_implicit_resolvers.items()
}
for _number in NUMBERS:
    _Loader.add_implicit_resolver(*_number)
_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_int)


def load_yaml(text: str) -> list[Any]:
    """The documents of a text as plain Python values.

    Raises:
        YamlError: It is no YAML, too large or too deep, or has aliases or a key twice.
    """
    try:
        _check_bounds(text)
        return list(yaml.load_all(text, Loader=_Loader))
    except YamlError:
        raise
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError) as error:
        words = " ".join(str(error).split())
        if "nesting depth" in words:  # the limit of libyaml, by PyYAML 6.0.4
            words = _TOO_DEEP
        raise YamlError(words) from error


def load_one(text: str) -> Any:
    """The only document of a text; None of an empty one.

    Raises:
        YamlError: As :func:`load_yaml`, or there are several.
    """
    documents = load_yaml(text)
    if len(documents) > 1:
        raise YamlError("several documents (---) where one belongs")
    return documents[0] if documents else None


def read_bounded(file: BinaryIO, errors: str = "strict") -> str:
    """All of a file as text; ``errors`` is as for decode.

    Raises:
        YamlError: It is far too long, such as a log or an endless device.
        UnicodeDecodeError: It is no text.
    """
    content = file.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise YamlError(f"more than {LARGEST >> 20} MB")
    return content.decode("utf-8", errors)


def _check_bounds(text: str) -> None:
    """Parse a text without building anything from it."""
    if len(text) > LARGEST:
        raise YamlError(f"more than {LARGEST >> 20} MB")
    nodes = depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.AliasEvent):
            mark = event.start_mark
            where = "" if mark is None else f"line {mark.line + 1}: "
            raise YamlError(
                f"{where}the alias *{str(event.anchor)[:40]} refers to another value: write it out"
            )
        if isinstance(event, yaml.NodeEvent):
            nodes += 1
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > _DEEPEST:
            raise YamlError(_TOO_DEEP)
        if nodes > _MOST_NODES:
            raise YamlError(f"more than {_MOST_NODES} values")
