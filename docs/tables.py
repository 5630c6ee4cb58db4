"""The parts of the pages that are made from the code, by cog; a test compares them.

To write them again: ``cog -r -I . docs/*.md README.md``.
"""

from __future__ import annotations

import ast
import inspect
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_origin

import typer

import imucalib_cli
from imucalib_cli.batch.tables import COLUMNS
from imucalib_cli.cli.exit_codes import EXIT_CODES
from imucalib_cli.cli.main import COMMANDS, app_of, command_of
from imucalib_cli.estimate.unknowns import SCALES, TABLE
from imucalib_cli.logs.messages.unitree import JOINTS_GO, JOINTS_HG
from imucalib_cli.messages import MESSAGES
from imucalib_cli.report.words import WORDS
from imucalib_cli.sentences import CAUSES, cause
from imucalib_cli.signals.imu.data_sheet import imu_names, load_imu_model

if TYPE_CHECKING:
    from collections.abc import Iterable

    from imucalib_cli.estimate.unknowns import Unknown
    from imucalib_cli.signals.imu.data_sheet import ImuModel

PACKAGE = Path(__file__).parents[1] / "imucalib_cli"
BENCHMARKS = PACKAGE.parent / "benchmarks/README.md"
_VALUE = re.compile(r"\{[^{}]*\}")
_CONDITION = re.compile(r"\[\w+(?:=[^?\]]*)?\?")
"""Of a clause of a message."""
_SECTIONS = {
    "derivation": "4.2",
    "methods": "4.3",
    "noise": "4.4",
    "initial-error": "4.5",
}
"""Of the paper, by the study that repeats them."""
_METHODS = ("paper", "paper, components", "matched, pose only", "matched")
_GROUPS = (
    *("nothing", "joint zeros", "origins", "joint axes", "joint curves", "sensor scales"),
    *("gravity's magnitude", "all of these"),
)
"""Of the ablation, those that change an error or the NEES most."""
_JUDGED = re.compile(rf"\| ({'|'.join(_METHODS)}): (.*) \| (.*) \| (met|not met|not judged) \|")
_TUNED = " Tuned."
"""How the docstring of such a number ends."""
_KINDS = {"Path": "FILE", "float": "NUMBER", "int": "NUMBER", "str": "TEXT"}


def commands() -> str:
    """Every command, and what it does."""
    rows = (
        (f"[`{name}`](#imucalib-{name})", _docstring(command_of(name)).split("\n")[0])
        for name in COMMANDS
    )
    return _table(("command", "what it does"), rows)


