"""Classes of protobuf messages by the descriptors that a log embeds."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from typing import Any

from imucalib_cli.errors import ImucalibError
from imucalib_cli.optional import optional

EXTRA = "pip install 'imucalib[protobuf]'"


def is_installed() -> bool:
    """Whether messages in protobuf can be read."""
    try:
        return find_spec("google.protobuf") is not None
    except ModuleNotFoundError:
        return False


def is_damaged(type_name: str, definition: str) -> bool:
    """Whether the descriptors of a type are damaged."""
    try:
        message_class(type_name, definition)
    except ImucalibError:  # protobuf is not installed
        return False
    except Exception:  # noqa: BLE001 - of many kinds
        return True
    return False


@cache
def message_class(type_name: str, definition: str) -> Any:
    """The class of a type.

    Args:
        type_name: Such as foxglove.FrameTransform.
        definition: A FileDescriptorSet, a character a byte.

    Raises:
        InputError: protobuf is not installed.
        Exception: Of many kinds: the descriptors are damaged.
    """
    descriptors, pools, classes = (
        optional(f"google.protobuf.{name}", "messages in protobuf need", "protobuf")
        for name in ("descriptor_pb2", "descriptor_pool", "message_factory")
    )
    files = descriptors.FileDescriptorSet.FromString(definition.encode("latin-1")).file
    pool = pools.DescriptorPool()
    classes.GetMessages(files, pool)  # adds each file after those that it builds on
    return classes.GetMessageClass(pool.FindMessageTypeByName(type_name))
