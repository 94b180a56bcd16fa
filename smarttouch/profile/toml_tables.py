"""Base class of the tables of a profile, and error messages for invalid files."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from smarttouch.base.errors import ProfileError, TableError
from smarttouch.base.files import read_toml


class UnfitError(ValueError):
    """Error about an inconsistent value in a profile. Loading a file converts it to a
    `ProfileError` with the same attributes. By default, ``key`` is the key from pydantic."""

    def __init__(self, message: str, **attributes: Any) -> None:
        super().__init__(message)
        self.attributes = attributes


class AllUnfitError(ValueError):
    """Error about all inconsistent values in a profile."""

    def __init__(self, errors: tuple[UnfitError, ...]) -> None:
        super().__init__("; ".join(map(str, errors)))
        self.errors = errors


def raise_all(errors: Iterable[UnfitError]) -> None:
    """Raise all errors together, if any."""
    if complaints := tuple(errors):
        raise AllUnfitError(complaints)


def _require_sensible(value: float) -> float:
    if not SMALLEST <= value <= LARGEST:
        raise UnfitError(
            f"{value:g} is out of range: give a number from {SMALLEST:g} to {LARGEST:g}"
        )
    return value


SMALLEST, LARGEST = 1e-9, 1e9
"""Range of plausible lengths, currents, impedances and times, in the units of profiles."""
Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Field(gt=0), AfterValidator(_require_sensible)]


class Table(BaseModel):
    """Read-only table of a TOML file, which rejects unknown keys, NaN and infinite numbers."""

    model_config: ClassVar[ConfigDict] = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False
    )

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with ``update`` applied, validated like a file."""
        if not update:
            return super().model_copy(deep=deep)
        set_fields = {name: getattr(self, name) for name in self.model_fields_set}
        return self.model_validate(set_fields | dict(update))


_LAYOUTS = ("grid", "hexagon-61", "lines", "free")
_KINDS = ("constrained-", "function-", "tuple[", "str-enum[")
_WHOLE_KINDS = ("bool", "int", "float", "str", "SlotPolicy")
"""Names of types that pydantic inserts into the path of keys."""
_NOT_OF_KIND = ("float_type", "tuple_type")
"""Pydantic errors about a whole value. They are dropped if an item of the value has an error."""
_MOST_IN_A_SENTENCE = 8

_Error = TypeVar("_Error", bound=TableError)
_Table = TypeVar("_Table", bound=BaseModel)
Found = tuple[str, dict[str, Any]]  # message, and attributes of the error


def load_model(path: Path, kind: type[_Table], **more: object) -> _Table:
    """Load a TOML file as a model. Values in ``more`` take precedence over the file."""
    return validated(kind, path, read_toml(path, ProfileError) | more)


def validated(kind: type[_Table], name: object, table: dict[str, Any]) -> _Table:
    """Validate a table as a model. Raises ProfileError, whose message begins with ``name``."""
    try:
        return kind.model_validate(table)
    except ValidationError as error:
        raise table_error(ProfileError, name, error) from None


def table_error(kind: type[_Error], name: object, error: ValidationError) -> _Error:
    """Return an error whose message lists up to 8 problems of a file and counts all others."""
    details = [*_complaints(error)]
    sentences = [words for words, _ in details[:_MOST_IN_A_SENTENCE]]
    if len(details) > len(sentences):
        sentences.append(f"and {len(details) - len(sentences)} more")
    complaints = [(detail["key"], f"{name}: {words}") for words, detail in details]
    return kind(f"{name}: {'; '.join(sentences)}", complaints=complaints, **details[0][1])


def _complaints(error: ValidationError) -> Iterator[Found]:
    keyed = [(_key(detail), detail) for detail in error.errors()]
    for index, (key, detail) in enumerate(keyed):
        before = any(key == other for other, _ in keyed[:index])
        deeper = any(other.startswith(f"{key}.") for other, _ in keyed)
        if before or (detail["type"] in _NOT_OF_KIND and deeper):
            continue
        unfit = detail.get("ctx", {}).get("error")
        if isinstance(unfit, AllUnfitError):
            for one in unfit.errors:
                yield str(one), {"key": key} | one.attributes
        else:
            yield _in_words(key, detail), {"key": key} | getattr(unfit, "attributes", {})


def _key(error: Mapping[str, Any]) -> str:
    parts = [str(part) for part in error["loc"] if part not in (*_LAYOUTS, *_WHOLE_KINDS)]
    key = ".".join(key_part for key_part in parts if not key_part.startswith(_KINDS))
    return f"{key}.layout" if error["type"].startswith("union_tag") else key


def _in_words(key: str, error: Mapping[str, Any]) -> str:
    kind, entered = error["type"], error["input"]
    words = error["msg"].removeprefix("Value error, ").replace("valid tuple", "list")
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"unknown key {key!r}: remove it or correct its spelling"
    if kind in ("missing", "union_tag_not_found"):
        return f"key {key!r} is missing: add it (any shipped profile shows how)"
    if kind == "union_tag_invalid":
        return f"{key} = {repr(error['ctx']['tag'])[:60]}: choose one of {', '.join(_LAYOUTS)}"
    if isinstance(entered, dict) and key:
        return f"{key}: {words}"
    return f"{key} = {repr(entered)[:60]}: {words}" if key else words
