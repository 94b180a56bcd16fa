"""All that pydantic finds wrong in a file, each fault in words and once."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from smarttouch.errors import ProfileError, TableError
from smarttouch.files import read_toml
from smarttouch.profile.table import AllUnfitError

_LAYOUTS = ("grid", "hexagon-61", "lines", "free")
_KINDS = ("constrained-", "function-", "tuple[", "str-enum[")
_WHOLE_KINDS = ("bool", "int", "float", "str", "SlotPolicy")
"""Kinds of value that pydantic names between the keys of the file."""
_NOT_OF_KIND = ("float_type", "tuple_type")
"""Choices that are named for each kind that a value fails to be."""
_MOST_IN_A_SENTENCE = 8

_Error = TypeVar("_Error", bound=TableError)
_Table = TypeVar("_Table", bound=BaseModel)
Found = tuple[str, dict[str, Any]]  # words on a fault, and attributes of its error


def load_model(path: Path, kind: type[_Table], **more: object) -> _Table:
    """Load a TOML file as a model, with further values."""
    table = read_toml(path, ProfileError)
    try:
        return kind.model_validate(table | more)
    except ValidationError as error:
        raise table_error(ProfileError, path, error) from None


def table_error(kind: type[_Error], name: object, error: ValidationError) -> _Error:
    """Return the error that lists all that is wrong in a file."""
    found = [*_complaints(error)]
    told = [words for words, _ in found[:_MOST_IN_A_SENTENCE]]
    if len(found) > len(told):
        told.append(f"and {len(found) - len(told)} more")
    complaints = [(each["about"], f"{name}: {words}") for words, each in found]
    return kind(f"{name}: {'; '.join(told)}", complaints=complaints, **found[0][1])


def _complaints(error: ValidationError) -> Iterator[Found]:
    keyed = [(_key(each), each) for each in error.errors()]
    for index, (key, each) in enumerate(keyed):
        before = any(key == other for other, _ in keyed[:index])
        deeper = any(other.startswith(f"{key}.") for other, _ in keyed)
        if before or (each["type"] in _NOT_OF_KIND and deeper):
            continue
        unfit = each.get("ctx", {}).get("error")
        if isinstance(unfit, AllUnfitError):
            for one in unfit.errors:
                yield str(one), {"about": key} | one.attributes
        else:
            yield _in_words(key, each), {"about": key} | getattr(unfit, "attributes", {})


def _key(error: Mapping[str, Any]) -> str:
    parts = [str(part) for part in error["loc"] if part not in (*_LAYOUTS, *_WHOLE_KINDS)]
    key = ".".join(each for each in parts if not each.startswith(_KINDS))
    return f"{key}.layout" if error["type"].startswith("union_tag") else key


def _in_words(key: str, error: Mapping[str, Any]) -> str:
    kind, given = error["type"], error["input"]
    words = error["msg"].removeprefix("Value error, ").replace("valid tuple", "list")
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"unknown key {key!r}: remove it or correct its spelling"
    if kind in ("missing", "union_tag_not_found"):
        return f"key {key!r} is missing: add it (any shipped profile shows how)"
    if kind == "union_tag_invalid":
        return f"{key} = {repr(error['ctx']['tag'])[:60]}: choose one of {', '.join(_LAYOUTS)}"
    if isinstance(given, dict) and key:
        return f"{key}: {words}"
    return f"{key} = {repr(given)[:60]}: {words}" if key else words
