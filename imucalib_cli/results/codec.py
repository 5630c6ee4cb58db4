"""Trees as YAML and JSON, their schemas, and reading with errors that name file and key."""

from __future__ import annotations

import ast
import inspect
import math
import re
import reprlib
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import msgspec
import numpy as np
import yaml
from msgspec import UNSET

from imucalib_cli.errors import InputError
from imucalib_cli.findings import TEXT
from imucalib_cli.guarded_yaml import NUMBERS, YamlError, load_yaml
from imucalib_cli.results.from_estimate import known_directions, tangent
from imucalib_cli.results.pose import is_covariance
from imucalib_cli.results.result import SCHEMA, FindingEntry, Pose, Result, Std
from imucalib_cli.robot.rotations import matrix_from_quaternion, matrix_from_rpy, rotvec_from_matrix
from imucalib_cli.tree import Tree

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from imucalib_cli.results.result import NominalEntry

Document = dict[str, Any]
T = TypeVar("T")

FARTHEST = 100.0
"""m; no IMU is farther from its parent frame."""
ROTATIONS_AGREE = 1e-6
"""Largest angle, rad, between quaternion and rpy of one rotation, and largest error of its norm."""
_SAME_STD = 1e-6
"""Largest relative difference between a standard deviation and the root of its variance."""
RESULT = "a result of `imucalib run`"
_OLD_REQUIREMENT = "--require asks for "
"""Beginning of the reasons of --require in results that were written without codes."""
_LONGEST = 300
"""Characters of an error: it may quote a value of any length."""
_SURROGATE = re.compile("[\ud800-\udfff]")
_SHOWN = reprlib.Repr()
"""Shortens long values of a file."""
_SHOWN.maxstring = _SHOWN.maxother = 100
_WORDS = {
    "bool | int | float | str": "a number or a text",
    "object": "a mapping",
    "array": "a list",
    "float": "a number",
    "int": "an integer",
    "str": "a text",
    "bool": "true or false",
}
"""Names of types in msgspec and for users."""
_SAID_BY_MSGSPEC = ("Expected ", "Invalid ", "Number out of range")


_SafeDumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
"""By libyaml where PyYAML has it: several times faster."""


class PlainDumper(_SafeDumper):  # type: ignore[misc]
    """Writes no aliases, and quotes every text that a reader could take for a number."""

    def ignore_aliases(self, data: Any) -> bool:
        """Write an object that occurs twice twice."""
        del data
        return True


for _number in NUMBERS:
    PlainDumper.add_implicit_resolver(*_number)


class _Dumper(PlainDumper):
    """Writes vectors on one line, and other lists one item a line."""


def _represent_list(dumper: yaml.SafeDumper, values: list[Any]) -> yaml.Node:
    vector = all(value is None or isinstance(value, (int, float)) for value in values)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=vector)


_Dumper.add_representer(list, _represent_list)


def to_yaml(documents: Sequence[Tree | Document]) -> str:
    """One document, or several separated by ``---``."""
    parts = (
        yaml.dump(
            document,
            Dumper=_Dumper,
            sort_keys=False,
            default_flow_style=False,
            allow_unicode=True,
            width=10_000,  # keeps a vector on one line
        )
        for document in map(msgspec.to_builtins, documents)
    )
    return "---\n".join(parts)


def to_json(documents: Sequence[Tree | Document]) -> str:
    """One object, or an array of several."""
    content = msgspec.to_builtins(documents[0] if len(documents) == 1 else documents)
    return _json_of(content, indent=2) + "\n"


def _json_of(content: Any, indent: int | None = None) -> str:
    import json  # YAML, the default, does without

    return json.dumps(content, indent=indent, ensure_ascii=False, allow_nan=False)


def to_jsonl(documents: Sequence[Tree | Document]) -> str:
    """One object a line."""
    lines = (_json_of(document) for document in map(msgspec.to_builtins, documents))
    return "".join(f"{line}\n" for line in lines)


