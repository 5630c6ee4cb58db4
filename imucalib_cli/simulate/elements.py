"""Elements of XML whose attributes are texts, numbers or vectors."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree as ET

import numpy as np


def add(parent: ET.Element, tag: str, **values: Any) -> ET.Element:
    """Add an element; a number gets as many digits as it needs."""
    return ET.SubElement(parent, tag, {name: _text(value) for name, value in values.items()})


def _text(value: Any) -> str:
    if isinstance(value, str):
        return value
    numbers = np.atleast_1d(value).tolist()
    return " ".join(f"{x:.17g}" if float(f"{x:.12g}") != x else f"{x:.12g}" for x in numbers)
