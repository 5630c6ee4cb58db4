"""Recognise a message type that is not in the table by its fields.

A message with names and as many positions has joints, whatever its type is called; one with an
angular velocity and a linear acceleration is of an IMU. :data:`_SHAPES` lists the paths that are
looked for, also in messages in JSON and protobuf.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING

from msgspec import Struct, field
from msgspec.structs import replace

from imucalib_cli.logs.messages import definitions
from imucalib_cli.logs.messages.table import (
    MESSAGE_TYPES,
    Interfaces,
    MessageType,
    Numbers,
    Repeat,
    Stamp,
    Structs,
    Text,
    Texts,
    Tick,
    motors,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from imucalib_cli.logs.messages.columns import JointColumns
    from imucalib_cli.logs.messages.table import Field, Kind

Fields = tuple["Field", ...]
BINARY = frozenset({"cdr", "ros1"})
"""Encodings whose fields have places; of the others the fields have names."""
_ENCODINGS = BINARY | {"json", "protobuf"}
"""Encodings that can be decoded, beside ``text``: the format's reader provides numbers itself."""


class _Shape(Struct, frozen=True):
    """Fields that make a message one of a kind."""

    kind: Kind
    rank: int
    takes: Mapping[str, str]
    """Path of each text and of the numbers that are read."""
    needs: tuple[str, ...] = ()
    """Further fields by which it is recognised."""
    texts: Mapping[str, str | tuple[str, ...]] = field(default_factory=dict)
    is_tf: bool = False


def _pose(parent: str, child: str, position: str, orientation: str) -> dict[str, str]:
    took = {"frame_id": parent, "child_frame_id": child}
    took |= {"position": position, "quaternion": orientation}
    return {name: path for name, path in took.items() if path}


_SHAPES = (
    *(
        _Shape("imu", 1, {"gyro": gyro, "accel": accel})
        for gyro, accel in (
            ("angular_velocity", "linear_acceleration"),
            ("imu_state.gyroscope", "imu_state.accelerometer"),
            ("gyroscope", "accelerometer"),
            ("gyro", "accel"),
        )
    ),
    *(
        _Shape("joints", rank, {"name": f"{part}{names}", "position": f"{part}{positions}"})
        for rank, part, positions in (
            (1, "", "position"),
            (1, "", "positions"),
            (1, "joint_state.", "position"),
            (1, "measured_joint_state.", "position"),
            (2, "", "feedback.positions"),
            (2, "", "actual.positions"),
        )
        for names in ("name", "names", "joint_names")
    ),
    # franka_msgs/FrankaState; robots differ in what they put before these names
    _Shape(
        "joints",
        1,
        {"position": "q"},
        needs=("q_d", "tau_J", "O_T_EE"),
        texts={"name": tuple(f"joint{number}" for number in range(1, 8))},
    ),
    # foxglove.FrameTransform and PoseInFrame
    _Shape(
        "pose",
        1,
        _pose("parent_frame_id", "child_frame_id", "translation", "rotation"),
        is_tf=True,
    ),
    _Shape("pose", 1, _pose("frame_id", "", "pose.position", "pose.orientation")),
    # the twins of geometry_msgs and nav_msgs
    *(
        _Shape("pose", 1, _pose("header.frame_id", child, position, orientation))
        for child, position, orientation in (
            ("child_frame_id", "transform.translation", "transform.rotation"),
            ("child_frame_id", "pose.pose.position", "pose.pose.orientation"),
            ("", "pose.pose.position", "pose.pose.orientation"),
            ("", "pose.position", "pose.orientation"),
        )
    ),
)
"""In the order in which they are tried; of a kind the first that fits counts."""
_STAMPS = ("header.stamp", "timestamp", "stamp", "time")
_FRAMES = ("header.frame_id", "frame_id")
_MOTORS = "motor_state"
_AXES = {"gyro": "xyz", "accel": "xyz", "position": "xyz", "quaternion": "xyzw"}


def _vector(path: str, axes: str) -> Fields:
    return tuple(Numbers(f"{path}.{axis}", 1) for axis in axes)


_FOXGLOVE_TRANSFORM: Fields = (
    Stamp("timestamp", is_stamp=False),
    Text("parent_frame_id"),
    Text("child_frame_id"),
    *_vector("translation", "xyz"),
    *_vector("rotation", "xyzw"),
)
_FOXGLOVE: dict[str, Fields] = {
    "foxglove.FrameTransform": _FOXGLOVE_TRANSFORM,
    "foxglove.FrameTransforms": (Structs("transforms", _FOXGLOVE_TRANSFORM),),
    "foxglove.PoseInFrame": (
        Stamp("timestamp", is_stamp=False),
        Text("frame_id"),
        *_vector("pose.position", "xyz"),
        *_vector("pose.orientation", "xyzw"),
    ),
}
"""Fields of types in JSON whose schema a log may lack."""


