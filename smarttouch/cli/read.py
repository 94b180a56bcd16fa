"""``smarttouch read``, ``braille`` and ``braille-display``: read text with a fingertip."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smarttouch.base.errors import BrailleError, PageError, ReadingError, choice_of
from smarttouch.base.files import named_file, write_bytes
from smarttouch.cli.options import (
    ModeOption,
    OptionGroup,
    RunOptions,
    argument,
    option,
    or_standard_input,
    output_file,
    read_form,
    takes_options,
)
from smarttouch.views.keys_and_signals import drives_a_board

if TYPE_CHECKING:
    from smarttouch.reading.braille_lines import Braille
    from smarttouch.reading.letter_shapes import Shapes
    from smarttouch.reading.recognition import RecognitionOptions
    from smarttouch.running.config import RunConfig

_TESSERACT = {
    "ar": "ara", "cs": "ces", "da": "dan", "de": "deu", "el": "ell", "en": "eng", "es": "spa",
    "fi": "fin", "fr": "fra", "he": "heb", "hi": "hin", "hu": "hun", "it": "ita", "ja": "jpn",
    "ko": "kor", "nl": "nld", "pl": "pol", "pt": "por", "ru": "rus", "sv": "swe", "tr": "tur",
    "uk": "ukr",
}  # fmt: skip
"""Tesseract's names of languages, by language tag."""
_TAGS = {code: tag for tag, code in _TESSERACT.items()}


@dataclass(frozen=True, kw_only=True)
class DocumentOptions(OptionGroup):
    """Options for opening and recognizing a document."""

    password_file: Annotated[
        str | None,
        option(
            "Read the password of a PDF from this file; - means standard input (default: ask in "
            "the terminal).",
            "FILE|-",
        ),
    ] = None
    languages: Annotated[
        str | None,
        option("Language of the text, such as en or fr.", "TAG", "--language"),
    ] = None

    def recognition(self, source: str) -> "tuple[str, RecognitionOptions]":
        """Return the address of a document, and the options of its recognition."""
        from smarttouch.base.urls import all_options
        from smarttouch.pages.text_documents import FileKind, file_kind
        from smarttouch.reading.recognition import RecognitionOptions
        from smarttouch.sources.virtual_finger import password_of

        source = address = source.removeprefix("page:")
        accepted = dict[str, Any]()
        if self.languages is not None:
            accepted["languages"] = "+".join(
                _TESSERACT.get(language.partition("-")[0], language)
                for language in self.languages.split("+")
            )
        if Path(source.rpartition("?")[0]).is_file():
            address, accepted = all_options(
                RecognitionOptions, source, source, accepted, PageError, ("password",)
            )
        if not address.startswith("text:") and named_file(address, BrailleError) is None:
            address = f"text:{address}"
        if not address.startswith("text:") and file_kind(Path(address)) is FileKind.PAGES:
            accepted["password"] = password_of(Path(address), self.password_file)
        return address, RecognitionOptions(**accepted)


TableOption = Annotated[
    str | None,
    option(
        "Choose the Braille table; --tables lists them (default: by language).",
        "NAME",
    ),
]


def table_of(table: str | None, language: str | None) -> str:
    """Return the Braille table: ``table`` or, by default, the table of the first language."""
    first = (language or "en").partition("+")[0]
    return table or _TAGS.get(first, first)


@dataclass(frozen=True)
class _Form:
    """Options of ``--as FORM?OPTIONS``."""

    table: str | None = None
    speed_mm_s: float | None = None


@dataclass(frozen=True, kw_only=True)
class FormOptions(OptionGroup):
    """Options for letter shapes and Braille."""

    kind: Annotated[
        str | None,
        option(
            "Read shapes or braille. Options follow a ?, as in 'shapes?speed_mm_s=20', "
            "'braille?table=en-2&speed_mm_s=40'.",
            "FORM",
            "--as",
        ),
    ] = None

    def presentation(
        self, usual: str, language: str | None = None
    ) -> "tuple[Shapes | Braille, float | None]":
        """Return letter shapes or Braille, and the requested speed, mm/s.

        By default, the language determines the Braille table.
        """
        from smarttouch.reading.braille_lines import Braille
        from smarttouch.reading.letter_shapes import Shapes

        text, accepted = read_form(_Form, self.kind or usual, ReadingError)
        form = _Form(**accepted)
        if choice_of("kind", text, ("shapes", "braille")) == "shapes":
            return Shapes(), form.speed_mm_s
        return Braille(table_of(form.table, language)), form.speed_mm_s


@drives_a_board
@takes_options
def read(
    feel: FormOptions,
    document: DocumentOptions,
    run: RunOptions,
    source: Annotated[
        str,
        argument(
            "A page (image, PDF), a text, Braille (.brf), words, or - for "
            "standard input. Options follow a ?, as in 'book.pdf?pages=3-5&dpi=300'.",
            "FILE",
            callback=or_standard_input,
        ),
    ],
    pause_s: Annotated[
        float, option("Pause this long after each line; inf waits for a key.", "S", "--pause")
    ] = 1.0,
    mode: ModeOption = "RA",
) -> None:
    """Read a page with a fingertip, line by line.

    Arrow keys choose a line, and r repeats the line. The keys of smarttouch live also work.
    """
    from smarttouch.imaging.reading_profile import profile_for_reading
    from smarttouch.reading.line_source import ReadingSource
    from smarttouch.reading.reading_material import ReadingMaterial
    from smarttouch.views.progress import first_line_awaited

    run_profile = run.load_profile()
    chosen = profile_for_reading(run_profile)
    presentation, speed_mm_s = feel.presentation(run_profile.defaults.read_as, document.languages)
    motion = presentation.motion(chosen, speed_mm_s, run.settings().get("rate_hz"))
    notes: list[str] = []
    text = ReadingMaterial(*document.recognition(source), notes.append)
    config = run.config(mode, tone=presentation.tone)
    lines = presentation.lines(text, chosen)
    with ReadingSource(text.title, chosen, lines, motion, pause_s) as reading:
        reading.url, reading.notes = source, notes
        first_line_awaited(lambda: reading.line(0, wait=True))
        run.start(
            reading, chosen, _at_level(config, presentation, run.on_a_finger), keys=reading.keys,
            keys_help=reading.keys_help,
        )  # fmt: skip


