"""Printed pages of a document, one after another, and their recognized text."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from smarttouch.documents.document import open_document, parse_pages
from smarttouch.documents.page_image import Page
from smarttouch.documents.prepare import LEFT_OUT, PreparedPage, prepare_page
from smarttouch.documents.straighten import QUARTER
from smarttouch.errors import ReadingError
from smarttouch.reading.ocr import recognize_lines, upright
from smarttouch.reading.paragraphs import paragraphs

LINE_PIXELS = 56
"""Height of lines for recognition: ascender to descender."""
SURE = 0.6
"""Mean confidence below which a page is reported as poorly recognized."""
_CHUNK = 16

Note = Callable[[str], None]


@dataclass(frozen=True)
class RecognitionOptions:
    """Pages of a document, such as ``1,3-5``, their scale and polarity, and recognition of text."""

    pages: str | None = None
    dpi: float | None = None
    page_width_mm: float | None = None
    password: str | None = None
    light_on_dark: bool | None = None
    languages: str = "eng"
    keep_headers: bool = False  # running heads and page numbers stay in a text
    scale_matters: bool = False  # millimeters on the page count


def document_pages(
    path: Path, options: RecognitionOptions, note: Note
) -> Iterator[tuple[int, Page]]:
    """Yield numbers and pages of a document, one in memory at a time.

    An assumed scale is reported only where it matters: every line is made as high as the array.
    """
    with open_document(
        path, dpi=options.dpi, page_width_mm=options.page_width_mm, password=options.password
    ) as document:
        wanted = (
            parse_pages(options.pages, len(document)) if options.pages else range(len(document))
        )
        for index in wanted:
            before = len(document.notes)
            page = document.page(index)
            if options.scale_matters:
                for words in document.notes[before:]:
                    note(words)
            yield index + 1, page


def upright_page(number: int, page: Page, options: RecognitionOptions, note: Note) -> PreparedPage:
    """Return a page straight and upright, ink on white paper, its lines in reading order."""
    prepared = prepare_page(page, options.light_on_dark)
    notes = list(prepared.notes)
    turn_deg = _turn_deg(prepared, options)
    if turn_deg:
        turned = np.ascontiguousarray(np.rot90(prepared.page.grey, -turn_deg // 90))
        turned_page = replace(prepared.page, grey=turned)
        prepared = prepare_page(turned_page, options.light_on_dark, quarter=False)
        if QUARTER in notes:
            # That turn was a guess, counterclockwise.
            turn_deg = (turn_deg - 90) % 360
        notes = [words for words in notes if words != QUARTER and not words.startswith(LEFT_OUT)]
        if turn_deg:
            notes.append(f"it was turned by {turn_deg}° to be upright")
        notes += prepared.notes
    for words in notes:
        note(f"page {number}: {words}")
    return prepared


class EmptyPages:
    """List of pages without anything readable, reported by a note at the end."""

    def __init__(self, note: Note) -> None:
        self._note = note
        self._found = False
        self._empty: list[int] = []

    def add(self, number: int, found: bool) -> None:
        """Add the result of a page."""
        self._found |= found
        if not found:
            self._empty.append(number)

    def conclude(self) -> None:
        """Report the empty pages; raise if all are."""
        if not self._found:
            raise ReadingError(
                "no line of text was found: is it a page of print, sharp, and large enough "
                "(letters of 6 pixels and more)?",
                about="page",
            )
        if self._empty:
            self._note(f"no line of text on page {', '.join(map(str, self._empty))}")


def prepared_pages(
    pages: Iterator[tuple[int, Page]], options: RecognitionOptions, note: Note
) -> Iterator[PreparedPage]:
    """Yield the pages that carry text, see `upright_page`; raise if none does."""
    empty = EmptyPages(note)
    for number, page in pages:
        prepared = upright_page(number, page, options, note)
        empty.add(number, bool(prepared.lines))
        if prepared.lines:
            yield prepared
    empty.conclude()


def recognized_lines(
    prepared: PreparedPage, options: RecognitionOptions, note: Note
) -> Iterator[tuple[int, str]]:
    """Yield numbers and texts of the lines of a page; the first of them early."""
    count, start, size = len(prepared.lines), 0, 1
    confidences: list[tuple[int, float]] = []
    while start < count:
        # Long pieces are faster in all, but reading starts after the first one.
        indices = range(start, min(count, start + size))
        strips = [prepared.strip(index, LINE_PIXELS) for index in indices]
        for index, line in zip(indices, recognize_lines(strips, options.languages), strict=True):
            confidences.append((len(line.text), line.confidence))
            yield index, line.text
        start, size = indices.stop, min(_CHUNK, 4 * size)
    characters = sum(length for length, _ in confidences)
    sure = sum(length * each for length, each in confidences) / max(1, characters)
    if sure < SURE:
        note(
            f"the text was recognized with a confidence of {sure:.0%} only: it may be handwriting, "
            f"a picture, or in another language than {options.languages}"
        )


def recognized_text(prepared: PreparedPage, options: RecognitionOptions, note: Note) -> str:
    """Return the text of a page, a line for each paragraph, see `paragraphs`."""
    texts = [text for _, text in recognized_lines(prepared, options, note)]
    return "\n".join(paragraphs(prepared.lines, texts, options.keep_headers))


def _turn_deg(prepared: PreparedPage, options: RecognitionOptions) -> int:
    """Return the clockwise rotation of a page in degrees, if Tesseract is installed."""
    try:
        return upright(prepared.cleaned, options.languages) if prepared.lines else 0
    except ReadingError:
        return 0
