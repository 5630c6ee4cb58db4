"""Options that several commands take alike, written once as the fields of a dataclass."""

from __future__ import annotations

import inspect
from dataclasses import MISSING, Field, fields
from typing import TYPE_CHECKING, Any, get_type_hints

if TYPE_CHECKING:
    from collections.abc import Callable

    Command = Callable[..., None]


def takes(**groups: type[Any]) -> Callable[[Command], Command]:
    """Let a command take the fields of dataclasses as options.

    Typer reads a command's options from its signature, so the groups are unfolded into it: a
    parameter ``name: Group`` of the command is replaced by the group's fields, which are
    annotated as typer has it, and the command is called with an instance of the group.

    Args:
        groups: Dataclass of each parameter, by the parameter's name.
    """

    def decorate(command: Command) -> Command:
        hints = get_type_hints(command, include_extras=True)
        parameters: list[inspect.Parameter] = []
        for parameter in inspect.signature(command).parameters.values():
            if parameter.name in groups:
                parameters += _unfolded(groups[parameter.name])
            else:
                parameters.append(parameter.replace(annotation=hints[parameter.name]))

        def unfolded(**given: Any) -> None:
            for name, group in groups.items():
                own = {field.name: given.pop(field.name) for field in fields(group)}
                given[name] = group(**own)
            command(**given)

        unfolded.__name__, unfolded.__doc__ = command.__name__, command.__doc__
        unfolded.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        unfolded.__annotations__ = {p.name: p.annotation for p in parameters}
        return unfolded

    return decorate


def given_options(group: Any) -> list[str]:
    """Options of a group that differ from their defaults, as the user wrote their names."""
    return [
        "--" + field.name.replace("_", "-")
        for field in fields(group)
        if (getattr(group, field.name) or None) != _default(field)  # an empty list is none
    ]


def _unfolded(group: type[Any]) -> list[inspect.Parameter]:
    hints = get_type_hints(group, include_extras=True)
    return [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=_default(field),
            annotation=hints[field.name],
        )
        for field in fields(group)
    ]


def _default(field: Field[Any]) -> Any:
    if field.default is MISSING:
        raise TypeError(f"option {field.name} has no default")
    return field.default
