"""All that pydantic finds wrong in a file, each fault in words and once."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from smarttouch.errors import Complaint, ProfileError, TableError
from smarttouch.files import read_toml
from smarttouch.profile.table import AllUnfitError, UnfitError

_LAYOUTS = ("grid", "hexagon-61", "lines", "free")
_KINDS = ("constrained-", "function-", "tuple[", "str-enum[")
_WHOLE_KINDS = ("bool", "int", "float", "str", "SlotPolicy")
"""Kinds of value that pydantic names between the keys of the file."""
_NOT_OF_KIND = ("float_type", "tuple_type")
"""Choices that are named for each kind that a value fails to be."""
_PROBLEMS = {
    "missing": "missing",
    "union_tag_not_found": "missing",
    "extra_forbidden": "unknown",
    "unexpected_keyword_argument": "unknown",
    "literal_error": "unknown",
    "union_tag_invalid": "unknown",
    "greater_than": "too small",
    "greater_than_equal": "too small",
    "less_than": "too large",
    "less_than_equal": "too large",
    "too_short": "too few",
    "too_long": "too many",
}
"""Problems of `SmartTouchError` by the names that pydantic has for them."""
_BOUNDS = ("gt", "ge", "lt", "le", "min_length", "max_length")
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
    sentences = [f"{name}: {words}" for words, _ in found]
    told = [words for words, _ in found[:_MOST_IN_A_SENTENCE]]
    if len(found) > len(told):
        told.append(f"and {len(found) - len(told)} more")
    complaints = [
        Complaint(each["about"], each["problem"], each["value"], each["allowed"])
        for _, each in found
    ]
    return kind(
        f"{name}: {'; '.join(told)}", complaints=complaints, sentences=sentences, **found[0][1]
    )


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
                yield str(one), _attributes(key, each) | one.attributes
        else:
            yield _in_words(key, each)


def _key(error: Mapping[str, Any]) -> str:
    parts = [str(part) for part in error["loc"] if part not in (*_LAYOUTS, *_WHOLE_KINDS)]
    key = ".".join(each for each in parts if not each.startswith(_KINDS))
    return f"{key}.layout" if error["type"].startswith("union_tag") else key


def _attributes(key: str, error: Mapping[str, Any]) -> dict[str, Any]:
    context = error.get("ctx", {})
    problem = _PROBLEMS.get(error["type"], "malformed")
    return {
        "about": key,
        "problem": problem,
        "value": None if problem == "missing" else error["input"],
        "allowed": next((context[each] for each in _BOUNDS if each in context), None),
    }


def _in_words(key: str, error: Mapping[str, Any]) -> Found:
    kind, given, context = error["type"], error["input"], error.get("ctx", {})
    attributes = _attributes(key, error)
    words = error["msg"].removeprefix("Value error, ").replace("valid tuple", "list")
    if isinstance(context.get("error"), UnfitError):
        attributes |= context["error"].attributes
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"unknown key {key!r}: remove it or correct its spelling", attributes
    if kind in ("missing", "union_tag_not_found"):
        return f"key {key!r} is missing: add it (any shipped profile shows how)", attributes
    if kind == "union_tag_invalid":
        tag = context["tag"]
        words = f"{key} = {repr(tag)[:60]}: choose one of {', '.join(_LAYOUTS)}"
        return words, attributes | {"value": tag, "allowed": _LAYOUTS}
    if isinstance(given, dict) and key:
        return f"{key}: {words}", attributes
    return f"{key} = {repr(given)[:60]}: {words}" if key else words, attributes