def _at_level(config: "RunConfig", shown: object, on_a_finger: bool) -> "RunConfig":
    """Return the configuration with a default intensity that suits most simulated fingers."""
    from smarttouch.base.afferent import Mode
    from smarttouch.reading.letter_shapes import UNKNOWN_LEVEL, Shapes

    is_chosen = config.intensity is not None or on_a_finger or config.mode is not Mode.RA
    if is_chosen or not isinstance(shown, Shapes):
        return config
    return config.model_copy(update={"intensity": UNKNOWN_LEVEL})


@takes_options
def braille(
    document: DocumentOptions,
    source: Annotated[
        str | None,
        argument(
            "A file, words, or - for standard input. Files hold text (HTML, EPUB, DOCX …), Braille "
            "(.brf) or print (image, PDF). If a file has the words as its name, write text:WORDS.",
            "TEXT|FILE|-",
            callback=or_standard_input,
        ),
    ] = None,
    table: TableOption = None,
    back: Annotated[bool, option("Translate cells back into text.", None, "--back")] = False,
    output: Annotated[
        Path | None, output_file("Write a .brf file instead of printing cells.", "FILE")
    ] = None,
    columns: Annotated[
        int | None, option("Set the number of cells in a line (default: 40).", "N")
    ] = None,
    rows: Annotated[
        int | None, option("Set the number of lines on a page (default: 25).", "N")
    ] = None,
    tables: Annotated[bool, option("List the Braille tables.", None, "--tables")] = False,
) -> None:
    """Translate text into Braille, or Braille into text."""
    from functools import partial

    from smarttouch.braille.brf import format_brf
    from smarttouch.braille.code_tables import open_table
    from smarttouch.reading.braille_lines import document_cells
    from smarttouch.reading.reading_material import ReadingMaterial

    if tables:
        _print_tables()
        return
    if source is None:
        raise BrailleError("there is nothing to read: give a text or a file, or --tables")
    if output is not None and (back or output.suffix.lower() != ".brf" or output.exists()):
        raise BrailleError(
            f"cannot write {output}: cells are written only to a new .brf file. For text or "
            "another file, leave out --output and redirect the output"
        )
    say = partial(typer.echo, err=True)
    code = open_table(table_of(table, document.languages))
    material = ReadingMaterial(*document.recognition(source), say)
    if code.note and not material.holds_cells:
        say(code.note)
    cells = document_cells(material, code, say)
    if back:
        content = "\n".join(cells.paragraphs)
        text = code.to_text(content)
        if doubt := code.doubt(content, text):
            say(doubt)
        print(text)
    elif output is None:
        _print_cells([line for page in cells.laid_out(columns, rows, 0) for line in page])
    else:
        pages = cells.laid_out(columns, rows)
        write_bytes(output, format_brf(pages), BrailleError)
        print(f"{output}: pages {len(pages)}, lines {sum(map(len, pages))}")


def _print_cells(lines: list[str]) -> None:
    """Print cells. Use ASCII Braille if the output's encoding has no Braille characters."""
    import sys

    from smarttouch.braille.brf import ascii_braille

    try:
        "".join(lines).encode(sys.stdout.encoding or "utf-8")
    except UnicodeEncodeError:
        lines = [ascii_braille(line) for line in lines]
    print("\n".join(lines))


def _print_tables() -> None:
    from smarttouch.braille import louis
    from smarttouch.braille.code_tables import DEFAULT_TABLE, known_tables
    from smarttouch.views.printable_output import print_table

    version = louis.version()
    print_table(
        [
            (name + " (default)" * (name == DEFAULT_TABLE), name.partition("-")[0], title)
            for name, title in known_tables().items()
        ],
        ("name", "language", "description"),
        left=3,
    )
    if version:
        print(f"Or give a table file of liblouis {version}, or a language tag such as pt.")
    else:
        print(f"liblouis is not installed, so only en-1 works. For all tables: {louis.INSTALL}")


@drives_a_board
@takes_options
def braille_display(
    run: RunOptions,
    address: Annotated[
        str,
        argument(
            "PORT or HOST:PORT of this machine, where BRLTTY connects. Options follow a ?, as in "
            "'35752?cells=10&speed_mm_s=60'.",
            "[ADDRESS]",
        ),
    ] = "35752",
    mode: ModeOption = "RA",
) -> None:
    """Act as the Braille display of a screen reader, through BRLTTY.

    Run two commands in two terminals:

        smarttouch braille-display

        sudo brltty -b vr -d client:

    The finger then reads the console and, through BrlAPI, the text that Orca sends on a desktop.
    """
    from smarttouch.imaging.reading_profile import profile_for_reading
    from smarttouch.sources import open_source

    chosen = profile_for_reading(run.load_profile())
    config = run.config(mode, scan="points")
    with open_source(f"brltty:{address}", chosen) as source:
        run.start(source, chosen, config, keys=source.keys, keys_help=source.keys_help)
