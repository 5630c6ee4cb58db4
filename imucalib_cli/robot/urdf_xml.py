"""Read a URDF's XML as elements, without expanding entities.

Expat's events are used directly. A DOCTYPE (entity bombs, external entities) is therefore refused
at its start, before anything in it is expanded.
"""

from __future__ import annotations

from typing import TYPE_CHECKING
from xml.parsers import expat

from msgspec import Struct, field

from imucalib_cli.errors import InputError
from imucalib_cli.shown import as_word

if TYPE_CHECKING:
    from pathlib import Path

SIZE_LIMIT = 16 << 20
"""Bytes; the largest published robot descriptions have a few hundred kilobytes."""
DEPTH_LIMIT = 200
ELEMENT_LIMIT = 200_000
"""Ten times the elements of a humanoid with all meshes; more would take seconds and memory."""


class Element(Struct):
    """One element, with its children down to those inside a link's <inertial>."""

    tag: str
    attributes: dict[str, str]
    line: int
    start: int
    """Byte at which its start tag begins."""
    end: int = 0
    """Byte at which its end tag begins, if it has one."""
    children: list[Element] = field(default_factory=list)

    def find(self, tag: str) -> Element | None:
        """The first child of this tag."""
        return next((child for child in self.children if child.tag == tag), None)

    def findall(self, tag: str) -> list[Element]:
        """All children of this tag."""
        return [child for child in self.children if child.tag == tag]

    def value(self, tag: str, attribute: str) -> str:
        """An attribute of the first child of this tag; empty if either is missing."""
        child = self.find(tag)
        return "" if child is None else child.attributes.get(attribute, "")


def parse_xml(data: bytes, path: Path | str) -> Element:
    """Read a URDF's elements.

    Raises:
        InputError: It is not XML, is xacro, has a DOCTYPE, is too large, or is not a URDF.
    """
    root = read_elements(data, path)
    if root.tag != "robot":
        raise InputError(f"{path}: the root element is <{root.tag}>, not <robot>: give a URDF")
    if root.find("link") is None:
        raise InputError(f"{path}: <robot> has no <link>: give a complete URDF")
    return root


def read_elements(data: bytes, path: Path | str, *, expanded: bool = True) -> Element:
    """The root element of a URDF, or of a file of xacro if it need not be ``expanded``.

    Raises:
        InputError: It is not XML, is xacro, has a DOCTYPE, or is too large.
    """
    if len(data) > SIZE_LIMIT:
        raise InputError(
            f"{path}: has more than {SIZE_LIMIT >> 20} MB, too much for a URDF: check --urdf"
        )
    if not data.strip():
        raise InputError(f"{path}: the file is empty: check --urdf")
    try:
        return _Reader(path, expanded=expanded).read(data)
    except expat.ExpatError as error:
        raise InputError(
            f"{path}: not well-formed XML ({expat.ErrorString(error.code)}, line {error.lineno}, "
            f"column {error.offset + 1}): give a URDF"
        ) from None
    except (ValueError, LookupError) as error:
        raise InputError(
            f"{path}: its encoding cannot be read ({error}): save it as UTF-8"
        ) from None


class _Reader:
    """Elements down to those inside a link's <inertial>; nobody reads deeper ones."""

    def __init__(self, path: Path | str, *, expanded: bool) -> None:
        self._path, self._expanded = path, expanded
        self._document = Element("", {}, 0, 0)
        self._stack = [self._document]
        self._count = 0
        self._parser = expat.ParserCreate()
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.StartDoctypeDeclHandler = self._refuse_doctype

    def read(self, data: bytes) -> Element:
        self._parser.Parse(data, True)
        return self._document.children[0]

    def _refused(self, why: str) -> InputError:
        return InputError(f"{self._path}: {why}")

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        at = self._parser.CurrentByteIndex
        element = Element(tag, attributes, self._parser.CurrentLineNumber, at)
        xacro = f"<{tag}>" if tag.startswith("xacro:") else _xacro_in(element)
        if xacro and self._expanded:
            raise self._refused(
                f"line {element.line}: {xacro} is xacro, not URDF: expand it first with "
                f"`xacro {as_word(self._path)} > robot.urdf` and give robot.urdf"
            )
        self._count += 1
        if self._count > ELEMENT_LIMIT:
            raise self._refused(f"has more than {ELEMENT_LIMIT} elements: give a URDF")
        depth = len(self._stack)
        if depth > DEPTH_LIMIT:
            raise self._refused(f"elements are nested more than {DEPTH_LIMIT} deep: give a URDF")
        if depth <= 4:
            self._stack[-1].children.append(element)
        self._stack.append(element)

    def _end(self, _tag: str) -> None:
        self._stack.pop().end = self._parser.CurrentByteIndex

    def _refuse_doctype(self, *_args: object) -> None:
        raise self._refused(
            "has a DOCTYPE, which a URDF does not need and which may hide entities: remove it"
        )


def _xacro_in(element: Element) -> str:
    """The first attribute with a xacro expression, shown in its element; empty if there is none."""
    for name, value in element.attributes.items():
        counts = element.tag in ("robot", "link", "joint") or name in ("xyz", "rpy", "link")
        if counts and ("${" in value or "$(" in value):
            return " ".join(f'<{element.tag} {name}="{value}">'.split())
    return ""
