"""What the files of this tool are made of: mappings with typed keys, and numbers without nan.

They stand below the estimator, so that what it finds need not be copied to be written.
"""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct

Vector3 = Annotated[list[float], Meta(min_length=3, max_length=3)]


class Tree(Struct, frozen=True):
    """A mapping of the document."""


def plain(value: Any) -> Any:
    """Numbers and arrays as floats, null where not finite; texts stay."""
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, (np.ndarray, list, tuple)):
        return [plain(each) for each in value]
    # minus zero becomes zero: its sign means nothing
    return float(value) + 0.0 if math.isfinite(value) else None