def read_results(text: str, name: str) -> list[Result]:
    """Results from the text of the file ``name``: a YAML stream, a JSON object or a JSON array.

    Raises InputError where it is no result of this tool, is damaged, or has a newer schema.
    """
    try:
        # JSON is YAML 1.2, so one parser reads both
        loaded = [part for part in load_yaml(text) if part is not None]
    except YamlError as error:
        raise InputError(f"{name}: neither YAML nor JSON: {error}") from error
    if len(loaded) == 1 and isinstance(loaded[0], list):
        loaded = loaded[0]
    if not loaded:
        raise InputError(f"{name}: is empty; write a result with `imucalib run`")
    return [result_from(part, name) for part in loaded]


def result_from(document: object, name: str) -> Result:
    """One result from its parsed document, checked; InputError names the wrong key."""
    if not isinstance(document, dict):
        _fail(name, "", f"should be a mapping; is this {RESULT}?")
    if "schema" not in document:  # checked first, because the rest depends on it
        _fail(name, "schema", f"is missing; is this {RESULT}?")
    schema = document["schema"]
    if isinstance(schema, int) and not isinstance(schema, bool) and schema != SCHEMA:
        said = f"is {schema}, this version reads {SCHEMA}: use the imucalib it came from"
        _fail(name, "schema", said)
    result = convert(document, Result, name, RESULT)
    written = document["diagnostics"]
    if "findings" not in written:
        result = _with(result, findings=_uncoded(result))
    for place, complaint in _contradictions(result):
        _fail(name, place, complaint)
    if "observable" in written or result.diagnostics.distrust:
        return result
    pose = result.uncertain_pose
    known = known_directions(pose.t, pose.covariance, result.diagnostics.unobservable)
    return _with(result, observable=known)


def convert(document: object, kind: type[T], name: str, what: str, where: str = "") -> T:
    """A tree from a parsed document, checked so that it can be written again.

    Messages have the name of the file, ``what`` it should be, and ``where`` in it the document is.
    Raises InputError, which names the key, where one is missing or has an impossible value.
    """
    try:
        tree = msgspec.convert(document, kind)
    except msgspec.ValidationError as error:
        place, complaint = _complaint(str(error), document, kind, what)
        _fail(name, f"{where}.{place}".strip("."), complaint)
    for place, complaint in _unwritable(msgspec.to_builtins(tree), where):
        _fail(name, place, complaint)
    return tree


def _fail(name: str, place: str, complaint: str) -> NoReturn:
    if len(complaint) > _LONGEST:
        complaint = complaint[:_LONGEST] + "…"
    raise InputError(f"{name}: {place or 'document'} {complaint}")


def _complaint(error: str, document: object, kind: Any, what: str) -> tuple[str, str]:
    """Place and error from msgspec's message, such as "Expected `int`, got `str` - at `$.a`"."""
    said, _, path = error.partition(" - at ")
    place = path.removeprefix("`key` in ").strip("`").removeprefix("$").removeprefix(".")
    if missing := re.match(r"Object missing required field `(.*)`", said):
        return ".".join(filter(None, (place, missing[1]))), f"is missing; is this {what}?"
    if path.startswith("`key` in "):
        odd = "this version does not know" if said.startswith("Invalid") else "is no text"
        return place, f"has a key that {odd}: leave it out"
    if not said.startswith(_SAID_BY_MSGSPEC):  # a rule of the tree itself, which names the field
        field, _, complaint = said.partition(" ")
        return f"{place}.{field}".removeprefix("."), complaint
    wanted = said.removeprefix("Expected ").partition(", got ")[0]
    if wanted == "`object`":
        return place, f"should be a mapping; is this {what}?"
    keys = re.findall(r"[^.\[\]]+|(?<=\[)\.\.\.", place)
    declared = _declared(kind, keys)
    if "enum" in declared:
        wanted = " or ".join(map(str, declared["enum"]))
    elif "of length" in wanted and declared.get("minItems") == declared.get("maxItems"):
        wanted = f"a list of {declared['minItems']}"
    elif wanted == "Number out of range":
        wanted = "a finite number"
    else:
        for word, plain in _WORDS.items():
            wanted = re.sub(rf"\b{re.escape(word)}\b", plain, wanted)
        wanted = wanted.replace(" | ", " or ").replace("`", "")
    value = _value_at(document, keys)
    shown = "" if value is UNSET else f", not {_SHOWN.repr(value)}"
    return place, f"should be {wanted}{shown}"