@lru_cache(maxsize=1024)
def reading_of(
    type_name: str, encoding: str, definition: str, columns: JointColumns | None = None
) -> MessageType | None:
    """How messages of a type, named without ``/msg/``, are read; None if they cannot be.

    The definition is empty if the log does not embed it. ``columns`` are the joints that the user
    names among the numbers.
    """
    known = MESSAGE_TYPES.get(type_name)
    if encoding == "text":
        return known
    if encoding not in _ENCODINGS:
        return None
    if known is None or encoding not in BINARY:
        fields = _fields(type_name, encoding, definition)
        known = _recognised(fields, is_binary=encoding in BINARY) or (
            None if encoding == "protobuf" else known
        )
    if columns is None:
        return known
    fields = _all_fields(type_name, encoding, definition)
    return _with_columns(known, fields, columns, is_binary=encoding in BINARY)


def numbers_of(type_name: str, encoding: str, definition: str) -> tuple[str, ...]:
    """Paths of all numbers in messages of a type, at most some."""
    leaves = _leaves(_all_fields(type_name, encoding, definition))
    return tuple(path for path, each in leaves if isinstance(each, Numbers))


def _all_fields(type_name: str, encoding: str, definition: str) -> Fields:
    known = MESSAGE_TYPES.get(type_name) if encoding in BINARY else None
    if known is not None:
        return known.fields
    return _fields(type_name, encoding, definition or _standard(type_name, encoding))


def _fields(type_name: str, encoding: str, definition: str) -> Fields:
    fields: Fields = ()
    if definition:
        try:
            fields = definitions.fields_of(type_name, encoding, definition)
        # descriptors of protobuf, which may be damaged or need a package, raise anything
        except Exception:  # noqa: BLE001
            return ()
    return fields or (_FOXGLOVE.get(type_name, ()) if encoding == "json" else ())


def _standard(type_name: str, encoding: str) -> str:
    """The definition of a type that comes with ROS; empty for others."""
    if encoding not in BINARY:
        return ""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
    full_name = type_name.replace("/", "/msg/")
    if full_name not in store.fielddefs:
        return ""
    return store.generate_msgdef(full_name, ros_version=1 if encoding == "ros1" else 2)[0]


class _Found(Struct):
    """The kinds of a message type, and the fields that are read."""

    kinds: dict[Kind, int]
    names: dict[str, str]
    """Names of the fields that are read, by path."""
    texts: dict[str, str | tuple[str, ...]]
    is_tf: bool = False


def _recognised(fields: Fields, *, is_binary: bool) -> MessageType | None:
    match fields:
        case (Structs(path, inner, None),):
            one = _recognised(inner, is_binary=is_binary)
            if one is None or "pose" not in one.kinds or one.texts.get("frame_id") == "":
                return None
            return MessageType(one.kinds, (Repeat(path, one.fields),), is_tf=True)
    at = {each.path: each for each in fields}
    found = _found(at)
    if "joints" not in found.kinds:
        at = _with_joints_of_structs(at, found)
    if not found.kinds:
        return None
    if found.kinds.keys() != {"joints"} and "frame_id" not in found.names.values():
        frames = (path for path in _FRAMES if isinstance(at.get(path), Text))
        frame = next(frames, "")
        found.names |= {frame: "frame_id"} if frame else {}
        found.texts |= {} if frame else {"frame_id": ""}
    taken = _taken(tuple(at.values()), at, found.names, is_binary=is_binary)
    return MessageType(found.kinds, taken, found.texts, is_tf=found.is_tf)


def _found(at: Mapping[str, Field]) -> _Found:
    """The first shape of each kind that fits."""
    found = _Found({}, {}, {})
    for shape in _SHAPES:
        names = None if shape.kind in found.kinds else _fit(shape, at)
        if names is not None:
            found.names |= names
            found.kinds[shape.kind] = shape.rank
            found.texts |= shape.texts
            found.is_tf |= shape.is_tf
    return found


def _taken(
    fields: Fields, at: Mapping[str, Field], names: Mapping[str, str], *, is_binary: bool
) -> Fields:
    """Fields with the names under which they are taken, and with a stamp, if there is one."""
    stamp = next((path for path in _STAMPS if isinstance(at.get(path), Stamp)), "")
    named = tuple(_named(each, names, stamp, "") for each in fields)
    named = named if stamp else _with_other_stamp(named)
    return named if is_binary else _in_order(named, names)


def _fit(shape: _Shape, at: Mapping[str, Field]) -> dict[str, str] | None:
    """Names of the fields that a shape takes, by path; None if it does not fit."""
    if not all(path in at for path in shape.needs):
        return None
    found: dict[str, str] = {}
    for name, path in shape.takes.items():
        taken = _places(name, path, at, vectors=shape.kind != "joints")
        if taken is None:
            return None
        found |= dict.fromkeys(taken, name)
    return found


