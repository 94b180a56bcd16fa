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

_PAGE = "The page"
_FEEL = "How it is felt"


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
            found["size"] = parse_size(self.size, SmartTouchError, "--size")
        return {name: value for name, value in found.items() if value is not None}


@dataclass(frozen=True, kw_only=True)
class DocumentOptions(OptionGroup):
    """Options of a document that is read."""

    pages: Annotated[
        str | None,
        typer.Option(metavar="LIST", rich_help_panel=_PAGE, help="As in 1,3-5; all if none."),
    ] = None
    dpi: Annotated[
        float | None, typer.Option(rich_help_panel=_PAGE, help="Resolution of an image.")
    ] = None
    page_width_mm: Annotated[
        float | None, typer.Option(rich_help_panel=_PAGE, help="Or the width of its page.")
    ] = None
    password: Annotated[
        str | None, typer.Option(rich_help_panel=_PAGE, help="Of an encrypted PDF.")
    ] = None
    language: Annotated[
        str,
        typer.Option(
            metavar="NAMES", rich_help_panel=_PAGE, help="Of print, for Tesseract, as in eng+deu."
        ),
    ] = "eng"
    light_on_dark: Annotated[
        bool | None,
        typer.Option(
            "--light-on-dark/--dark-on-light",
            rich_help_panel=_PAGE,
            help="How the print is; found out if none.",
        ),
    ] = None

    def look(self, *, scale_matters: bool = False) -> "RecognitionOptions":
        """Return how to look at the document."""
        from smarttouch.reading.printed import RecognitionOptions

        return RecognitionOptions(
            self.pages,
            self.dpi,
            self.page_width_mm,
            self.password,
            self.light_on_dark,
            self.language,
            scale_matters,
        )


TableOption = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        rich_help_panel=_FEEL,
        help="Braille code; smarttouch braille --tables.",
    ),
]


@dataclass(frozen=True, kw_only=True)
class FeelOptions(OptionGroup):
    """Options of the letters or cells that are felt."""

    kind: Annotated[
        str,
        typer.Option(
            "--as", metavar="shapes|braille", rich_help_panel=_FEEL, help="Which of them."
        ),
    ] = "shapes"
    style: Annotated[
        str,
        typer.Option(
            metavar="plain|thinned|graded", rich_help_panel=_FEEL, help="Of letter shapes."
        ),
    ] = "graded"
    table: TableOption = "en-1"
    cells: Annotated[
        str,
        typer.Option(
            metavar="line|cell",
            rich_help_panel=_FEEL,
            help="A moving line of Braille, or one cell at a time.",
        ),
    ] = "line"
    embossed: Annotated[
        bool | None,
        typer.Option(
            "--embossed/--printed",
            rich_help_panel=_FEEL,
            help="Whether an image shows raised dots; found out if none.",
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
            help="Of the text under the finger; four pulses a pitch if none.",
        ),
    ] = None

    def wanted(self, lines: int = 1) -> "Shapes | Braille":
        """Return letter shapes or Braille, with so many lines of cells at once."""
        from smarttouch.cli.files import parse_choice
        from smarttouch.reading.braille import Braille, Presentation
        from smarttouch.reading.shapes import Shapes, Style

        shapes = Shapes(parse_choice("--style", self.style, Style))
        presentation = parse_choice("--cells", self.cells, Presentation)
        if parse_choice("--as", self.kind, ("shapes", "braille")) == "shapes":
            return shapes
        return Braille(self.table, presentation, lines, self.embossed, self.light_from)
