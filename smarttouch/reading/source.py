"""Material to read: images, documents, texts, files of cells."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from smarttouch.braille.files import Kind, kind_of, read_plain_text
from smarttouch.braille.source import TEXT
from smarttouch.documents.page_image import Page
from smarttouch.documents.prepare import PreparedPage
from smarttouch.documents.printed_text import prepare_text
from smarttouch.reading.printed import Note, RecognitionOptions, document_pages, prepared_pages

_PRINTED_AT_ONCE = 20  # lines of a text on one printed page


@dataclass(frozen=True)
class Source:
    """Material that can be read: a file, or ``text:`` and words; warnings go to ``note``."""

    name: str
    options: RecognitionOptions = field(default_factory=RecognitionOptions)
    note: Note = lambda _words: None

    @property
    def title(self) -> str:
        """Title on the screen."""
        return "a text" if self.name.startswith(TEXT) else Path(self.name).name

    @cached_property
    def kind(self) -> Kind:
        """Kind of what it holds."""
        return Kind.TEXT if self.name.startswith(TEXT) else kind_of(Path(self.name))

    @property
    def holds_cells(self) -> bool:
        """True if it is a file of Braille cells."""
        return self.kind in (Kind.BRF, Kind.PEF)

    @cached_property
    def words(self) -> str | None:
        """The text itself; None for images and cells."""
        if self.name.startswith(TEXT):
            return self.name[len(TEXT) :]
        if self.kind is Kind.TEXT:
            return read_plain_text(Path(self.name))
        return None

    def pages(self) -> Iterator[tuple[int, Page]]:
        """Yield numbers and pages of a document."""
        return document_pages(Path(self.name), self.options, self.note)

    def prepared(self) -> Iterator[PreparedPage]:
        """Yield pages with print on them: of a document, or of a text as it is printed."""
        words = self.words
        if words is None:
            yield from prepared_pages(self.pages(), self.options, self.note)
            return
        lines = words.splitlines()
        parts = [
            "\n".join(lines[start : start + _PRINTED_AT_ONCE])
            for start in range(0, len(lines), _PRINTED_AT_ONCE)
        ]
        for part in [part for part in parts if part.strip()] or [""]:
            yield prepare_text(part)
