"""Options of documents and of the form in which they are read; ``-`` for standard input."""

import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smarttouch.base.command_options import option
from smarttouch.base.errors import SmartTouchError
from smarttouch.base.files import named_file
from smarttouch.cli.options import OptionGroup

if TYPE_CHECKING:
    from smarttouch.reading.braille_lines import Braille
    from smarttouch.reading.letter_shapes import Shapes
    from smarttouch.reading.recognition import RecognitionOptions

_MOST_BYTES = 256_000_000


def or_standard_input(ctx: typer.Context, given: str | None) -> str | None:
    """Return the value of an argument; for ``-``, a file with the content of standard input.

    ``page:-`` stands for the URL of such a file. It is removed when the command ends.
    """
    prefix, dash, options = (given or "").partition("-")
    if not dash or prefix not in ("", "page:") or (options and not options.startswith("?")):
        return given
    if options and not prefix:
        return given
    return f"{prefix}{ctx.with_resource(_file_of_standard_input())}{options}"


@contextmanager
def _file_of_standard_input() -> Iterator[Path]:
    stream = getattr(sys.stdin, "buffer", None)
    data = sys.stdin.read().encode() if stream is None else stream.read(_MOST_BYTES + 1)
    if not data:
        raise SmartTouchError(
            "standard input holds nothing: give a file, or pipe a text or a page into the command"
        )
    if len(data) > _MOST_BYTES:
        raise SmartTouchError(
            f"standard input holds more than {_MOST_BYTES / 1e6:,.0f} MB: give a file"
        )
    with tempfile.TemporaryDirectory(prefix="smarttouch-") as folder:
        path = Path(folder) / "standard input"
        path.write_bytes(data)
        yield path


_TESSERACT = {
    "ar": "ara", "cs": "ces", "da": "dan", "de": "deu", "el": "ell", "en": "eng", "es": "spa",
    "fi": "fin", "fr": "fra", "he": "heb", "hi": "hin", "hu": "hun", "it": "ita", "ja": "jpn",
    "ko": "kor", "nl": "nld", "pl": "pol", "pt": "por", "ru": "rus", "sv": "swe", "tr": "tur",
    "uk": "ukr",
}  # fmt: skip
"""Languages as Tesseract names them, by their tags."""
_TAGS = {code: tag for tag, code in _TESSERACT.items()}


@dataclass(frozen=True, kw_only=True)
class DocumentOptions(OptionGroup):
    """Options of a document."""

    password_file: Annotated[
        str | None,
        option(
            "Read the password of a locked PDF from this file, or from standard input (-). It is "
            "asked for at a terminal otherwise.",
            "FILE|-",
        ),
    ] = None
    languages: Annotated[
        str | None,
        option("Name the language of the text, such as en or fr.", "TAG", "--language"),
    ] = None

    def recognition(self, source: str) -> "tuple[str, RecognitionOptions]":
        """Return the document, and its options: these, and those that follow its name."""
        from smarttouch.base.errors import BrailleError, PageError
        from smarttouch.base.url_options import joined_options, read_options
        from smarttouch.pages.document import password_of
        from smarttouch.pages.file_kinds import FileKind, file_kind
        from smarttouch.reading.recognition import RecognitionOptions

        source = source.removeprefix("page:")
        place, in_name = source, dict[str, Any]()
        if Path(source.rpartition("?")[0]).is_file():
            place, in_name = read_options(RecognitionOptions, source, PageError, but=("password",))
        if not place.startswith("text:") and named_file(place, BrailleError) is None:
            place = f"text:{place}"
        given = dict[str, Any]()
        if self.languages is not None:
            given["languages"] = "+".join(
                _TESSERACT.get(each.partition("-")[0], each) for each in self.languages.split("+")
            )
        if not place.startswith("text:") and file_kind(Path(place)) is FileKind.PAGES:
            given["password"] = password_of(Path(place), self.password_file)
        given = joined_options(source, given, in_name, PageError)
        return place, RecognitionOptions(**given)


TableOption = Annotated[
    str | None,
    option(
        "Choose the Braille table; --tables lists them. The language chooses one otherwise.",
        "NAME",
    ),
]


def table_of(table: str | None, language: str | None) -> str:
    """Return the name of the Braille table: that given, or that of the first language."""
    first = (language or "en").partition("+")[0]
    return table or _TAGS.get(first, first)


@dataclass(frozen=True)
class _Form:
    """Options that follow the name of a form in ``--as``."""

    table: str | None = None
    speed_mm_s: float | None = None


@dataclass(frozen=True, kw_only=True)
class FormOptions(OptionGroup):
    """Options of letter shapes and Braille."""

    kind: Annotated[
        str | None,
        option(
            "Read shapes or braille. Options follow: 'shapes?speed_mm_s=20', "
            "'braille?table=en-2&speed_mm_s=40'.",
            "FORM",
            "--as",
        ),
    ] = None

    def presentation(
        self, usual: str, language: str | None = None
    ) -> "tuple[Shapes | Braille, float | None]":
        """Return letter shapes or Braille, and the speed asked for, mm/s.

        Without a table, it is that of the language.
        """
        from smarttouch.base.errors import ReadingError, choice_of
        from smarttouch.base.url_options import options_of, read_options
        from smarttouch.reading.braille_lines import Braille
        from smarttouch.reading.letter_shapes import Shapes

        text, given = read_options(_Form, self.kind or usual, ReadingError)
        if "?" in text:
            known = ", ".join(sorted(options_of(_Form)))
            message = f"{text!r} has an option that there is not: choose {known}"
            raise ReadingError(message)
        form = _Form(**given)
        if choice_of("kind", text, ("shapes", "braille")) == "shapes":
            return Shapes(), form.speed_mm_s
        return Braille(table_of(form.table, language)), form.speed_mm_s
