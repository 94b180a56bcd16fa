"""Documents as Braille cells, page by page on all cores; one that was interrupted goes on."""

import hashlib
import json
import shutil
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from smarttouch.base.errors import BrailleError, ReadingError
from smarttouch.base.files import make_folder, unwritable, write_bytes
from smarttouch.base.version import __version__
from smarttouch.braille.brf import read_brf
from smarttouch.braille.cells import BLANK, Pages
from smarttouch.braille.code_tables import BrailleTable
from smarttouch.braille.page_layout import COLUMNS, INDENT, ROWS, join, lay_out
from smarttouch.reading.material import ReadingMaterial, report_empty_pages
from smarttouch.reading.paragraphs import PrintedLine, paragraphs, printed_lines, without_heads
from smarttouch.reading.recognition import Note, recognized_lines, upright_page

_SLOW_S = 0.5  # time of the first page from which the others are worth processes of their own
_PARTS = ".pages"  # ending of the folder of finished pages, beside the output


@dataclass(frozen=True)
class DocumentCells:
    """A document as paragraphs of cells, and the pages that a BRF file has them on."""

    paragraphs: list[str]
    pages: Pages | None = None

    def laid_out(self, columns: int | None, rows: int | None, indent: int = INDENT) -> Pages:
        """Return pages of so many cells and lines, by default those of its file, or 40 and 25."""
        if self.pages is not None and columns is None and rows is None:
            return self.pages
        columns, rows = COLUMNS if columns is None else columns, ROWS if rows is None else rows
        return lay_out(self.paragraphs, columns, rows, indent)


@dataclass(frozen=True)
class RecognizedPage:
    """Lines of a page with their texts, and what was said."""

    number: int
    lines: list[PrintedLine]
    notes: list[str]


def document_cells(
    source: ReadingMaterial, table: BrailleTable, progress: Note, output: Path | None = None
) -> DocumentCells:
    """Return a text, a file of cells or a document as cells.

    What is left out is named by the source's ``note``. ``progress`` is called as pages of a
    document are done. With an ``output``, they are kept in a folder beside it until
    `forget_pages`, and are used again by another run with the same document and options.
    """
    text = source.words
    if source.holds_cells:
        pages = read_brf(Path(source.name), source.note)
        cells = DocumentCells(join(pages), pages)
    else:
        if text is None:
            text = "\n".join(_paragraphs_of_pages(source, progress, output))
        cells = DocumentCells(table.paragraphs(text, source.note))
    if not any(paragraph.strip(BLANK) for paragraph in cells.paragraphs):
        raise BrailleError("there is nothing to read: give a text, or a file with one")
    return cells


def _paragraphs_of_pages(source: ReadingMaterial, progress: Note, output: Path | None) -> list[str]:
    numbers = source.numbers()
    files: dict[int, Path] = {}
    if output is not None and len(numbers) > 1:
        files = _files(source, numbers, output.with_name(output.name + _PARTS))
    done = {number: kept for number, path in files.items() if (kept := _kept(path))}
    if done:
        progress(f"{len(done)} of {len(numbers)} pages were done before")
        for page in done.values():
            for words in page.notes:
                source.note(words)
    missing = [number for number in dict.fromkeys(numbers) if number not in done]
    for page in _recognized(source, missing):
        if page.number in files:
            _keep(page, files[page.number])
        done[page.number] = page
        for words in page.notes:
            source.note(words)
        if len(numbers) > 1:
            progress(f"page {page.number} done, {len(done)} of {len(numbers)}")
    report_empty_pages({number: bool(done[number].lines) for number in numbers}, source.note)
    lines = [line for number in numbers for line in done[number].lines]
    return paragraphs(lines if source.options.keep_headers else without_heads(lines, source.note))


def forget_pages(output: Path) -> None:
    """Remove the pages that were kept for an output."""
    shutil.rmtree(output.with_name(output.name + _PARTS), ignore_errors=True)


def _recognized(source: ReadingMaterial, numbers: Sequence[int]) -> Iterator[RecognizedPage]:
    """Yield pages as they are done: by this process where they take little time."""
    start = time.monotonic()
    for done, number in enumerate(numbers):
        if done and (time.monotonic() - start) / done > _SLOW_S:
            yield from _by_processes(source, numbers[done:])
            return
        yield _page(source, number)


def _by_processes(source: ReadingMaterial, numbers: Sequence[int]) -> Iterator[RecognizedPage]:
    from joblib import Parallel, delayed, parallel_config

    # What its notes are said to stays here.
    plain = ReadingMaterial(source.name, source.options)
    # Workers of a program that was killed end soon.
    with parallel_config("loky", idle_worker_timeout=10):
        many = Parallel(n_jobs=-1, return_as="generator_unordered", max_nbytes=None)
    made = many(delayed(_page)(plain, number, alone=True) for number in numbers)
    try:
        yield from made
    finally:
        with warnings.catch_warnings():
            # Pages that were under way are thrown away.
            warnings.simplefilter("ignore", UserWarning)
            made.close()


def _page(source: ReadingMaterial, number: int, alone: bool = False) -> RecognizedPage:
    """Return the lines of a page; ``alone`` if each core has a process of its own."""
    if alone:
        import cv2

        cv2.setNumThreads(1)
    notes: list[str] = []
    options = replace(source.options, pages=str(number))
    material = ReadingMaterial(source.name, options, notes.append)
    ((_, page),) = material.pages()
    prepared = upright_page(number, page, options, notes.append)
    texts = [text for _, text in recognized_lines(prepared, options, notes.append)]
    return RecognizedPage(number, printed_lines(number, prepared.lines, texts), notes)


def _files(source: ReadingMaterial, numbers: Sequence[int], folder: Path) -> dict[int, Path]:
    """Return the files of pages, named by all that their lines depend on."""
    try:
        make_folder(folder)
    except OSError as error:
        raise unwritable(ReadingError, folder, error) from None
    state = Path(source.name).stat()
    options = asdict(replace(source.options, pages=None, password=None, keep_headers=False))
    depends_on = [__version__, source.name, state.st_size, state.st_mtime_ns, options]
    key = hashlib.sha256(json.dumps(depends_on, sort_keys=True).encode()).hexdigest()[:24]
    return {number: folder / f"{key}-{number}.json" for number in numbers}


def _keep(page: RecognizedPage, path: Path) -> None:
    # A run that is killed leaves no half a page.
    write_bytes(path, json.dumps(asdict(page)).encode(), ReadingError)


def _kept(path: Path) -> RecognizedPage | None:
    try:
        number, lines, notes = json.loads(path.read_bytes()).values()
        return RecognizedPage(number, [PrintedLine(**line) for line in lines], notes)
    except (OSError, ValueError, TypeError, AttributeError):
        return None
