"""Options of sources and of documents, each said once."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smarttouch.cli.option_groups import OptionGroup

if TYPE_CHECKING:
    from smarttouch.reading.braille import Braille
    from smarttouch.reading.printed import RecognitionOptions
    from smarttouch.reading.shapes import Shapes

_FEEL = "How it is felt"
_TESSERACT = {
    "ar": "ara", "cs": "ces", "da": "dan", "de": "deu", "el": "ell", "en": "eng", "es": "spa",
    "fi": "fin", "fr": "fra", "he": "heb", "hi": "hin", "hu": "hun", "it": "ita", "ja": "jpn",
    "ko": "kor", "nl": "nld", "pl": "pol", "pt": "por", "ru": "rus", "sv": "swe", "tr": "tur",
    "uk": "ukr",
}  # fmt: skip
"""Languages as Tesseract names them, by their tags."""
_TAGS = {code: tag for tag, code in _TESSERACT.items()}


@dataclass(frozen=True, kw_only=True)
class SourceOptions(OptionGroup):
    """Options of a source that can stand in its URL too; not in the help, which names that."""

    dpi: Annotated[float | None, typer.Option(hidden=True)] = None
    page_width_mm: Annotated[float | None, typer.Option(hidden=True)] = None
    speed_mm_s: Annotated[float | None, typer.Option("--speed", hidden=True)] = None
    path: Annotated[Path | None, typer.Option(hidden=True)] = None
    size: Annotated[str | None, typer.Option(hidden=True)] = None
    exposure: Annotated[float | None, typer.Option(hidden=True)] = None
    fps: Annotated[float | None, typer.Option(hidden=True)] = None
    unpaced: Annotated[bool, typer.Option("--unpaced", hidden=True)] = False
    baud: Annotated[int | None, typer.Option(hidden=True)] = None

    def given(self) -> dict[str, Any]:
        """Return those that were given, as `open_source` takes them."""
        from smarttouch.errors import SmartTouchError
        from smarttouch.url_options import parse_size

        found = {each.name: getattr(self, each.name) for each in fields(self)}
        found["unpaced"] = self.unpaced or None
        if self.size is not None:
            found["size"] = parse_size(self.size, SmartTouchError, "size")
        return {name: value for name, value in found.items() if value is not None}


@dataclass(frozen=True, kw_only=True)
class DocumentOptions(OptionGroup):
    """Options of a document; all but its pages stand behind its name in the help."""

    pages: Annotated[
        str | None,
        typer.Option(metavar="LIST", help="Of the file, as in 1,3-5; all if none."),
    ] = None
    dpi: Annotated[float | None, typer.Option(hidden=True)] = None
    page_width_mm: Annotated[float | None, typer.Option(hidden=True)] = None
    password: Annotated[str | None, typer.Option(help="Of an encrypted PDF.")] = None
    languages: Annotated[str | None, typer.Option("--language", hidden=True)] = None
    keep_headers: Annotated[
        bool | None,
        typer.Option("--keep-headers", help="Keep running heads and page numbers."),
    ] = None
    light_on_dark: Annotated[
        bool | None, typer.Option("--light-on-dark/--dark-on-light", hidden=True)
    ] = None

    def look(self, source: str, **more: Any) -> "tuple[str, RecognitionOptions]":
        """Return what to read, and how to look at it; options may stand behind a file's name."""
        from smarttouch.errors import PageError
        from smarttouch.reading.printed import RecognitionOptions
        from smarttouch.url_options import joined_options, read_options

        place, told = source, dict[str, Any]()
        if Path(source.rpartition("?")[0]).is_file():
            place, told = read_options(
                RecognitionOptions, source, PageError, but=("password", *more)
            )
        own = {each.name: getattr(self, each.name) for each in fields(DocumentOptions)}
        if self.languages is not None:
            own["languages"] = "+".join(
                _TESSERACT.get(each.partition("-")[0], each) for each in self.languages.split("+")
            )
        given = {name: value for name, value in own.items() if value is not None}
        given = joined_options(source, given, told, PageError)
        return place, RecognitionOptions(**given, **more)


TableOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        rich_help_panel=_FEEL,
        help="Code, of smarttouch braille --tables; if none, that of --language, or en-1.",
    ),
]


def table_of(table: str | None, language: str | None) -> str:
    """Return the name of the Braille table: that given, or that of the first language."""
    first = (language or "en").partition("+")[0]
    return table or _TAGS.get(first, first)


@dataclass(frozen=True, kw_only=True)
class FeelOptions(OptionGroup):
    """Options of the letters or cells that are felt."""

    kind: Annotated[
        str | None,
        typer.Option("--as", metavar="WHAT", rich_help_panel=_FEEL, help="shapes or braille."),
    ] = None
    style: Annotated[
        str,
        typer.Option(metavar="HOW", rich_help_panel=_FEEL, help="plain, thinned or graded."),
    ] = "graded"
    table: TableOption = None
    cells: Annotated[
        str,
        typer.Option(
            metavar="HOW",
            rich_help_panel=_FEEL,
            help="Braille: line or cell.",
        ),
    ] = "line"
    embossed: Annotated[
        bool | None,
        typer.Option(
            "--embossed/--printed",
            rich_help_panel=_FEEL,
            help="Raised dots or not; found out if none.",
        ),
    ] = None
    light_from: Annotated[
        float | None,
        typer.Option(metavar="DEG", rich_help_panel=_FEEL, help="Of the light on raised dots."),
    ] = None
    speed_mm_s: Annotated[
        float | None,
        typer.Option(
            "--speed",
            metavar="MM/S",
            rich_help_panel=_FEEL,
            help="Of the text; by its pitch if none.",
        ),
    ] = None

    def presentation(
        self, usual: str, lines: int = 1, language: str | None = None
    ) -> "Shapes | Braille":
        """Return letter shapes or Braille; where no table is given, by that of the language."""
        from smarttouch.cli.choices import parse_choice
        from smarttouch.reading.braille import Braille, Presentation
        from smarttouch.reading.shapes import Shapes, Style

        shapes = Shapes(parse_choice("style", self.style, Style))
        presentation = parse_choice("cells", self.cells, Presentation)
        if parse_choice("kind", self.kind or usual, ("shapes", "braille")) == "shapes":
            return shapes
        table = table_of(self.table, language)
        return Braille(table, presentation, lines, self.embossed, self.light_from)
