"""Damage to URDFs, results and metadata: as text, as numbers, as structure."""

from __future__ import annotations

import copy
import re
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

from tools.fuzz.mutate_bytes import damage

if TYPE_CHECKING:
    from random import Random

_WORDS = (
    "", "nan", "inf", "-inf", "1e308", "-1e308", "1e400", "1e-320", "0", "-0.0", "1_000", "0x10",
    "1,5", "١٢", "9" * 400, "1 2", "1 2 3 4", "true", "null", "~", "[]", "{}", "*a", "&a", "!!x",
    "${x}", "$(find y)", "\u202e", "é", "a" * 5000, "imu_joint", "base_link", "wrist_3_link",
    "\\x00", "&#0;", "&#10;", "&amp;", "&lol;", "<", "]]>", "%", "\t", "\r\n", "\x1b[2J", "\x00",
)  # fmt: skip
_NUMBER = re.compile(r"-?\d+\.?\d*(?:e[-+]?\d+)?")


def damage_text(content: bytes, rng: Random) -> tuple[bytes, str]:
    """A word, a line or some bytes changed."""
    text = content.decode("utf-8", "replace")
    done = []
    for _ in range(rng.choice((1, 1, 2, 4))):
        match rng.randrange(5):
            case 0:
                changed, told = damage(text.encode("utf-8", "replace"), rng)
                text = changed.decode("utf-8", "replace")
            case 1:
                text, told = _replaced(text, re.compile(r'"[^"]*"'), rng, '"{}"')
            case 2:
                text, told = _replaced(text, re.compile(r"[\w./-]+"), rng, "{}")
            case 3:
                text, told = _replaced(text, _NUMBER, rng, "{}")
            case _:
                text, told = _lines(text, rng)
        done.append(told)
    data = text.encode("utf-8", "replace")
    if rng.random() < 0.05:
        encoding = rng.choice(("utf-16", "utf-32", "latin-1", "cp500", "utf-7"))
        data = text.encode(encoding, "replace")
        done.append(f"as {encoding}")
    return data, ", ".join(done)


def _replaced(text: str, what: re.Pattern[str], rng: Random, form: str) -> tuple[str, str]:
    found = list(what.finditer(text))
    if not found:
        return text, "nothing"
    match, word = rng.choice(found), rng.choice(_WORDS)
    told = f"{match.group()[:40]!r} at {match.start()} to {word[:40]!r}"
    return text[: match.start()] + form.format(word) + text[match.end() :], told


def _lines(text: str, rng: Random) -> tuple[str, str]:
    lines = text.split("\n")
    at, count = rng.randrange(len(lines)), rng.choice((1, 1, 5))
    match rng.randrange(4):
        case 0:
            del lines[at : at + count]
            told = f"{count} lines at {at} removed"
        case 1:
            lines[at:at] = lines[at : at + count]
            told = f"{count} lines at {at} repeated"
        case 2:
            lines.insert(rng.randrange(len(lines)), lines.pop(at))
            told = f"line {at} moved"
        case _:
            lines[at] = " " * rng.choice((1, 2, 9)) + lines[at]
            told = f"line {at} indented"
    return "\n".join(lines), told


