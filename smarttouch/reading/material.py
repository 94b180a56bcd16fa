"""Material to read: images, documents, texts and files of cells, page by page."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from smarttouch.base.errors import ReadingError
from smarttouch.pages.document import open_document, parse_pages
from smarttouch.pages.file_kinds import FileKind, file_kind, read_plain_text
from smarttouch.pages.page_image import Page
from smarttouch.pages.pandoc_text import read_pandoc_text
from smarttouch.pages.prepared_page import PreparedPage, prepare_text
from smarttouch.reading.paragraphs import paragraphs, printed_lines
from smarttouch.reading.recognition import (
    Note,
    RecognitionOptions,
    recognized_lines,
    upright_page,
)

TEXT = "text:"  # prefix of words that are not a file name


def report_empty_pages(found: dict[int, bool], note: Note) -> None:
    """Report pages by number on which no text was found; raise if it was found on none."""
    if not any(found.values()):
        raise ReadingError(
            "no line of text was found: is it a page of print, sharp, and large enough "
            "(letters of 6 pixels and more)?"
        )
    if empty := [str(number) for number, has_text in found.items() if not has_text]:
        note(f"no line of text on page {', '.join(empty)}")


def recognized_text(prepared: PreparedPage, options: RecognitionOptions, note: Note) -> str:
    """Return the text of a page, a line for each paragraph, see `paragraphs`."""
    texts = [text for _, text in recognized_lines(prepared, options, note)]
    return "\n".join(paragraphs(printed_lines(1, prepared.lines, texts)))


_PRINTED_AT_ONCE = 20  # lines of a text on one printed page


@dataclass(frozen=True)
class ReadingMaterial:
    """Material that can be read: a file, or ``text:`` and words; warnings go to ``note``."""

    name: str
    options: RecognitionOptions = field(default_factory=RecognitionOptions)
    note: Note = lambda _words: None

    @property
    def title(self) -> str:
        """Title on the screen."""
        return "a text" if self.name.startswith(TEXT) else Path(self.name).name

    @cached_property
    def kind(self) -> FileKind:
        """Kind of what it holds."""
        return FileKind.TEXT if self.name.startswith(TEXT) else file_kind(Path(self.name))

    @property
    def holds_cells(self) -> bool:
        """True if it is a file of Braille cells."""
        return self.kind is FileKind.BRF

    @cached_property
    def words(self) -> str | None:
        """The text itself; None for images and cells."""
        if self.name.startswith(TEXT):
            return self.name[len(TEXT) :]
        if self.kind is FileKind.TEXT:
            return read_plain_text(Path(self.name))
        if self.kind is FileKind.STRUCTURED:
            return read_pandoc_text(Path(self.name), self.note)
        return None

    def numbers(self) -> list[int]:
        """Return the numbers of the pages of a document that are asked for."""
        with open_document(Path(self.name), password=self.options.password) as document:
            return self._wanted(len(document))

    def _wanted(self, count: int) -> list[int]:
        pages = self.options.pages
        indices = parse_pages(pages, count) if pages else range(count)
        return [index + 1 for index in indices]

    def pages(self) -> Iterator[tuple[int, Page]]:
        """Yield numbers and pages of a document, one in memory at a time.

        A scale that the document assumes is not reported: every line is made as high as the array.
        """
        options = self.options
        with open_document(
            Path(self.name),
            dpi=options.dpi,
            page_width_mm=options.page_width_mm,
            password=options.password,
        ) as document:
            for number in self._wanted(len(document)):
                yield number, document.page(number - 1)

    def prepared(self) -> Iterator[PreparedPage]:
        """Yield pages with print on them, see `upright_page`: of a document, or of a text as it is
        printed. Raise if no page has any."""
        if self.words is None:
            found: dict[int, bool] = {}
            for number, page in self.pages():
                prepared = upright_page(number, page, self.options, self.note)
                found[number] = bool(prepared.lines)
                if prepared.lines:
                    yield prepared
            report_empty_pages(found, self.note)
            return
        lines = self.words.splitlines()
        parts = [
            "\n".join(lines[start : start + _PRINTED_AT_ONCE])
            for start in range(0, len(lines), _PRINTED_AT_ONCE)
        ]
        for part in [part for part in parts if part.strip()] or [""]:
            yield prepare_text(part)
