"""The help of a command: its most used options come first, examples come last."""

from __future__ import annotations

import re
from copy import copy
from typing import Any, NamedTuple

from typer.core import TyperCommand

MOST_USED = "Most used"
"""Panel of the arguments and options that most calls need."""
_LONGEST = 28
"""Letters of an option and its value in a line; most have fewer, and the words get the rest."""


class Guide(NamedTuple):
    """What the help of a command adds to its options."""

    most_used: tuple[str, ...] = ()
    """Options, in the order of the help."""
    examples: tuple[str, ...] = ()


GUIDES = {
    "run": Guide(
        ("--urdf", "--parent", "--imu-topic", "--output", "--format", "--report"),
        (
            "imucalib run walk.mcap --urdf robot.urdf",
            "imucalib run walk.mcap --urdf robot.urdf --parent torso -o imu.yaml --report imu.html",
        ),
    ),
    "batch": Guide(
        ("--urdf", "--parent", "--imu-topic", "--output", "--format", "--workers"),
        (
            "imucalib batch logs/ --urdf robot.urdf -o results/",
            "imucalib batch logs/*.bag --urdf robot.urdf --require 1mm,0.1deg --format csv",
        ),
    ),
    "inspect": Guide(
        examples=("imucalib inspect walk.mcap", "imucalib inspect walk.mcap --urdf robot.urdf"),
    ),
    "combine": Guide(
        ("--output", "--format"),
        (
            "imucalib combine results/ -o imu.yaml",
            "imucalib combine monday.npz tuesday.npz --robot exact",
        ),
    ),
    "apply": Guide(
        examples=(
            "imucalib apply imu.yaml --urdf robot.urdf -o calibrated.urdf",
            "imucalib apply imu.yaml --urdf robot.urdf --in-place",
        ),
    ),
    "verify": Guide(
        ("--urdf", "--parent", "--imu-topic", "--within", "--output", "--format"),
        (
            "imucalib verify walk.mcap --urdf robot.urdf",
            "imucalib verify imu.yaml --urdf robot.urdf --within 2mm,0.2deg",
        ),
    ),
    "simulate": Guide(
        examples=(
            "imucalib simulate rihibot -o arm.mcap --urdf arm.urdf",
            "imucalib simulate walker -o walk.bag --urdf walker.urdf --grade mems --seed 1",
        ),
    ),
}
"""By command; the help of others is short."""


class Command(TyperCommand):
    """A command whose help begins with what is most used."""

    def __init__(self, name: str | None, **settings: Any) -> None:
        super().__init__(name, **settings)
        self._guide = GUIDES.get(name or "", Guide())
        by_flag = {flag: each for each in self.params for flag in each.opts}
        first = [by_flag[flag] for flag in self._guide.most_used]
        for each in first:
            each.rich_help_panel = MOST_USED  # type: ignore[attr-defined]
        self.params = [*first, *(each for each in self.params if each not in first)]

    def get_params(self, ctx: Any) -> list[Any]:
        """Parameters of which the help shows no type beside an argument: its name says enough."""
        params: list[Any] = super().get_params(ctx)
        for each in params:
            if each.param_type_name == "argument":
                each.type = copy(each.type)
                each.type.get_metavar = lambda *_, **__: ""
        return params

    def format_help(self, ctx: Any, _formatter: Any) -> None:
        """Print the help in panels like those of typer, whose tables take longer than all else."""
        from rich.console import Console
        from rich.padding import Padding
        from rich.panel import Panel
        from rich.table import Table
        from rich.text import Text

        console = Console(highlight=False)
        usage = self.get_usage(ctx).removeprefix("Usage: ").rstrip()
        text = re.sub(r"(?<!\n)\n(?!\n)", " ", self.help or "")
        console.print(Padding(Text.assemble(("Usage: ", "yellow"), (usage, "bold")), 1))
        console.print(Padding(Text(text), (0, 1, 1, 1)))
        for title, params in self._panels(ctx).items():
            table = Table.grid(padding=(0, 2, 0, 0))
            table.add_column(style="cyan", width=_LONGEST, overflow="fold")
            table.add_column(overflow="fold")
            for each in params:
                names, words = each.get_help_record(ctx)
                if len(names) > _LONGEST:
                    names = names.replace("|", "| ")  # where it may be broken
                help_ = each.help or ""
                added = words[len(help_) :].replace("\\[", "[")  # some versions of typer escape it
                table.add_row(Text(names), Text.from_markup(help_).append(added, "dim"))
            console.print(Panel(table, title=title, title_align="left", border_style="dim"))
        if self._guide.examples:
            lines = "\n".join(f"  {line}" for line in self._guide.examples)
            console.print(Text(f" Examples:\n\n{lines}\n"), soft_wrap=True)

    def _panels(self, ctx: Any) -> dict[str, list[Any]]:
        """Parameters that the help shows, by the title of their panel."""
        panels: dict[str, list[Any]] = {}
        params = [each for each in self.get_params(ctx) if not getattr(each, "hidden", False)]
        for each in sorted(params, key=lambda each: each.param_type_name != "argument"):
            other = MOST_USED if self._guide.most_used else f"{each.param_type_name.title()}s"
            # click's own --help has no panel
            panels.setdefault(getattr(each, "rich_help_panel", None) or other, []).append(each)
        return panels