def _places(
    name: str, path: str, at: Mapping[str, Field], *, vectors: bool
) -> Sequence[str] | None:
    """Paths of the fields that hold something; None if they are not there."""
    axes = [f"{path}.{axis}" for axis in _AXES.get(name, "")] if vectors else []
    match at.get(path):
        case None if axes and all(_is_one_number(at.get(each)) for each in axes):
            return axes
        case Text() if name in {"frame_id", "child_frame_id"}:
            return (path,)
        case Texts() if name == "name":
            return (path,)
        case Numbers(_, count) if not vectors or count == len(axes):
            return (path,)
    return None


def _is_one_number(each: Field | None) -> bool:
    return isinstance(each, Numbers) and each.count == 1


def _with_joints_of_structs(at: dict[str, Field], found: _Found) -> dict[str, Field]:
    """Find joints of control_msgs/DynamicJointState, or of motors that have numbers alone."""
    match at.get("joint_names"), at.get("interface_values"):
        case Texts(), Structs(path, (Texts(names), Numbers(values, None, _, "f8")), None):
            found.names["joint_names"] = "name"
            found.kinds["joints"] = 1
            return {**at, path: Interfaces(path, names, values)}
    match at.get(_MOTORS):
        case Structs(path, inner, int(count)) if any(
            each.path == "q" and _is_one_number(each) for each in inner
        ):
            found.names[f"{path}.q"] = "position"
            found.texts |= motors(count)
            found.kinds["joints"] = 1
    return at


def _named(each: Field, names: Mapping[str, str], stamp: str, prefix: str) -> Field:
    """A field with the name under which it is taken, if it is."""
    path = f"{prefix}{each.path}"
    match each:
        case Stamp():
            return replace(each, is_stamp=path == stamp)
        case Text() | Texts() | Numbers():
            return replace(each, name=names.get(path, ""))
        case Structs(_, inner):
            return replace(
                each, fields=tuple(_named(part, names, stamp, f"{path}.") for part in inner)
            )
    return each


def _with_other_stamp(fields: Fields) -> Fields:
    """Find a stamp in a custom struct, or a counter of ms, if there is no other stamp."""
    for number, (one, two) in enumerate(pairwise(fields)):
        match one, two:
            case Numbers(first, 1, "", "i4" | "u4"), Numbers(second, 1, "", "u4"):
                path = first.rpartition(".")[0]
                if path in _STAMPS and {first, second} == {f"{path}.sec", f"{path}.nanosec"}:
                    return (*fields[:number], Stamp(path), *fields[number + 2 :])
    return tuple(
        Tick(each.path)
        if isinstance(each, Numbers) and (each.path, each.count, each.type) == ("tick", 1, "u4")
        else each
        for each in fields
    )


def _in_order(fields: Fields, names: Mapping[str, str]) -> Fields:
    """Fields that are taken, axes in their order: a schema may have them in any other."""
    order = {path: number for number, path in enumerate(names)}
    taken = [each for each in fields if each.path in order or isinstance(each, (Stamp, Tick))]
    return tuple(sorted(taken, key=lambda each: order.get(each.path, -1)))


def _leaves(fields: Sequence[Field], prefix: str = "") -> Iterator[tuple[str, Field]]:
    for each in fields:
        path = f"{prefix}{each.path}"
        if isinstance(each, Structs):
            yield from _leaves(each.fields, f"{path}.")
        else:
            yield path, each


def _with_columns(
    known: MessageType | None, fields: Fields, columns: JointColumns, *, is_binary: bool
) -> MessageType | None:
    """Read the joints that the user names; None if the message has no such numbers.

    Of ``known``, how it is read without the user's choice, the IMU stays.
    """
    leaves = dict(_leaves(fields))
    if not isinstance(leaves.get(columns.path), Numbers):
        return None
    if known is None or "imu" not in known.kinds:
        known = MessageType({}, _taken(fields, leaves, {}, is_binary=is_binary), {})
    kept = tuple(_without_joints(each, columns.path, "") for each in known.fields)
    if not is_binary:
        kept = (*kept, Numbers(columns.path, None, "position"))
    kinds: dict[Kind, int] = {"joints": 0}
    kinds |= {"imu": known.kinds["imu"]} if "imu" in known.kinds else {}
    texts = {"frame_id": "", **known.texts, "name": columns.names}
    return MessageType(kinds, kept, texts, frames=known.frames, columns=columns)


def _without_joints(each: Field, taken: str, prefix: str) -> Field:
    """A field that is not read as joints, unless the user means it."""
    path = f"{prefix}{each.path}"
    match each:
        case Structs(_, inner):
            fields = tuple(_without_joints(part, taken, f"{path}.") for part in inner)
            return replace(each, fields=fields)
        case Numbers() if path == taken:
            return replace(each, name="position")
        case Numbers() | Texts() if each.name in {"name", "position"}:
            return replace(each, name="")
    return each
