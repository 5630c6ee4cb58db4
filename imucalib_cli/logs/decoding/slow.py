"""Decode messages one by one through rosbags: those the bulk decoder cannot read, and in tests."""

from __future__ import annotations

import contextlib
from dataclasses import fields as dataclass_fields
from dataclasses import is_dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from imucalib_cli.logs.decoding.wire import Element, WireError, sound
from imucalib_cli.logs.messages import table as messages
from imucalib_cli.logs.messages.definitions import TIME_PARTS
from imucalib_cli.logs.messages.protobuf import message_class
from imucalib_cli.logs.streams import NS_PER_SECOND

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rosbags.typesys.store import Typestore

    from imucalib_cli.logs.messages.table import Labels
    from imucalib_cli.logs.reader import Channel

_TF_MESSAGE = "geometry_msgs/TransformStamped[] transforms"


def decode_one(channel: Channel, payload: bytes) -> list[Element]:
    """Decode one payload into elements of one row each.

    The definition embedded in the log is used; if it is missing or cannot be parsed, the standard
    one.

    Raises:
        WireError: The payload does not fit its definition.
    """
    if channel.reading is None:
        raise WireError("a type that is not known")
    try:
        message, fields = _message(channel, payload), channel.reading.fields
        parts = [message]
        match fields:
            case (messages.Repeat(path, inner),):
                parts, fields = _get(message, path), inner
        return [_element(part, fields, channel.reading.texts) for part in parts]
    # rosbags' generated code, and damaged JSON and protobuf, may raise anything.
    except Exception as error:
        raise WireError(str(error)) from error


def _message(channel: Channel, payload: bytes) -> Any:
    match channel.encoding:
        case "json":
            return msgspec.json.decode(payload)
        case "protobuf":
            return message_class(channel.type, channel.definition).FromString(payload)
    full_name = channel.type.replace("/", "/msg/")
    store = _typestore(channel.encoding, full_name, channel.definition)
    read = store.deserialize_ros1 if channel.encoding == "ros1" else store.deserialize_cdr
    return read(payload, full_name)


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


def _element(
    message: Any, fields: tuple[messages.Field, ...], constant: Mapping[str, str | tuple[str, ...]]
) -> Element:
    stamp = 0
    texts: Labels = {**constant}
    numbers: dict[str, list[float]] = {}
    for each in fields:
        match each:
            case messages.Stamp(path, True):
                stamp = _stamp(_get(message, path))
            case messages.Tick(path):
                stamp = int(_get(message, path)) * 1_000_000
            case messages.Text(path, name, is_name) if name:
                text = _get(message, path)
                texts[name] = sound(text) if is_name else text
            case messages.Texts(path, name) if name:
                texts[name] = tuple(map(sound, _get(message, path)))
            case messages.Numbers(path, count, name) if name:
                values = _flatten(_get(message, path))
                if count not in {None, len(values)}:
                    raise WireError(f"{path} has {len(values)} numbers")
                numbers.setdefault(name, []).extend(values)
            case _:
                _add_structs(each, message, texts, numbers)
    return Element(
        np.zeros(1, dtype=np.intp),
        np.array([stamp], dtype=np.int64),
        texts,
        {name: np.array([values], dtype=np.float64) for name, values in numbers.items()},
    )


def _add_structs(
    each: messages.Field, message: Any, texts: Labels, numbers: dict[str, list[float]]
) -> None:
    """Add the values of a sequence of structs."""
    match each:
        case messages.Structs(path, inner):
            for part in _get(message, path):
                for name, values in _element(part, inner, {}).numbers.items():
                    numbers.setdefault(name, []).extend(values[0])
        case messages.Interfaces(path, names, values):
            positions = [
                dict(zip(_get(one, names), _get(one, values), strict=True)).get("position")
                for one in _get(message, path)
            ]
            named = zip(texts["name"], positions, strict=True)
            texts["name"] = tuple(name for name, value in named if value is not None)
            numbers["position"] = [float(value) for value in positions if value is not None]
        case messages.Repeat():
            raise WireError("a sequence next to other fields")


def _stamp(value: Any) -> int:
    """Nanoseconds of a time: of ROS, of JSON, of protobuf."""
    if isinstance(value, (int, float)):
        return round(value * NS_PER_SECOND)
    return sum(
        next((int(_get(value, name)) * unit for name in names if _has(value, name)), 0)
        for unit, names in TIME_PARTS.items()
    )


def _has(message: Any, name: str) -> bool:
    return name in message if isinstance(message, dict) else hasattr(message, name)


def _get(message: Any, path: str) -> Any:
    """A field by its path; of a sequence of structs a list."""
    for number, name in enumerate(parts := path.split(".")):
        if isinstance(message, dict):
            message = message[name]
        elif hasattr(message, name):
            message = getattr(message, name)
        else:
            rest = ".".join(parts[number:])
            return [_get(each, rest) for each in message]
    return message


def _flatten(value: Any) -> list[float]:
    if isinstance(value, (float, int)):
        return [float(value)]
    if is_dataclass(value):
        names = [each.name for each in dataclass_fields(value) if not each.name.startswith("_")]
        return [x for name in names for x in _flatten(getattr(value, name))]
    if isinstance(value, dict):
        axes = [name for name in "xyzw" if name in value] or list(value)
        return [x for name in axes for x in _flatten(value[name])]
    if np.ndim(value):
        return [x for each in value for x in _flatten(each)]
    return [float(value)]
