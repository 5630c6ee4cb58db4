"""Check a URDF's XML before any library sees it, and keep only what kinematics need.

Expat's own events are used, so that a DOCTYPE (entity bombs, external entities) is refused at
the moment it begins, before anything in it is expanded.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET
from xml.parsers import expat

from imucalib_cli.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

SIZE_LIMIT = 16 << 20
"""Bytes; the largest published robot descriptions have a few hundred kilobytes."""
DEPTH_LIMIT = 200
ELEMENT_LIMIT = 200_000
"""Ten times a humanoid's with all its meshes; more would cost seconds and memory for nothing."""
FARTHEST = 1e4
"""m from link to link; millimetres and damage lie beyond, and digits of the pose would be lost."""
KINDS = ("fixed", "revolute", "continuous", "prismatic", "floating", "planar")
_MOVING = ("revolute", "continuous", "prismatic")
_SHOWN = 3
_LONGEST = 80
"""Letters of a word in a message."""
_KEPT = {
    "parent": ("link",),
    "child": ("link",),
    "origin": ("xyz", "rpy"),
    "axis": ("xyz",),
    "mimic": ("joint", "multiplier", "offset"),
}


@dataclass
class _Element:
    tag: str
    attributes: dict[str, str]
    line: int
    children: list[_Element] = field(default_factory=list)

    def find(self, tag: str) -> _Element | None:
        return next((child for child in self.children if child.tag == tag), None)

    def findall(self, tag: str) -> list[_Element]:
        return [child for child in self.children if child.tag == tag]


class _Refused(Exception):  # noqa: N818 - carries a fault out of an expat callback
    pass


def check_urdf(data: bytes, path: Path) -> bytes:
    """Refuse what is no sound URDF; return its links and joints as XML, without the rest.

    Lenient where the meaning is clear: limits may be missing, a missing axis is x, and what is
    not kinematics (visuals, inertias, transmissions, extensions) is not looked at.

    Raises:
        InputError: One line with the file and the first faults, each with its element.
    """
    root = _parse(data, path)
    faults = _Faults()
    links = _links(root, faults)
    joints = _joints(root, faults)
    if not faults.found:
        _check_tree(links, joints, faults)
        _check_mimics(joints, faults)
    if faults.found:
        shown = "; ".join(faults.found[:_SHOWN])
        more = len(faults.found) - _SHOWN
        raise InputError(f"{path}: {shown}" + (f"; and {more} more faults" if more > 0 else ""))
    return _kinematics_only(root, links, joints)


class _Faults:
    def __init__(self) -> None:
        self.found: list[str] = []

    def add(self, element: _Element | None, text: str) -> None:
        # &#10; in an attribute would break the line, and a word may be megabytes long
        text = " ".join(
            word if len(word) <= _LONGEST else word[:_LONGEST] + "…" for word in text.split()
        )
        self.found.append(text if element is None else f"line {element.line}: {text}")


def _parse(data: bytes, path: Path) -> _Element:
    if len(data) > SIZE_LIMIT:
        raise InputError(f"{path}: more than {SIZE_LIMIT >> 20} MB are no URDF: check --urdf")
    if not data.strip():
        raise InputError(f"{path}: the file is empty: check --urdf")
    reader = _Reader(path)
    try:
        root = reader.read(data)
    except _Refused as refused:
        raise InputError(f"{path}: {refused}") from None
    except expat.ExpatError as error:
        raise InputError(
            f"{path}: not well-formed XML ({expat.ErrorString(error.code)}, line {error.lineno}, "
            f"column {error.offset + 1}): give a URDF"
        ) from None
    except (ValueError, LookupError) as error:
        raise InputError(
            f"{path}: its encoding cannot be read ({error}): save it as UTF-8"
        ) from None
    if root.tag != "robot":
        raise InputError(f"{path}: the root element is <{root.tag}>, not <robot>: give a URDF")
    if root.find("link") is None:
        raise InputError(f"{path}: <robot> has no <link>: give a complete URDF")
    return root


