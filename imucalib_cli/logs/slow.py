"""Decode messages one by one through rosbags: those the bulk decoder cannot read, and in tests."""

from __future__ import annotations

import contextlib
from dataclasses import fields as dataclass_fields
from dataclasses import is_dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.logs import messages
from imucalib_cli.logs.wire import Element, WireError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rosbags.typesys.store import Typestore

    from imucalib_cli.logs.reader import Channel, Labels

_TF_MESSAGE = "geometry_msgs/TransformStamped[] transforms"


def decode_one(channel: Channel, payload: bytes) -> list[Element]:
    """Decode one payload into elements of one row each.

    The definition embedded in the log is used; if it is missing or cannot be parsed, the standard
    one.

    Raises:
        WireError: The payload does not fit its definition.
    """
    full_name = channel.type.replace("/", "/msg/")
    store = _typestore(channel.encoding, full_name, channel.definition)
    read = store.deserialize_ros1 if channel.encoding == "ros1" else store.deserialize_cdr
    try:
        parts = _parts(read(payload, full_name), messages.MESSAGE_TYPES[channel.type].fields)
        return [_element(part, fields) for part, fields in parts]
    # rosbags' generated code may raise anything for damaged bytes.
    except Exception as error:
        raise WireError(str(error)) from error


@cache
def _typestore(encoding: str, full_name: str, definition: str) -> Typestore:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    ros1 = encoding == "ros1"
    if definition:
        embedded = get_typestore(Stores.EMPTY)
        # A broken definition may raise anything; the standard one remains.
        with contextlib.suppress(Exception):
            embedded.register(get_types_from_msg(definition, full_name))
            if full_name in embedded.fielddefs:
                return embedded
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    for name in ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"):
        if name not in store.fielddefs:
            store.register(get_types_from_msg(_TF_MESSAGE, name))
    return store


def _parts(
    message: Any, fields: tuple[messages.Field, ...]
) -> Iterator[tuple[Any, tuple[messages.Field, ...]]]:
    match fields:
        case (messages.Repeat(path, inner),):
            for each in _get(message, path):
                yield each, inner
        case _:
            yield message, fields


def _element(message: Any, fields: tuple[messages.Field, ...]) -> Element:
    stamp = 0
    texts: Labels = {}
    numbers = {}
    for each in fields:
        match each:
            case messages.Header():
                stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
                texts["frame_id"] = _sound(message.header.frame_id)
            case messages.Text(path, is_name):
                text = _get(message, path)
                texts[path] = _sound(text) if is_name else text
            case messages.Texts(path):
                texts[path] = tuple(map(_sound, _get(message, path)))
            case messages.Numbers(path, _, name) | messages.NumberList(path, name):
                if name:
                    values = np.array([_flatten(_get(message, path))], dtype=np.float64)
                    numbers[name] = values.reshape(1, -1)
            case messages.Repeat():
                raise WireError("a sequence beside other fields")
    return Element(np.zeros(1, dtype=np.intp), np.array([stamp], dtype=np.int64), texts, numbers)


def _sound(text: str) -> str:
    if not messages.is_sound_text(text):
        raise WireError("a text is no text")
    return text


def _get(message: Any, path: str) -> Any:
    for name in path.split("."):
        message = getattr(message, name)
    return message


def _flatten(value: Any) -> list[float]:
    if is_dataclass(value):
        names = [each.name for each in dataclass_fields(value) if not each.name.startswith("_")]
        return [x for name in names for x in _flatten(getattr(value, name))]
    if np.ndim(value):
        return [float(x) for x in value]
    return [float(value)]
