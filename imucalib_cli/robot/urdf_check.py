"""Check a URDF's XML before any library sees it, and keep only what kinematics need."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

from imucalib_cli.errors import InputError
from imucalib_cli.robot.urdf_xml import parse_xml

if TYPE_CHECKING:
    from pathlib import Path

    from imucalib_cli.robot.urdf_xml import Element

FARTHEST = 1e4
"""m between links: larger values are millimetres or damage, and would cost digits of the pose."""
_MOVING = ("revolute", "continuous", "prismatic")
_KINDS = ("fixed", *_MOVING, "floating", "planar")
_SHOWN = 3
_LONGEST = 80
"""Most characters shown of a word in a message."""
_KEPT = {
    "parent": ("link",),
    "child": ("link",),
    "origin": ("xyz", "rpy"),
    "axis": ("xyz",),
    "mimic": ("joint", "multiplier", "offset"),
}


def check_urdf(data: bytes, path: Path | str) -> bytes:
    """Refuse an invalid URDF; return only its links and joints, as XML.

    It is lenient where the meaning is clear: limits may be missing, a missing axis is x, and other
    elements (visuals, inertias, transmissions, extensions) are ignored.

    Raises:
        InputError: One line with the file and the first faults, each with its element.
    """
    root = parse_xml(data, path)
    faults = _Faults()
    links = _by_name(root.findall("link"), faults)
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

    def add(self, element: Element | None, text: str) -> None:
        # &#10; in an attribute would break the message's line, and a word may be megabytes long
        text = " ".join(
            word if len(word) <= _LONGEST else word[:_LONGEST] + "…" for word in text.split()
        )
        self.found.append(text if element is None else f"line {element.line}: {text}")


def _by_name(elements: list[Element], faults: _Faults) -> dict[str, Element]:
    named: dict[str, Element] = {}
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


def _joints(root: Element, faults: _Faults) -> dict[str, Element]:
    joints = _by_name(root.findall("joint"), faults)
    for name, joint in joints.items():
        kind = joint.attributes.get("type")
        if kind not in _KINDS:
            said = "no type" if kind is None else f"the unknown type '{kind}'"
            faults.add(joint, f"joint '{name}' has {said}, not one of {', '.join(_KINDS)}")
        for tag in ("parent", "child"):
            end = joint.find(tag)
            if end is None or not end.attributes.get("link"):
                faults.add(joint, f"joint '{name}' has no <{tag} link=...>")
        for tag in _KEPT:
            if len(joint.findall(tag)) > 1:
                faults.add(joint, f"joint '{name}' has more than one <{tag}>")
        _check_numbers(name, joint, faults)
    return joints


def _check_numbers(name: str, joint: Element, faults: _Faults) -> None:
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


def _end(joint: Element, tag: str) -> str:
    element = joint.find(tag)
    return "" if element is None else element.attributes["link"]


def _check_tree(links: dict[str, Element], joints: dict[str, Element], faults: _Faults) -> None:
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
    """One member of each loop, where each item follows at most one; each is visited once."""
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


def _check_mimics(joints: dict[str, Element], faults: _Faults) -> None:
    followed = {}
    for name, joint in joints.items():
        mimic = joint.find("mimic")
        target = "" if mimic is None else mimic.attributes.get("joint", "")
        if mimic is None or target not in joints:
            continue
        if joints[target].attributes["type"] not in _MOVING:
            faults.add(mimic, f"joint '{name}' mimics '{target}', which has no position")
        followed[name] = target
    for name in _on_loop(followed):
        faults.add(joints[name], f"joint '{name}' mimics itself in the end")


def _kinematics_only(root: Element, links: dict[str, Element], joints: dict[str, Element]) -> bytes:
    robot = ET.Element("robot", name=root.attributes.get("name") or "robot")
    for name in links:
        ET.SubElement(robot, "link", name=name)
    for name, joint in joints.items():
        kept = ET.SubElement(robot, "joint", name=name, type=joint.attributes["type"])
        for tag, attributes in _KEPT.items():
            element = joint.find(tag)
            # who mimics a joint that is not there has its own position, or none
            if element is not None and element.attributes.get("joint", name) in joints:
                ET.SubElement(
                    kept,
                    tag,
                    {a: element.attributes[a] for a in attributes if a in element.attributes},
                )
    kinematics: bytes = ET.tostring(robot, encoding="utf-8")
    return kinematics