class _Reader:
    """Elements down to those inside a <joint>; below, nothing is kinematics."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._stack: list[_Element] = []
        self._root: _Element | None = None
        self._count = 0
        self._parser = expat.ParserCreate()
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.StartDoctypeDeclHandler = self._doctype

    def read(self, data: bytes) -> _Element:
        self._parser.Parse(data, True)
        if self._root is None:
            raise _Refused("has no element: give a URDF")
        return self._root

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        element = _Element(tag, attributes, self._parser.CurrentLineNumber)
        xacro = f"<{tag}>" if tag.startswith("xacro:") else _xacro_in(element)
        if xacro:
            raise _Refused(
                f"line {element.line}: {xacro} is xacro, not URDF: expand it first with "
                f"`xacro {self._path} > robot.urdf` and give robot.urdf"
            )
        self._count += 1
        if self._count > ELEMENT_LIMIT:
            raise _Refused(f"has more than {ELEMENT_LIMIT} elements: give a URDF")
        depth = len(self._stack)
        if depth >= DEPTH_LIMIT:
            raise _Refused(f"elements are nested more than {DEPTH_LIMIT} deep: give a URDF")
        if depth == 0:
            self._root = element
        elif depth < 3:
            self._stack[-1].children.append(element)
        self._stack.append(element)

    def _end(self, _tag: str) -> None:
        self._stack.pop()

    def _doctype(self, *_args: object) -> None:
        raise _Refused(
            "has a DOCTYPE, which a URDF does not need and which may hide entities: remove it"
        )


def _xacro_in(element: _Element) -> str:
    """The attribute that is still to be expanded, in its element; empty if there is none."""
    for name, value in element.attributes.items():
        counts = element.tag in ("robot", "link", "joint") or name in ("xyz", "rpy", "link")
        if counts and ("${" in value or "$(" in value):
            return " ".join(f'<{element.tag} {name}="{value}">'.split())
    return ""


def _links(root: _Element, faults: _Faults) -> dict[str, _Element]:
    return _by_name(root.findall("link"), faults)


def _by_name(elements: list[_Element], faults: _Faults) -> dict[str, _Element]:
    named: dict[str, _Element] = {}
    for element in elements:
        name = element.attributes.get("name", "")
        if not name:
            faults.add(element, f"<{element.tag}> has no name")
        elif not name.isprintable():
            faults.add(element, f"the name of {element.tag} '{name}' has control characters")
        elif name in named:
            faults.add(
                element,
                f"{element.tag} '{name}' is there twice (first in line {named[name].line})",
            )
        else:
            named[name] = element
    return named


def _joints(root: _Element, faults: _Faults) -> dict[str, _Element]:
    joints = _by_name(root.findall("joint"), faults)
    for name, joint in joints.items():
        kind = joint.attributes.get("type")
        if kind not in KINDS:
            said = "no type" if kind is None else f"the unknown type '{kind}'"
            faults.add(joint, f"joint '{name}' has {said}, not one of {', '.join(KINDS)}")
        for tag in ("parent", "child"):
            end = joint.find(tag)
            if end is None or not end.attributes.get("link"):
                faults.add(joint, f"joint '{name}' has no <{tag} link=...>")
        for tag in _KEPT:
            if len(joint.findall(tag)) > 1:
                faults.add(joint, f"joint '{name}' has more than one <{tag}>")
        _check_numbers(name, joint, faults)
    return joints


def _check_numbers(name: str, joint: _Element, faults: _Faults) -> None:
    for tag, attribute, count in (
        ("origin", "xyz", 3),
        ("origin", "rpy", 3),
        ("axis", "xyz", 3),
        ("mimic", "multiplier", 1),
        ("mimic", "offset", 1),
    ):
        element = joint.find(tag)
        text = None if element is None else element.attributes.get(attribute)
        if text is None:
            continue
        numbers = _numbers(text)
        if len(numbers) != count or not all(map(math.isfinite, numbers)):
            need = "three finite numbers" if count == 3 else "one finite number"
            faults.add(element, f"joint '{name}': <{tag} {attribute}=\"{text}\"> is not {need}")
        elif attribute == "xyz" and tag == "origin" and max(map(abs, numbers)) > FARTHEST:
            faults.add(
                element,
                f"joint '{name}': <origin xyz=\"{text}\"> is beyond {FARTHEST:g} m: write metres",
            )
        elif tag == "mimic" and abs(numbers[0]) > FARTHEST:
            faults.add(
                element,
                f"joint '{name}': <mimic {attribute}=\"{text}\"> is beyond {FARTHEST:g}: no joint "
                "follows another by that",
            )
        elif tag == "axis" and joint.attributes.get("type") in _MOVING:
            largest = max(map(abs, numbers))
            if largest == 0.0:
                faults.add(element, f"joint '{name}': its <axis> is zero")
            elif not 1.0 / FARTHEST <= largest <= FARTHEST:  # its square may be 0 or infinite
                faults.add(
                    element, f"joint '{name}': <axis xyz=\"{text}\"> is no direction: write 0 0 1"
                )


def _numbers(text: str) -> list[float]:
    try:
        return [float(word) for word in text.split()]
    except ValueError:
        return []


def _end(joint: _Element, tag: str) -> str:
    element = joint.find(tag)
    return "" if element is None else element.attributes["link"]


def _check_tree(links: dict[str, _Element], joints: dict[str, _Element], faults: _Faults) -> None:
    above: dict[str, str] = {}
    for name, joint in joints.items():
        for tag in ("parent", "child"):
            if _end(joint, tag) not in links:
                faults.add(
                    joint, f"joint '{name}': its {tag} link '{_end(joint, tag)}' is not defined"
                )
        child = _end(joint, "child")
        if child in above:
            faults.add(
                joint, f"link '{child}' is the child of joints '{above[child]}' and '{name}'"
            )
        above.setdefault(child, name)
    if faults.found:
        return
    roots = [link for link in links if link not in above]
    if len(roots) > 1:
        faults.add(
            links[roots[1]],
            f"{len(roots)} links have no parent ({', '.join(roots[:4])}): a URDF has one root",
        )
    parents = {child: _end(joints[name], "parent") for child, name in above.items()}
    for link in _on_loop(parents):
        name = above[link]
        faults.add(joints[name], f"joint '{name}' closes a loop: a URDF is a tree")


def _on_loop(following: dict[str, str]) -> list[str]:
    """The first found of each loop, where each follows at most one; each is visited once."""
    state: Counter[str] = Counter()
    loops = []
    for visit, start in enumerate(following, start=1):
        here = start
        while here in following and not state[here]:
            state[here] = visit
            here = following[here]
        if here in following and state[here] == visit:
            loops.append(here)
    return loops


def _check_mimics(joints: dict[str, _Element], faults: _Faults) -> None:
    followed = {}
    for name, joint in joints.items():
        mimic = joint.find("mimic")
        if mimic is None:
            continue
        target = mimic.attributes.get("joint", "")
        if target not in joints:
            faults.add(mimic, f"joint '{name}' mimics '{target}', which is not there")
        elif joints[target].attributes["type"] not in _MOVING:
            faults.add(mimic, f"joint '{name}' mimics '{target}', which has no position")
        followed[name] = target
    for name in _on_loop(followed):
        faults.add(joints[name], f"joint '{name}' mimics itself in the end")


def _kinematics_only(
    root: _Element, links: dict[str, _Element], joints: dict[str, _Element]
) -> bytes:
    robot = ET.Element("robot", name=root.attributes.get("name") or "robot")
    for name in links:
        ET.SubElement(robot, "link", name=name)
    for name, joint in joints.items():
        kept = ET.SubElement(robot, "joint", name=name, type=joint.attributes["type"])
        for tag, attributes in _KEPT.items():
            element = joint.find(tag)
            if element is not None:
                ET.SubElement(
                    kept,
                    tag,
                    {a: element.attributes[a] for a in attributes if a in element.attributes},
                )
    kinematics: bytes = ET.tostring(robot, encoding="utf-8")
    return kinematics
