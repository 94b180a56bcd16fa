"""Program that prints the reference of all profile keys, made from the models of a profile. Run
``python docs/_ext/profile_keys.py > docs/reference/profile-keys.md``."""

import ast
import inspect
import textwrap
from collections.abc import Iterator, Mapping
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo

from smarttouch.profile.electrodes import ArrayLayout
from smarttouch.profile.profile import Profile
from smarttouch.profile.profile_tables import Calibrated
from smarttouch.profile.toml_tables import LARGEST, Table

_UNITS = {
    "_s_per_m": "S/m",
    "_uc_cm2": "µC/cm²",
    "ua_per_count": "µA",
    "_kohm": "kΩ",
    "_mm": "mm",
    "_deg": "°",
    "_ma": "mA",
    "_us": "µs",
    "_uc": "µC",
    "_mc": "mC",
    "_hz": "Hz",
    "_n": "N",
    "_s": "s",
}
"""Units by the ending of a key. The first ending that fits is used, so longer ones come first."""
_TYPES = {float: "number", int: "integer", str: "text", bool: "true or false"}
_BOUNDS = {"gt": "> {}", "ge": "≥ {}", "lt": "< {}", "le": "≤ {}"}
_LENGTHS = {"min_length": "at least {} long", "max_length": "at most {} long"}

Row = tuple[str, str, str, str, str, str]  # key, type, unit, default, limits and meaning


def key_reference() -> str:
    """Return all keys of a profile as Markdown: type, unit, default, limits and meaning."""
    parts = [
        "# Keys of a profile\n",
        "Made by `docs/_ext/profile_keys.py` from the models that check every profile. A profile "
        "with any other key is rejected. A key without a default must be given. Currents are "
        "magnitudes.\n",
    ]
    for name, table in _tables():
        parts.append(f"## {name}\n\n{inspect.cleandoc(table.__doc__ or '')}\n")
        parts.append(
            "| key | type | unit | default | limits | meaning |\n|---|---|---|---|---|---|"
        )
        parts += [f"| {' | '.join(row)} |" for row in key_rows(table)]
        parts.append("")
    return "\n".join(parts)


def key_rows(table: type[Table]) -> Iterator[Row]:
    """Yield a row for each key of a table, except for keys that are tables themselves."""
    meanings = _attribute_docstrings(table)
    for name, field in table.model_fields.items():
        if (table is Profile and name == "name") or _inner(field.annotation):
            continue
        meaning = field.description or meanings.get(name, "")
        yield (
            f"`{name}`",
            _type_of(field.annotation),
            next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), ""),
            _default_of(field),
            ", ".join(dict.fromkeys(_limits_of(field))),
            " ".join(meaning.replace("``", "`").split()),
        )


def _tables() -> Iterator[tuple[str, type[Table]]]:
    """Yield the heading and the model of each table, in the order of a profile's file."""
    yield "Top of the file", Profile
    for layout in get_args(get_args(ArrayLayout)[0]):
        (value,) = get_args(layout.model_fields["layout"].annotation)
        yield f'`[array]` with `layout = "{value}"`', layout
    for name, field in Profile.model_fields.items():
        if name not in ("array", "calibrated") and (inner := _inner(field.annotation)):
            yield f"`[{name}]`", inner
            for key, each in inner.model_fields.items():
                if deeper := _inner(each.annotation):
                    yield f"`[{name}.{key}]`", deeper
    yield "`[calibrated.NAME]`", Calibrated


def _inner(annotation: Any) -> type[Table] | None:
    """Return the table model that an annotation is or contains; None if it has none."""
    if inspect.isclass(annotation) and issubclass(annotation, Table):
        return annotation
    return next(filter(None, map(_inner, get_args(annotation))), None)


def _type_of(annotation: Any) -> str:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _type_of(arguments[0])
    if origin is Literal:
        return " or ".join(f'`"{each}"`' for each in arguments)
    if origin in (Union, UnionType):
        return " or ".join(_type_of(each) for each in arguments if each is not NoneType)
    if origin is tuple and Ellipsis in arguments:
        return f"list of {_plural(_type_of(arguments[0]))}"
    if origin is tuple:
        return f"{len(arguments)} {_plural(_type_of(arguments[0]))}"
    return _TYPES.get(annotation, "date and time")


def _plural(one: str) -> str:
    first, _, rest = one.partition(" ")
    if one in _TYPES.values():
        return f"{one}s"
    return f"lists of {first} {rest}" if first.isdigit() else one


def _default_of(field: FieldInfo) -> str:
    if field.is_required():
        return "must be given"
    value = field.default
    if value is None:
        return ""
    if isinstance(value, str):
        return f'`"{value}"`'
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, tuple):
        value = list(value)
    return f"`{str(value).replace(chr(39), chr(34))}`"


def _limits_of(field: FieldInfo) -> Iterator[str]:
    for part in _constraints(field.annotation, field.metadata):
        for names in (_BOUNDS, _LENGTHS):
            for name, words in names.items():
                bound = getattr(part, name, None)
                if bound is not None and abs(bound) < LARGEST:
                    yield words.format(f"{bound:g}")


def _constraints(annotation: Any, metadata: Any) -> Iterator[Any]:
    for part in metadata:
        yield from getattr(part, "metadata", ()) or (part,)
    for each in get_args(annotation):
        if get_origin(annotation) is not Annotated or each is get_args(annotation)[0]:
            yield from _constraints(each, getattr(each, "__metadata__", ()))


def _attribute_docstrings(table: type[Table]) -> Mapping[str, str]:
    """Return the docstring below each attribute of a class."""
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(table))).body
    assert isinstance(tree, ast.ClassDef)
    found = {}
    for before, after in zip(tree.body, tree.body[1:], strict=False):
        if isinstance(before, ast.AnnAssign) and isinstance(after, ast.Expr):
            assert isinstance(before.target, ast.Name)
            found[before.target.id] = ast.literal_eval(after.value)
    return found


if __name__ == "__main__":
    print(key_reference(), end="")
