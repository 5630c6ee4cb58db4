"""Check the elements of a URDF: names, numbers, tree; keep kinematics and centres of mass."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

from imucalib_cli.errors import InputError
from imucalib_cli.robot.urdf_xml import parse_xml
from imucalib_cli.shown import listed

if TYPE_CHECKING:
    from pathlib import Path

    from imucalib_cli.robot.urdf_xml import Element

    Elements = dict[str, Element]
    Faults = list[tuple[Element, str]]

_FARTHEST = 1e4
"""m between links: larger values are millimetres or damage, and would cost digits of the pose."""
_MOVING = ("revolute", "continuous", "prismatic")
_KINDS = ("fixed", *_MOVING, "floating", "planar")
_NUMBERS = {
    ("origin", "xyz"): 3,
    ("origin", "rpy"): 3,
    ("axis", "xyz"): 3,
    ("mimic", "multiplier"): 1,
    ("mimic", "offset"): 1,
}
"""How many numbers each attribute holds."""
_KEPT = {
    "parent": ("link",),
    "child": ("link",),
    "origin": ("xyz", "rpy"),
    "axis": ("xyz",),
    "mimic": ("joint", "multiplier", "offset"),
}
"""Elements of a joint, and their attributes."""
_SHOWN = 3
_LONGEST = 80
"""Most characters of a word that a message shows."""


def check_urdf(data: bytes, path: Path | str) -> bytes:
    """Refuse an invalid URDF; return only its links, their masses and its joints, as XML.

    Limits may be missing. Elements that kinematics do not need (visuals, inertias, transmissions,
    extensions) are not checked; a mass that is no positive number is left out.

    Raises:
        InputError: One line with the file and the first faults, each with its element.
    """
    root = parse_xml(data, path)
    faults: Faults = []
    links = _by_name(root.findall("link"), faults)
    joints = _by_name(root.findall("joint"), faults)
    for name, joint in joints.items():
        _check_joint(name, joint, faults)
    if not faults:
        _check_tree(links, joints, faults)
        _check_mimics(joints, faults)
    if faults:
        lines = [f"line {element.line}: {_in_one_line(text)}" for element, text in faults]
        shown = listed(lines, _SHOWN, more="; and {} more faults", joint="; ")
        raise InputError(f"{path}: {shown}")
    return _kinematics_only(root, links, joints)


def _in_one_line(text: str) -> str:
    """The text without line breaks (&#10; in an attribute) and without words of megabytes."""
    words = text.split()
    return " ".join(word if len(word) <= _LONGEST else word[:_LONGEST] + "…" for word in words)


def _by_name(elements: list[Element], faults: Faults) -> Elements:
    named: Elements = {}
    for element in elements:
        tag, name = element.tag, element.attributes.get("name", "")
        if not name:
            faults.append((element, f"<{tag}> has no name"))
        elif not name.isprintable():
            faults.append((element, f"the name of {tag} '{name}' has control characters"))
        elif name in named:
            first = f"first in line {named[name].line}"
            faults.append((element, f"{tag} '{name}' is there twice ({first})"))
        else:
            named[name] = element
    return named


def _check_joint(name: str, joint: Element, faults: Faults) -> None:
    kind = joint.attributes.get("type")
    if kind not in _KINDS:
        said = "no type" if kind is None else f"the unknown type '{kind}'"
        faults.append((joint, f"joint '{name}' has {said}, not one of {', '.join(_KINDS)}"))
    for tag in ("parent", "child"):
        if not joint.value(tag, "link"):
            faults.append((joint, f"joint '{name}' has no <{tag} link=...>"))
    for tag in _KEPT:
        if len(joint.findall(tag)) > 1:
            faults.append((joint, f"joint '{name}' has more than one <{tag}>"))
    _check_numbers(name, joint, faults)


def _check_numbers(name: str, joint: Element, faults: Faults) -> None:
    moves = joint.attributes.get("type") in _MOVING
    for (tag, attribute), count in _NUMBERS.items():
        element = joint.find(tag)
        if element is None or attribute not in element.attributes:
            continue
        text = element.attributes[attribute]
        numbers = _numbers(text)
        largest = max(map(abs, numbers), default=0.0)
        said, fault = f'<{tag} {attribute}="{text}"> is', ""
        if len(numbers) != count or not all(map(math.isfinite, numbers)):
            need = "three finite numbers" if count == 3 else "one finite number"
            fault = f"{said} not {need}"
        elif (tag, attribute) == ("origin", "xyz") and largest > _FARTHEST:
            fault = f"{said} beyond {_FARTHEST:g} m: write metres"
        elif tag == "mimic" and largest > _FARTHEST:
            fault = f"{said} beyond {_FARTHEST:g}: no joint follows another by that"
        elif tag == "axis" and moves and largest == 0.0:
            fault = "its <axis> is zero"
        elif tag == "axis" and moves and not 1.0 / _FARTHEST <= largest <= _FARTHEST:
            fault = f"{said} no direction: write 0 0 1"  # its square may be 0 or infinite
        if fault:
            faults.append((element, f"joint '{name}': {fault}"))


def _numbers(text: str) -> list[float]:
    try:
        return [float(word) for word in text.split()]
    except ValueError:
        return []


def _check_tree(links: Elements, joints: Elements, faults: Faults) -> None:
    above: dict[str, str] = {}
    for name, joint in joints.items():
        for tag in ("parent", "child"):
            link = joint.value(tag, "link")
            if link not in links:
                faults.append((joint, f"joint '{name}': its {tag} link '{link}' is not defined"))
        child = joint.value("child", "link")
        if child in above:
            both = f"'{above[child]}' and '{name}'"
            faults.append((joint, f"link '{child}' is the child of joints {both}"))
        above.setdefault(child, name)
    if faults:
        return
    roots = [link for link in links if link not in above]
    if len(roots) > 1:
        listed = ", ".join(roots[:4])
        text = f"{len(roots)} links have no parent ({listed}): a URDF has one root"
        faults.append((links[roots[1]], text))
    parents = {child: joints[name].value("parent", "link") for child, name in above.items()}
    for link in _on_loop(parents):
        name = above[link]
        faults.append((joints[name], f"joint '{name}' closes a loop: a URDF is a tree"))


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


def _check_mimics(joints: Elements, faults: Faults) -> None:
    followed = {
        name: target
        for name, joint in joints.items()
        if (target := joint.value("mimic", "joint")) in joints
    }
    for name, target in followed.items():
        if joints[target].attributes["type"] not in _MOVING:
            mimic = joints[name].find("mimic") or joints[name]
            faults.append((mimic, f"joint '{name}' mimics '{target}', which has no position"))
    for name in _on_loop(followed):
        faults.append((joints[name], f"joint '{name}' mimics itself in the end"))


def _add_mass(link: ET.Element, inertial: Element | None) -> None:
    """Add an <inertial> that can be believed."""
    if inertial is None:
        return
    mass, centre = inertial.value("mass", "value"), inertial.value("origin", "xyz") or "0 0 0"
    numbers = [*_numbers(mass), *_numbers(centre)]
    if len(numbers) == 4 and numbers[0] > 0.0 and all(abs(n) < _FARTHEST for n in numbers):
        kept = ET.SubElement(link, "inertial")
        ET.SubElement(kept, "mass", value=mass)
        ET.SubElement(kept, "origin", xyz=centre)


def _kinematics_only(root: Element, links: Elements, joints: Elements) -> bytes:
    robot = ET.Element("robot", name=root.attributes.get("name") or "robot")
    for name, link in links.items():
        kept = ET.SubElement(robot, "link", name=name)
        _add_mass(kept, link.find("inertial"))
    for name, joint in joints.items():
        kept = ET.SubElement(robot, "joint", name=name, type=joint.attributes["type"])
        for tag, attributes in _KEPT.items():
            element = joint.find(tag)
            # A joint that mimics a missing joint has its own position, or none.
            if element is not None and (
                tag != "mimic" or element.attributes.get("joint") in joints
            ):
                found = {a: element.attributes[a] for a in attributes if a in element.attributes}
                ET.SubElement(kept, tag, found)
    kinematics: bytes = ET.tostring(robot, encoding="utf-8")
    return kinematics
