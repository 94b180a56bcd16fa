"""Options of documents and of the form in which they are read."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smarttouch.cli.option_groups import OptionGroup

if TYPE_CHECKING:
    from smarttouch.reading.braille import Braille
    from smarttouch.reading.printed import RecognitionOptions
    from smarttouch.reading.shapes import Shapes

_FORM = "Form of the text"
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

    pages: Annotated[
        str | None, typer.Option(metavar="LIST", help="Pages to read, e.g. 1,3-5; all if none.")
    ] = None
    password: Annotated[str | None, typer.Option(help="Password of an encrypted PDF.")] = None
    languages: Annotated[
        str | None, typer.Option("--language", metavar="TAG", help="Language of the text: en, fr.")
    ] = None
    keep_headers: Annotated[
        bool | None, typer.Option("--keep-headers", help="Keep running heads and page numbers.")
    ] = None

    def recognition(self, source: str, **more: Any) -> "tuple[str, RecognitionOptions]":
        """Return the document, and its options: these, and those that follow its name."""
        from smarttouch.errors import PageError
        from smarttouch.reading.printed import RecognitionOptions
        from smarttouch.url_options import joined_options, read_options

        place, in_name = source, dict[str, Any]()
        if Path(source.rpartition("?")[0]).is_file():
            place, in_name = read_options(
                RecognitionOptions, source, PageError, but=("password", *more)
            )
        own = {each.name: getattr(self, each.name) for each in fields(DocumentOptions)}
        if self.languages is not None:
            own["languages"] = "+".join(
                _TESSERACT.get(each.partition("-")[0], each) for each in self.languages.split("+")
            )
        given = {name: value for name, value in own.items() if value is not None}
        given = joined_options(source, given, in_name, PageError)
        return place, RecognitionOptions(**given, **more)


TableOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        rich_help_panel=_FORM,
        help="Braille table (list: smarttouch braille --tables); that of --language, or en-1.",
    ),
]


def table_of(table: str | None, language: str | None) -> str:
    """Return the name of the Braille table: that given, or that of the first language."""
    first = (language or "en").partition("+")[0]
    return table or _TAGS.get(first, first)


@dataclass(frozen=True, kw_only=True)
class FormOptions(OptionGroup):
    """Options of letter shapes and Braille."""

    kind: Annotated[
        str | None,
        typer.Option("--as", metavar="FORM", rich_help_panel=_FORM, help="shapes or braille."),
    ] = None
    style: Annotated[
        str,
        typer.Option(
            metavar="STYLE", rich_help_panel=_FORM, help="Shapes: plain, thinned or graded."
        ),
    ] = "graded"
    table: TableOption = None
    cells: Annotated[
        str,
        typer.Option(metavar="HOW", rich_help_panel=_FORM, help="Braille: a line or each cell."),
    ] = "line"
    embossed: Annotated[
        bool | None,
        typer.Option(
            "--embossed/--printed",
            rich_help_panel=_FORM,
            help="Photo of Braille: raised or printed.",
        ),
    ] = None
    light_from: Annotated[
        float | None,
        typer.Option(metavar="DEG", rich_help_panel=_FORM, help="Direction of light on the dots."),
    ] = None
    speed_mm_s: Annotated[
        float | None,
        typer.Option("--speed", metavar="MM/S", rich_help_panel=_FORM, help="Speed of the text."),
    ] = None

    def presentation(
        self, usual: str, lines: int = 1, language: str | None = None
    ) -> "Shapes | Braille":
        """Return letter shapes or Braille; without a table, that of the language."""
        from smarttouch.cli.choices import parse_choice
        from smarttouch.reading.braille import Braille, Presentation
        from smarttouch.reading.shapes import Shapes, Style

        shapes = Shapes(parse_choice("style", self.style, Style))
        presentation = parse_choice("cells", self.cells, Presentation)
        if parse_choice("kind", self.kind or usual, ("shapes", "braille")) == "shapes":
            return shapes
        table = table_of(self.table, language)
        return Braille(table, presentation, lines, self.embossed, self.light_from)
