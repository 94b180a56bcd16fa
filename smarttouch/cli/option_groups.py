"""Groups of options that several commands share, each defined once in a dataclass."""

import functools
import inspect
from collections.abc import Callable, Iterator
from dataclasses import Field, fields
from typing import Any, TypeVar, get_type_hints

_T = TypeVar("_T")


class OptionGroup:
    """Base of frozen dataclasses whose fields are options, annotated as typer wants them."""


def takes_options(**defaults: Any) -> Callable[[Callable[..., _T]], Callable[..., _T]]:
    """Let a command take the options of the groups among its parameters' types.

    It gets each group as one object. Its own option replaces one of the same name in a group;
    `defaults` replace those of the groups.
    """
    return functools.partial(_expanded, defaults=defaults)


def _expanded(command: Callable[..., _T], defaults: dict[str, Any]) -> Callable[..., _T]:
    hints = get_type_hints(command, include_extras=True)
    parameters = inspect.signature(command).parameters
    groups = {
        name: hints[name]
        for name in parameters
        if inspect.isclass(hints[name]) and issubclass(hints[name], OptionGroup)
    }

    def shared(group: Any) -> Iterator[Field[Any]]:
        return (each for each in fields(group) if each.name not in parameters)

    @functools.wraps(command)
    def expanded(**given: Any) -> _T:
        made = {
            name: group(**{each.name: given.pop(each.name) for each in shared(group)})
            for name, group in groups.items()
        }
        return command(**made, **given)

    del expanded.__wrapped__
    keyword = inspect.Parameter.KEYWORD_ONLY
    taken = [
        each.replace(annotation=hints[each.name], kind=keyword)
        for each in parameters.values()
        if each.name not in groups
    ]
    for group in groups.values():
        kinds = get_type_hints(group, include_extras=True)
        taken += [
            inspect.Parameter(
                each.name,
                keyword,
                default=defaults.get(each.name, each.default),
                annotation=kinds[each.name],
            )
            for each in shared(group)
        ]
    signature = inspect.Signature(taken, return_annotation=hints.get("return"))
    # Typer reads it, and the type of a function does not have it.
    expanded.__signature__ = signature  # type: ignore[attr-defined]
    expanded.__annotations__ = {each.name: each.annotation for each in taken}
    return expanded