def damage_urdf(content: bytes, rng: Random) -> tuple[bytes, str]:
    """One to three faults in elements, or in the text."""
    if rng.random() < 0.35:
        return damage_text(content, rng)
    if rng.random() < 0.1:
        name = rng.choice(tuple(_BOMBS))
        return _BOMBS[name](content), name
    root = ET.fromstring(content)  # noqa: S314 - our own
    done = []
    for _ in range(rng.choice((1, 1, 2, 3))):
        parents = [each for each in root.iter() if len(each)]
        parent = rng.choice([root, rng.choice(parents)])
        at = rng.randrange(len(parent) or 1)
        child = parent[at] if len(parent) else parent
        match rng.randrange(8):
            case 0:
                if len(parent):
                    parent.remove(child)
                done.append(f"<{child.tag}> removed")
            case 1:
                parent.append(copy.deepcopy(child))
                done.append(f"<{child.tag}> repeated")
            case 2:
                if len(parent):
                    parent.remove(child)
                rng.choice(list(root.iter())).append(copy.deepcopy(child))
                done.append(f"<{child.tag}> moved")
            case 3:
                ET.SubElement(
                    rng.choice(root.findall("joint") or [root]),
                    "mimic",
                    joint=rng.choice(["wrist_3_joint", "imu_joint", "elbow_joint", "x"]),
                    multiplier=rng.choice(["1", "1e308", "nan", "0"]),
                )
                done.append("a mimic")
            case _:
                element = rng.choice(list(root.iter()))
                name = rng.choice([*element.attrib, "name", "type", "link", "xyz"])
                word = rng.choice((*_WORDS, "revolute", "fixed", "floating", "1e308 0 0", "0 0 0"))
                word = re.sub(r"[\x00-\x1f]", "", word)
                element.set(name, word)
                done.append(f"<{element.tag}> {name} to {word[:40]!r}")
    return ET.tostring(root), ", ".join(done)


def _with_doctype(content: bytes, doctype: str, inside: str) -> bytes:
    at = content.index(b"<robot")
    end = content.index(b">", at) + 1
    head = f"<!DOCTYPE robot [{doctype}]>".encode()
    return head + content[at:end] + inside.encode() + content[end:]


def _entities(content: bytes) -> bytes:
    lines = [f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 10)]
    return _with_doctype(content, "".join(['<!ENTITY l0 "lol">', *lines]), "&l9;")


def _external(content: bytes) -> bytes:
    return _with_doctype(content, '<!ENTITY x SYSTEM "file:///etc/passwd">', "&x;")


def _parameter(content: bytes) -> bytes:
    return _with_doctype(content, '<!ENTITY % x SYSTEM "file:///dev/zero"> %x;', "")


def _nested(content: bytes) -> bytes:
    deep = b"<a>" * 200_000 + b"</a>" * 200_000
    return content.replace(b"</robot>", deep + b"</robot>")


def _many(content: bytes) -> bytes:
    rows = "".join(
        f'<link name="n{k}"/><joint name="j{k}" type="fixed"><parent link="'
        f'{f"n{k - 1}" if k else "base_link"}"/><child link="n{k}"/></joint>'
        for k in range(3000)
    )
    return content.replace(b"</robot>", rows.encode() + b"</robot>")


def _attributes(content: bytes) -> bytes:
    rows = " ".join(f'a{k}="1"' for k in range(50_000))
    return content.replace(b"<link ", b"<link " + rows.encode() + b" ", 1)


def _mimic_ring(content: bytes) -> bytes:
    names = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    for name, other in zip(names, (*names[1:], names[0]), strict=True):
        head = b'<joint name="%s_joint" type="revolute">' % name.encode()
        content = content.replace(head, head + b'<mimic joint="%s_joint"/>' % other.encode())
    return content


def _long_word(content: bytes) -> bytes:
    return content.replace(b"0 0 1", b"0 0 " + b"1" * 3_000_000, 1)


_BOMBS = {
    "entity bomb": _entities,
    "external entity": _external,
    "parameter entity": _parameter,
    "nested deep": _nested,
    "many links": _many,
    "many attributes": _attributes,
    "mimics in a ring": _mimic_ring,
    "a number of a million digits": _long_word,
}


def same_chain(before: bytes, after: bytes) -> bool:
    """Whether two URDFs say the same of every joint that carries something, as far as XML goes."""
    try:
        return _chain(before) == _chain(after)
    except (ET.ParseError, ValueError, LookupError):
        return False


def _chain(content: bytes) -> dict[str, object]:
    joints = ET.fromstring(content).findall("joint")  # noqa: S314 - only after imucalib took it
    return {
        joint.get("name", ""): (
            joint.get("type"),
            [(child.tag, sorted(child.items())) for child in joint if child.tag not in _IDLE],
        )
        for joint in joints
        if joint.get("name") != "imu_joint"
    }


_IDLE = {"limit", "dynamics", "visual", "calibration", "safety_controller"}
