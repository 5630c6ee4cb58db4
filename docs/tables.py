"""The parts of the pages that are made from the code, by cog; a test compares them.

To write them again: ``cog -r -I . docs/*.md README.md``.
"""

from __future__ import annotations

import ast
import inspect
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

import typer

from imucalib_cli.cli.exit_codes import EXIT_CODES
from imucalib_cli.cli.main import COMMANDS, app
from imucalib_cli.cli.options import with_groups
from imucalib_cli.messages import MESSAGES
from imucalib_cli.report.words import WORDS
from imucalib_cli.sentences import CAUSES, cause

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

PACKAGE = Path(__file__).parents[1] / "imucalib_cli"
_VALUE = re.compile(r"\{[^{}]*\}")
_KINDS = {"Path": "FILE", "float": "NUMBER", "int": "NUMBER", "str": "TEXT"}


def commands() -> str:
    """Every command, and what it does."""
    rows = ((f"[`{name}`](#imucalib-{name})", _summary(name)) for name in COMMANDS)
    return _table(("command", "what it does"), rows)


def options(command: str, *panels: str, without: Iterable[str] = ()) -> str:
    """Options of a command, a table for each panel of its help.

    Args:
        command: Its name.
        panels: Only these; none are all.
        without: Panels that are left out.
    """
    tables: dict[str, list[tuple[str, ...]]] = {}
    annotations = inspect.signature(with_groups(COMMANDS[command])).parameters
    for option in typer.main.get_command(app).commands[command].params:  # type: ignore[attr-defined]
        if option.param_type_name == "option" and option.name in annotations:
            kind = get_args(annotations[option.name].annotation)[0]
            names = ", ".join(f"`{each}`" for each in (*option.opts, *option.secondary_opts))
            tables.setdefault(option.rich_help_panel or "Options", []).append(
                (names, _value(kind, option.metavar), _default(option), option.help or "")
            )
    wanted = [each for each in panels or tables if each not in without]
    return "\n".join(
        (f"{panel}:\n\n" if len(tables) > 1 else "")
        + _table(("option", "value", "default", "meaning"), tables[panel])
        for panel in wanted
    )


def exit_codes() -> str:
    """Every exit code."""
    rows = ((str(code), each.full, each.written) for code, each in EXIT_CODES.items())
    return _table(("code", "meaning", "what is written"), rows)


def messages() -> str:
    """Every message by its code; what is not always there stands in brackets."""
    told = {code: words for code, words in MESSAGES.items() if words is not cause}
    causes = {f"cause.{kind}": f"{what} (…): {remedy}" for kind, (what, remedy) in CAUSES.items()}
    rows = (
        (
            f"`{code}`",
            _VALUE.sub("…", words).replace("||", " or: ")
            if isinstance(words, str)
            else _subject(words),
        )
        for code, words in sorted({**told, **causes}.items())
    )
    return _table(("code", "words"), rows)


def _subject(composed: Callable[..., str]) -> str:
    return f"*{inspect.getdoc(composed)}*"


def rooms() -> str:
    """Which room imports which, as a diagram: only arrows that no path of others replaces."""
    imports = imported_rooms()
    lines = ["```mermaid", "flowchart BT"]
    for room, needed in imports.items():
        over = {far for near in needed for far in _reached(near, imports)}
        lines += [f"    {room} --> {other}" for other in sorted(needed - over)]
    return "\n".join([*lines, "```", ""])


def imported_rooms() -> dict[str, set[str]]:
    """Rooms that each room imports, at whatever moment."""
    rooms = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    return {room: _imported_by(room) & rooms - {room} for room in sorted(rooms)}


def _imported_by(room: str) -> set[str]:
    """First names, below the package's, of what is imported anywhere in a room."""
    return {
        str(node.module).split(".")[1]
        for path in (PACKAGE / room).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("imucalib_cli.")
    }


def _reached(room: str, imports: dict[str, set[str]]) -> set[str]:
    """Rooms that a room imports, and those that they import."""
    return imports[room].union(*(_reached(each, imports) for each in imports[room]))


def _summary(command: str) -> str:
    return (inspect.getdoc(COMMANDS[command]) or "").split("\n", maxsplit=1)[0]


def _value(kind: Any, metavar: str | None) -> str:
    """What follows the option on the command line."""
    kinds = [kind, *get_args(kind)]
    choices = next((get_args(each) for each in kinds if get_origin(each) is Literal), ())
    if kind is bool:
        return ""
    if metavar or choices:
        return f"`{metavar or '|'.join(choices)}`"
    return next(_KINDS[each.__name__] for each in kinds if isinstance(each, type))


def _default(option: Any) -> str:
    if isinstance(option.show_default, str):
        return option.show_default
    if option.required:
        return "needed"
    is_said = not (option.default in (None, (), []) or isinstance(option.default, bool))
    return str(option.default) if is_said else ""


def figures() -> str:
    """How to read each figure of a report."""
    parts = []
    for key, each in WORDS.items():
        title = each.title.format(quantity="Acceleration" if key == "accel" else "Angular rate")
        faults = "\n".join(f"- {fault}" for fault in each.faults)
        shows = _VALUE.sub("…", each.shows)
        parts.append(
            f"### {title}\n\n{shows}\n\n**Good:** {each.good}\n\n**Faults:**\n\n{faults}\n"
        )
    return "\n".join(parts)


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    cells = ([cell.replace("|", "\\|").replace("<", "\\<") for cell in line] for line in lines)
    return "".join(f"| {' | '.join(line)} |\n" for line in cells)