def _declared(kind: Any, keys: list[str]) -> Document:
    """JSON Schema at a place of a tree; empty where the place is not exact."""
    (schema,), parts = msgspec.json.schema_components([kind])
    for key in [*keys, ""]:
        for _ in range(2):  # null or a tree, and the tree
            schema = next(
                (each for each in schema.get("anyOf", []) if len(each) > 1 or "$ref" in each),
                schema,
            )
            schema = parts.get(schema.get("$ref", "").rpartition("/")[2], schema)
        if key:
            inside = schema.get("properties", {}).get(key) or schema.get("additionalProperties")
            schema = schema.get("items") or inside or {}
    return dict(schema)


def _value_at(document: Any, keys: list[str]) -> Any:
    """The value at a place; UNSET where the place is not exact."""
    try:
        for key in keys:
            document = document[int(key) if isinstance(document, list) else key]
    except (KeyError, ValueError, TypeError, IndexError):
        return UNSET
    return document


def _unwritable(value: Any, place: str) -> Iterator[tuple[str, str]]:
    """Places of values that JSON or UTF-8 cannot express, with the error."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _unwritable(key, place)
            yield from _unwritable(inner, f"{place}.{key}".removeprefix("."))
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _unwritable(inner, f"{place}[{index}]")
    elif isinstance(value, float) and not math.isfinite(value):
        yield place, f"should be a finite number, not {value!r}"
    elif isinstance(value, str) and _SURROGATE.search(value):
        yield place, "has half of a character, which no file can hold: take it out"


def _contradictions(result: Result) -> Iterator[tuple[str, str]]:
    """Places of a result that contradict each other, as after edits by hand, with the error."""
    yield from _pose_contradictions(result)
    covariance = result.uncertain_pose.covariance
    if covariance is not None and not is_covariance(covariance):
        pose = f"{result.transform.child} in {result.transform.parent}"
        yield "covariance", f"of {pose} is not symmetric, or gives a variance below zero"
    yield from _std_contradictions(result)
    diagnostics = result.diagnostics
    status = "untrusted" if diagnostics.unobservable or diagnostics.distrust else "ok"
    if result.status != status:
        yield "status", f"is {result.status}, but the diagnostics say {status}"
    grave = sum(each.severity == "untrusted" for each in diagnostics.findings)
    counts = grave, len(diagnostics.findings) - grave
    if counts != (len(diagnostics.distrust), len(diagnostics.warnings)):
        said = "are not those of distrust and warnings: edit both or neither"
        yield "diagnostics.findings", said


def _pose_contradictions(result: Result) -> Iterator[tuple[str, str]]:
    transform, nominal = result.transform, result.diagnostics.nominal
    for key in ("translation", "rotation_xyzw", "rotation_rpy"):
        shown = getattr(transform, key) or [None]
        if result.partial is UNSET:
            if None in shown:
                yield f"transform.{key}", "should have no null"
        elif any(
            x not in {None, y} for x, y in zip(shown, getattr(result.partial, key), strict=False)
        ):
            yield f"transform.{key}", "is not that of partial: edit both or neither"
    place = "transform" if result.partial is UNSET else "partial"
    yield from _rotation_contradictions(result.pose, place)
    if math.hypot(*result.pose.translation) > FARTHEST:
        yield f"{place}.translation", f"should be within {FARTHEST:g} m of the parent frame"
    if nominal is not None:
        yield from _rotation_contradictions(nominal, "diagnostics.nominal")


def _std_contradictions(result: Result) -> Iterator[tuple[str, str]]:
    if result.covariance is not None and result.std is not None:
        variances = np.diag(np.array(result.covariance, dtype=np.float64))
        roots = Std(*tangent(np.sqrt(np.maximum(variances, 0.0))))
        for key in Std.__struct_fields__:
            pairs = zip(getattr(result.std, key), getattr(roots, key), strict=True)
            for place, (std, root) in enumerate(pairs):
                if None in {std, root} or math.isclose(std, root, rel_tol=_SAME_STD):
                    continue
                said = "is not the root of the covariance's diagonal: edit both or neither"
                yield f"std.{key}[{place}]", said
    for key in ("time_offset", "accel_bias", "gyro_bias"):
        stds = getattr(result, key).std
        if any(std is not None and std < 0.0 for std in np.ravel(stds)):
            yield f"{key}.std", "should not be negative"


def _rotation_contradictions(pose: Pose | NominalEntry, place: str) -> Iterator[tuple[str, str]]:
    norm = math.hypot(*pose.rotation_xyzw)
    if abs(norm - 1.0) > ROTATIONS_AGREE:
        yield f"{place}.rotation_xyzw", f"should have norm 1, not {norm:.6g}"
        return
    # the angles are only for readers: an edit of them alone would have no effect
    turn = rotvec_from_matrix(
        matrix_from_rpy(pose.rotation_rpy).T @ matrix_from_quaternion(pose.rotation_xyzw)
    )
    if float(np.linalg.norm(turn)) > ROTATIONS_AGREE:
        said = "is not the rotation of rotation_xyzw, which is the one that is used: edit both or "
        yield f"{place}.rotation_rpy", f"{said}neither"


def _with(result: Result, **diagnostics: Any) -> Result:
    changed = msgspec.structs.replace(result.diagnostics, **diagnostics)
    return msgspec.structs.replace(result, diagnostics=changed)


def _uncoded(result: Result) -> list[FindingEntry]:
    """Findings of a result that was written without codes; only here sentences decide.

    A result that misses --require is not wrong, and must still answer `verify` and `diff`.
    """
    found = [
        FindingEntry(
            "require.text" if reason.startswith(_OLD_REQUIREMENT) else TEXT,
            "untrusted",
            {"text": reason},
            reason,
        )
        for reason in result.diagnostics.distrust
    ]
    warnings = result.diagnostics.warnings
    return found + [FindingEntry(TEXT, "warning", {"text": each}, each) for each in warnings]


def json_schema(title: str, description: str, *kinds: type[Tree]) -> str:
    """JSON Schema (2020-12) of a document of one of these kinds, or of an array of them."""
    places, parts = msgspec.json.schema_components(kinds, ref_template="#/$defs/{name}")
    for kind in Tree.__subclasses__():
        if kind.__name__ in parts:
            _describe(parts[kind.__name__], kind)
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": title,
        "description": description,
        "oneOf": [
            {"$ref": "#/$defs/document"},
            {"type": "array", "minItems": 1, "items": {"$ref": "#/$defs/document"}},
        ],
        "$defs": {"document": {"oneOf": list(places)}, **parts},
    }
    return _json_of(schema, indent=2) + "\n"


def _describe(part: Document, kind: type[Tree]) -> None:
    """Add the docstrings of a class and of its fields to its schema."""
    (declared,) = ast.parse(inspect.getsource(kind)).body
    assert isinstance(declared, ast.ClassDef)  # noqa: S101 - a tree is a class
    part["description"] = " ".join((ast.get_docstring(declared) or "").split())
    for entry in part["properties"].values():
        # msgspec 0.23 adds the names that a map knows, but a later version of ours may know more
        entry.pop("propertyNames", None)
    keys = dict(zip(kind.__struct_fields__, kind.__struct_encode_fields__, strict=True))
    for field, text in pairwise(declared.body):
        match field, text:
            case (
                ast.AnnAssign(target=ast.Name(id=name)),
                ast.Expr(value=ast.Constant(value=str(said))),
            ):
                part["properties"][keys[name]]["description"] = " ".join(said.split())
