"""Documents as YAML and JSON text: exact numbers, readable lines."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import yaml

from imucalib_cli.guarded_yaml import NUMBERS

if TYPE_CHECKING:
    from imucalib_cli.results.document import Document


class PlainDumper(yaml.SafeDumper):
    """Nothing aliased, and every text quoted that a reader could take for a number."""

    def ignore_aliases(self, data: Any) -> bool:
        """Write what stands in two places twice."""
        del data
        return True


for _number in NUMBERS:
    PlainDumper.add_implicit_resolver(*_number)


class _Dumper(PlainDumper):
    """Vectors on one line, everything else one item a line."""


def _represent_list(dumper: yaml.SafeDumper, values: list[Any]) -> yaml.Node:
    vector = all(value is None or isinstance(value, (int, float)) for value in values)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=vector)


_Dumper.add_representer(list, _represent_list)


def to_yaml(documents: list[Document]) -> str:
    """One document, or a stream of several separated by ``---``."""
    parts = (
        yaml.dump(
            document,
            Dumper=_Dumper,
            sort_keys=False,
            default_flow_style=False,
            allow_unicode=True,
            width=10_000,  # a vector that is broken over lines is no longer readable
        )
        for document in documents
    )
    return "---\n".join(parts)


def to_json(documents: list[Document]) -> str:
    """One object, or an array of several."""
    content = documents[0] if len(documents) == 1 else documents
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
