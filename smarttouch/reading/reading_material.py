"""Material to read: images, documents, texts and files of Braille cells."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from joblib import Parallel, delayed

from smarttouch.base.errors import PageError, ReadingError
from smarttouch.pages.document import Document
from smarttouch.pages.page_and_lines import Page
from smarttouch.pages.prepared_page import PreparedPage, prepare_text
from smarttouch.pages.text_documents import FileKind, file_kind, read_document_text, read_plain_text
from smarttouch.reading.paragraphs import PrintedLine, paragraphs, printed_lines, without_heads
from smarttouch.reading.recognition import (
    Note,
    RecognitionOptions,
    recognized_lines,
    upright_page,
)

TEXT = "text:"  # prefix of a name that contains the text itself
_PRINTED_AT_ONCE = 20  # number of lines of a text on one printed page


@dataclass(frozen=True)
class ReadingMaterial:
    """Material to read: a file, or ``text:`` and words. ``note`` is called with each warning."""

    name: str
    options: RecognitionOptions = field(default_factory=RecognitionOptions)
    note: Note = lambda _words: None

    @property
    def title(self) -> str:
        """Title on the screen."""
        return "a text" if self.name.startswith(TEXT) else Path(self.name).name

    @cached_property
    def kind(self) -> FileKind:
        """Kind of the file."""
        return FileKind.TEXT if self.name.startswith(TEXT) else file_kind(Path(self.name))

    @property
    def holds_cells(self) -> bool:
        """Whether the material is a file of Braille cells."""
        return self.kind is FileKind.BRF

    @cached_property
    def words(self) -> str | None:
        """The text itself; None for images and cells."""
        if self.name.startswith(TEXT):
            return self.name[len(TEXT) :]
        if self.kind is FileKind.TEXT:
            return read_plain_text(Path(self.name))
        if self.kind is FileKind.STRUCTURED:
            return read_document_text(Path(self.name), self.note)
        return None

    def pages(self) -> Iterator[tuple[int, Page]]:
        """Yield the number and the image of each page that the options select. An assumed scale is
        not reported, because lines are scaled to the array anyway."""
        options = self.options
        with Document(
            Path(self.name),
            dpi=options.dpi,
            page_width_mm=options.page_width_mm,
            password=options.password,
        ) as document:
            count = len(document)
            for index in parse_pages(options.pages, count) if options.pages else range(count):
                yield index + 1, document.page(index)

    def prepared(self) -> Iterator[PreparedPage]:
        """Yield the pages with print, turned upright (see `upright_page`). A text is drawn on pages
        first. Raises ReadingError if no page has print."""
        if self.words is None:
            has_lines: dict[int, bool] = {}
            for number, page in self.pages():
                prepared = upright_page(number, page, self.options, self.note)
                has_lines[number] = bool(prepared.lines)
                if prepared.lines:
                    yield prepared
            _report_empty_pages(has_lines, self.note)
            return
        lines = self.words.splitlines()
        parts = [
            "\n".join(lines[start : start + _PRINTED_AT_ONCE])
            for start in range(0, len(lines), _PRINTED_AT_ONCE)
        ]
        for part in [part for part in parts if part.strip()] or [""]:
            yield prepare_text(part)

    def paragraphs(self, progress: Note) -> list[str]:
        """Return the paragraphs of a document, recognizing pages on all cores.

        ``progress`` is called for each finished page if there are several.
        """
        lines: list[PrintedLine] = []
        has_text: dict[int, bool] = {}
        # Tesseract runs as a separate process, so threads are sufficient.
        work = Parallel(
            n_jobs=-1, backend="threading", return_as="generator", pre_dispatch="n_jobs"
        )
        pages = (delayed(self._printed_lines)(number, page) for number, page in self.pages())
        for number, printed, notes in work(pages):
            for words in notes:
                self.note(words)
            has_text[number] = bool(printed)
            if len(has_text) > 1:
                progress(f"pages done: {len(has_text)}")
            lines += printed
        _report_empty_pages(has_text, self.note)
        return paragraphs(lines if self.options.keep_headers else without_heads(lines, self.note))

    def _printed_lines(self, number: int, page: Page) -> tuple[int, list[PrintedLine], list[str]]:
        """Return the number of a page, its lines, and its notes."""
        notes: list[str] = []
        prepared = upright_page(number, page, self.options, notes.append)
        texts = [text for _, text in recognized_lines(prepared, self.options, notes.append)]
        return number, printed_lines(number, prepared.lines, texts), notes


def parse_pages(text: str, count: int) -> list[int]:
    """Parse a list of pages such as ``1,3-5`` or ``7-``; return indices from 0."""
    indexes: list[int] = []
    for part in text.split(","):
        # Python refuses to convert very long numbers.
        match = re.fullmatch(r"\s*([0-9]{1,9})\s*(-\s*([0-9]{1,9})?\s*)?", part)
        first = int(match[1]) if match else 0
        last = int(match[3] or count) if match and match[2] else first
        if not 1 <= first <= last <= count:
            raise PageError(
                f"pages {text}: the document has pages 1 to {count}, not {part.strip()!r}: "
                "write 1,3-5 or 7-"
            )
        indexes += range(first - 1, last)
    return indexes


def _report_empty_pages(has_text: dict[int, bool], note: Note) -> None:
    """Report the numbers of pages without text. Raises ReadingError if no page has text."""
    if not any(has_text.values()):
        raise ReadingError(
            "no line of text was found: give a sharp page of print, with letters at least 6 pixels "
            "high"
        )
    if empty := [str(number) for number, has in has_text.items() if not has]:
        note(f"no line of text on page {', '.join(empty)}")