def options(command: str, *panels: str, without: Iterable[str] = ()) -> str:
    """Options of a command, a table for each panel of its help.

    Args:
        command: Its name.
        panels: Only these; none are all.
        without: Panels that are left out.
    """
    tables: dict[str, list[tuple[str, ...]]] = {}
    annotations = inspect.signature(command_of(command)).parameters
    for option in typer.main.get_command(app_of()).commands[command].params:  # type: ignore[attr-defined]
        if option.param_type_name == "option" and option.name in annotations:
            kind = annotations[option.name].annotation
            if get_origin(kind) is Annotated:
                kind = get_args(kind)[0]
            names = ", ".join(f"`{each}`" for each in (*option.opts, *option.secondary_opts))
            tables.setdefault(option.rich_help_panel or "Options", []).append(
                (names, _value(kind, option.metavar), _default(option), _unescaped(option.help))
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


def batch_columns() -> str:
    """Columns of the table of a batch."""
    rows = ((", ".join(f"`{each}`" for each in names.split()), what) for names, what, _ in COLUMNS)
    return _table(("column", "what it holds"), rows)


def motors() -> str:
    """Names of Unitree's motors, in their order."""
    rows = []
    for package, robots in (("unitree_go", JOINTS_GO), ("unitree_hg", JOINTS_HG)):
        for robot, names in robots.items():
            numbered = (f"{number} `{name}`" for number, name in enumerate(names) if name)
            rows.append((package, robot, ", ".join(numbered)))
    return _table(("package", "robot", "motors"), rows)


def messages() -> str:
    """Every message by its code; brackets hold what is not always there."""
    told = {code: words for code, words in MESSAGES.items() if words is not cause}
    causes = {f"cause.{kind}": text for kind, text in CAUSES.items()}
    rows = (
        (
            f"`{code}`",
            _VALUE.sub("…", _CONDITION.sub("[", words)).replace("||", " or: ")
            if isinstance(words, str)
            else f"*{inspect.getdoc(words)}*",
        )
        for code, words in sorted({**told, **causes}.items())
    )
    return _table(("code", "words"), rows)


def unknowns() -> str:
    """The table of unknowns, each with its prior."""
    rows = ((f"`{u.name}`", u.words, u.unit, _prior(u)) for u in TABLE)
    return _table(("entry", "what it is", "unit", "prior, 1σ"), rows)


def ablation() -> str:
    """What the groups of unknowns buy that matter most, in short."""
    told, rows = _measured("left out")
    shown = {row["left out"]: tuple(row.values()) for row in rows}
    return f"{told}:\n\n" + _table(tuple(rows[0]), (shown[group] for group in _GROUPS))


def sweeps() -> str:
    """Errors and NEES of imperfect robots, in short: a line for each row, a column for a robot."""
    told, rows = _measured("robot")
    lines: dict[str, list[str]] = {}
    for each in rows:
        figures = (each["RMS mm"], each["RMS deg"], each["NEES mean"])
        lines.setdefault(each["row"], []).append(", ".join(figures))
    robots = dict.fromkeys(f"{each['robot']}: mm, deg, NEES" for each in rows)
    return f"{told}:\n\n" + _table(("row", *robots), ((row, *of) for row, of in lines.items()))


def _measured(first: str) -> tuple[str, list[dict[str, str]]]:
    """Of the benchmarks' first table with such a first column: seeds and code, and its rows."""
    before, head, after = BENCHMARKS.read_text("utf-8").partition(f"\n| {first} |")
    told = re.findall(r"\d+ seeds[^.:]*by the code of \w+", before)[-1]
    table = (head + after).strip().split("\n\n")[0].split("\n")
    heads, _, *rows = (line[2:-2].split(" | ") for line in table)
    return told, [dict(zip(heads, row, strict=True)) for row in rows]


def _prior(unknown: Unknown) -> str:
    if unknown.scale is None:
        return f"{unknown.std:g}"
    scale = SCALES[unknown.scale]
    walking = "" if scale.walking is None else f"; {scale.walking:g} with a base IMU"
    usual = "" if scale.usual is None else f", usually {scale.usual:g}"
    return f"learnt, {scale.low:g} to {scale.high:g}{usual}{walking}"


def imus() -> str:
    """IMUs by their data sheets."""
    heads = (
        *("`--imu-model`", "what it is", "noise µg/√Hz", "noise °/s/√Hz", "in-run µg"),
        *("in-run °/h", "bias mg", "bias °/s", "up to g", "up to °/s", "figures from"),
    )
    return _table(heads, (_imu(load_imu_model(name)) for name in imu_names()))


def _imu(model: ImuModel) -> tuple[str, ...]:
    kinds = {"typical": "", "1 sigma": " σ", "max": " max"}

    def figure(value: float | None, kind: str = "typical") -> str:
        return "-" if value is None else f"{value:g}{kinds[kind]}"

    return (
        f"[`{model.name}`](../configs/imus/{model.name}.yaml)",
        f"{model.maker} {model.title}",
        figure(model.accel_noise_ug),
        figure(model.gyro_noise_deg),
        figure(model.accel_bias_instability_ug),
        figure(model.gyro_bias_instability_deg_h),
        figure(model.accel_bias_mg, model.accel_bias_kind),
        figure(model.gyro_bias_deg, model.gyro_bias_kind),
        figure(max(model.accel_range_g)),
        figure(max(model.gyro_range_deg)),
        f"[{model.sources[0].document}]({model.sources[0].url})",
    )


def claims() -> str:
    """Every claim of the paper that a study judged, by method, as the study printed it."""
    rows: dict[tuple[str, ...], dict[str, str]] = {}
    for path in (PACKAGE.parent / "docs/reproduction").glob("*.md"):
        for line in path.read_text("utf-8").replace("\\", "").splitlines():
            found = _JUDGED.fullmatch(line)
            if found is not None:
                method, claim, figures, verdict = found.groups()
                row = (_SECTIONS[path.stem], claim, f"`imucalib study {path.stem}`")
                rows.setdefault(row, {})[method] = f"{figures} ({verdict})"
    heads = ("section", "claim", "command", *(f"`{method}`" for method in _METHODS))
    told = ((*row, *(cells.get(each, "") for each in _METHODS)) for row, cells in rows.items())
    return _table(heads, sorted(told, key=lambda row: row[0]))


def tuned() -> str:
    """Numbers that no physics, data sheet, standard or chance gives, with where they stand."""
    rows = []
    for path in sorted(PACKAGE.rglob("*.py")):
        body, place = ast.parse(path.read_text("utf-8")).body, path.relative_to(PACKAGE)
        # Constants on neighbouring lines, which one text explains.
        group: list[tuple[str, str]] = []
        last = 0
        for statement in body:
            if statement.lineno > last + 1:
                group = []
            last = statement.end_lineno or 0
            match statement:
                case ast.Assign([name], value) | ast.AnnAssign(name, _, ast.expr() as value):
                    group.append((f"`{ast.unparse(name)}`", f"`{ast.unparse(value)}`"))
                    continue
                case ast.Expr(ast.Constant(str(text))) if group:
                    why = " ".join(text.split())
                    if why.endswith(_TUNED):
                        names, values = (", ".join(each) for each in zip(*group, strict=True))
                        shown = f"{names} in [{place}](../imucalib_cli/{place})"
                        rows.append((shown, values, why.removesuffix(_TUNED)))
            group = []
    return _table(("number", "value", "what it is"), rows)


def rooms() -> str:
    """Which room imports which, as a diagram: only arrows that no path of others replaces."""
    imports = imported_rooms()

    def reached(room: str) -> set[str]:
        return imports[room].union(*map(reached, imports[room]))

    lines = ["```mermaid", "flowchart BT"]
    for room, needed in imports.items():
        over = {far for near in needed for far in reached(near)}
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


def _unescaped(text: str | None) -> str:
    """A text of the help, in which a bracket is escaped for rich."""
    return (text or "").replace("\\[", "[")


def _value(kind: Any, metavar: str | None) -> str:
    """What follows the option on the command line."""
    kinds = [kind, *get_args(kind)]
    choices = next((get_args(each) for each in kinds if get_origin(each) is Literal), ())
    if bool in kinds:
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


def functions(*names: str) -> str:
    """What functions of the Python interface do and take."""
    return "\n".join(_function(name) for name in names)


def classes(*names: str, with_methods: bool = False) -> str:
    """What classes of the Python interface are, and their fields."""
    return "\n".join(_class(name, with_methods=with_methods) for name in names)


def _function(name: str) -> str:
    """What a function does, and a table of its arguments."""
    function = getattr(imucalib_cli, name)
    words, *sections = re.split(r"\n\n(Args|Returns|Raises):\n", _docstring(function))
    told = {kind: _entries(text) for kind, text in zip(sections[::2], sections[1::2], strict=True)}
    rows = []
    for each in inspect.signature(function).parameters.values():
        default = "needed" if each.default is each.empty else f"`{each.default!r}`"
        rows.append((f"`{each.name}`", f"`{each.annotation}`", default, told["Args"][each.name]))
    raised = "".join(f"- `{error}`: {when}\n" for error, when in told["Raises"].items())
    table = _table(("argument", "type", "default", "meaning"), rows)
    return f"### `ic.{name}`\n\n{_markdown(words)}\n\n{table}\nRaises:\n\n{raised}"


def _docstring(documented: object) -> str:
    return inspect.getdoc(documented) or ""


def _entries(text: str) -> dict[str, str]:
    """Of a section of a docstring, what it says of each name."""
    joined = re.sub(r"\n\s{8,}", " ", text)
    pairs = re.findall(r"^ {4}(\w+): (.*)$", joined, flags=re.MULTILINE)
    return {name: _markdown(words) for name, words in pairs}


def _class(name: str, *, with_methods: bool) -> str:
    kind = getattr(imucalib_cli, name)
    (tree,) = ast.parse(inspect.getsource(kind)).body
    assert isinstance(tree, ast.ClassDef)  # noqa: S101
    rows = []
    for member, after in zip(tree.body, [*tree.body[1:], ast.Pass()], strict=True):
        if isinstance(member, ast.AnnAssign):
            said = ast.get_docstring(ast.Module([after], [])) or ""
            value = f"`{ast.unparse(member.value)}`" if member.value else ""
            # of a bounded type the bounds are said in the docstring
            of = re.sub(r"^Annotated\[(.*), Meta\(.*\)\]$", r"\1", ast.unparse(member.annotation))
            rows.append((ast.unparse(member.target), of, value, said))
        elif with_methods and isinstance(member, ast.FunctionDef) and member.name[0] != "_":
            is_property = any(ast.unparse(each) == "property" for each in member.decorator_list)
            called = member.name if is_property else f"{member.name}({_arguments(member)})"
            said = re.split(r"\n\n(?:Args|Raises):", ast.get_docstring(member) or "")[0]
            rows.append((called, ast.unparse(member.returns or ast.Constant(None)), "", said))
    table = _table(
        ("field", "type", "default", "meaning"),
        ((f"`{name}`", f"`{of}`", default, _markdown(said)) for name, of, default, said in rows),
    )
    return f"### `ic.{name}`\n\n{_markdown(_docstring(kind))}\n\n{table}"


def _arguments(function: ast.FunctionDef) -> str:
    return ", ".join(each.arg for each in (*function.args.args[1:], *function.args.kwonlyargs))


def _markdown(docstring: str) -> str:
    """A docstring's words: roles and double backticks are plain backticks, and lines are joined."""
    words = re.sub(r":\w+:`~?(?:[\w.]+\.)?(\w+)`", r"`\1`", docstring).replace("``", "`")
    return re.sub(r"\s*\n\s*", " ", words)


def printed() -> str:
    """What the README shows of a run; a test compares it with a run."""
    readme = (PACKAGE.parent / "README.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"^```text\n.*?^```\n", readme, flags=re.DOTALL | re.MULTILINE)
    return str(text)


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    cells = ([cell.replace("|", "\\|").replace("<", "\\<") for cell in line] for line in lines)
    return "".join(f"| {' | '.join(line)} |\n" for line in cells)
