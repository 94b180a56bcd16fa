"""``smarttouch braille``: texts into cells of Braille and back, on the screen and in files."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from smarttouch.cli.option_groups import takes_options
from smarttouch.cli.source_options import DocumentOptions, TableOption, table_of
from smarttouch.cli.standard_input import or_standard_input

if TYPE_CHECKING:
    from smarttouch.braille.source import Loaded


@takes_options()
def braille(
    document: DocumentOptions,
    source: Annotated[
        str | None,
        typer.Argument(
            callback=or_standard_input,
            metavar="TEXT|FILE|-",
            help="A file of text, of cells (.brf, .pef), of print or Braille (image, PDF); a text, "
            "or text:WORDS where it could be a file; - for standard input.",
        ),
    ] = None,
    table: TableOption = None,
    back: Annotated[bool, typer.Option("--back", help="From cells to text.")] = False,
    output: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="A .brf, .pef or .txt; the screen if none."),
    ] = None,
    columns: Annotated[int | None, typer.Option(help="Cells a line; 40 if none is given.")] = None,
    rows: Annotated[int | None, typer.Option(help="Lines a page; 25 if none is given.")] = None,
    leave_out: Annotated[
        bool, typer.Option("--leave-out", help="Leave out what the table has no cells for.")
    ] = False,
    tables: Annotated[bool, typer.Option("--tables", help="List the tables.")] = False,
) -> None:
    """Turn a text into Braille, or Braille into a text."""
    from smarttouch.braille.layout import COLUMNS, INDENT, ROWS, lay_out
    from smarttouch.braille.source import load_cells, write_cells
    from smarttouch.braille.tables import open_table
    from smarttouch.errors import BrailleError
    from smarttouch.files import require_folder, write_bytes

    if tables:
        _print_tables()
        return
    if source is None:
        message = "nothing to read is given: give a text or a file, or list the tables"
        raise BrailleError(message, about="text", remedy="tables")
    require_folder(output)
    named = table_of(table, document.languages)
    code = open_table(named)
    loaded = _seen(source, named, document)
    loaded = loaded or load_cells(source, code, leave_out)
    for note in loaded.notes:
        typer.echo(note, err=True)
    if back:
        text = code.to_text("\n".join(loaded.paragraphs)) + "\n"
        if output is None:
            print(text, end="")
            return
        if output.suffix.lower() != ".txt":
            message = f"cannot write a text as {output}: give a name that ends in .txt"
            raise BrailleError(message, about="file")
        write_bytes(output, text.encode(), BrailleError)
        print(output)
        return
    pages = loaded.pages
    if pages is None or columns is not None or rows is not None:
        # What is shown is not printed: there, paragraphs need no indent.
        indent = 0 if output is None else INDENT
        wide = COLUMNS if columns is None else columns
        pages = lay_out(loaded.paragraphs, wide, ROWS if rows is None else rows, indent)
    if output is None:
        print("\n".join(line for page in pages for line in page))
        return
    write_cells(output, pages)
    print(f"{output}: pages {len(pages)}, lines {sum(map(len, pages))}")


def _seen(source: str, table: str, document: DocumentOptions) -> "Loaded | None":
    """Return the cells of an image or a PDF; None for anything else."""
    from smarttouch.braille.files import Kind, kind_of
    from smarttouch.braille.source import Loaded, file_of
    from smarttouch.reading.braille import Braille
    from smarttouch.reading.source import Source

    place, options = document.recognition(source)
    file = file_of(place)
    if file is None or kind_of(file) is not Kind.PAGES:
        return None
    notes: list[str] = []
    shown = Source(place, options, notes.append)
    return Loaded(Braille(table).paragraphs(shown), None, notes)


def _print_tables() -> None:
    from smarttouch.braille import louis
    from smarttouch.braille.tables import DEFAULT_TABLE, known_tables
    from smarttouch.terminal import print_table

    version = louis.version()
    known = known_tables()
    print_table(
        [
            *(
                (name + " (default)" * (name == DEFAULT_TABLE), name.partition("-")[0], title)
                for name, title in known.items()
            ),
            *louis.table_files(),
        ],
        ("name", "language", "what it is"),
        note=f"Or any other file of liblouis {version}, or the tag of a language."
        if version
        else f"liblouis is not here: of these only en-1 and ja work. For all: {louis.INSTALL}",
        left=3,
    )
