"""Lines of Braille under the finger: of texts, files of cells, print, and embossed pages."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

from smarttouch.braille.cells import BLANK, SIX_DOT_PATTERNS, pattern
from smarttouch.braille.photo import looks_like_braille, read_braille
from smarttouch.braille.source import TEXT, load_cells
from smarttouch.braille.tables import DEFAULT_TABLE, BrailleTable, open_table
from smarttouch.documents.page_image import Page
from smarttouch.documents.text_lines import TextLine
from smarttouch.imaging.mapping import Tone
from smarttouch.profile import Profile
from smarttouch.reading.cells import CELL_MM, LINE_MM, TONE, CellLayout, cell_layout
from smarttouch.reading.cursor import LineMotion
from smarttouch.reading.printed import (
    EmptyPages,
    recognized_lines,
    recognized_text,
    upright_page,
)
from smarttouch.reading.source import Source
from smarttouch.reading.touch_line import Place, TouchLine
from smarttouch.reading.window import usual_speed

Cells = tuple[str, str, Place]
"""A line of cells, its text if known, and its place."""


class Presentation(StrEnum):
    """Presentations of cells under the finger."""

    LINE = "line"
    """A line moves through, electrode by electrode."""
    CELL = "cell"
    """One cell at a time, in the middle of the array."""


@dataclass(frozen=True)
class Braille:
    """Braille presentation: cells under the finger, by a table of `open_table`.

    Whether images show raised dots, and where their light comes from, is detected if not given.
    """

    table: str = DEFAULT_TABLE
    presentation: Presentation = Presentation.LINE
    at_once: int = 1
    embossed: bool | None = None
    light_from_deg: float | None = None

    @property
    def tone(self) -> Tone:
        """Tone curve from dots to activation."""
        return TONE

    def motion(
        self, profile: Profile, speed_mm_s: float | None = None, rate_hz: float | None = None
    ) -> LineMotion:
        """Return the motion of cells: as fast as shapes, in steps of an electrode or a cell."""
        speed_mm_s = usual_speed(profile, rate_hz) if speed_mm_s is None else speed_mm_s
        layout = self.layout(profile)
        if self.presentation is Presentation.LINE:
            return LineMotion(speed_mm_s, layout.pitch_mm[0])
        # A cell stays for as long as a line would take to move on by one.
        return LineMotion(speed_mm_s * layout.width_mm / layout.cell_mm, layout.width_mm, gaps=True)

    def layout(self, profile: Profile, cells: tuple[str, ...] = ()) -> CellLayout:
        """Return the places of the dots of lines of cells on an array."""
        eight = any(pattern(each) >= SIX_DOT_PATTERNS for line in cells for each in line)
        return cell_layout(profile, self.at_once, eight)

    def lines(self, source: Source, profile: Profile) -> Iterator[TouchLine]:
        """Yield lines of cells."""
        self.layout(profile)
        group: list[Cells] = []
        for each in self._cells_of(source):
            group.append(each)
            if len(group) == self.at_once:
                yield self._touch_line(group, profile)
                group.clear()
        if group:
            yield self._touch_line(group, profile)

    def _touch_line(self, group: list[Cells], profile: Profile) -> TouchLine:
        cells = tuple(each for each, _, _ in group)
        text = "\n".join(each for _, each, _ in group)
        layout = self.layout(profile, cells)
        if self.presentation is Presentation.CELL:
            return layout.one_by_one(cells, text)
        return layout.moving(cells, text, group[0][2])

    def _cells_of(self, source: Source) -> Iterator[Cells]:
        if source.words is not None or source.holds_cells:
            yield from self._given(source)
            return
        empty, table = EmptyPages(source.note), open_table(self.table)
        if table.note:
            source.note(table.note)
        for number, page in source.pages():
            found = False
            for each in self._seen(source, number, page):
                found = True
                yield each
            empty.add(number, found)
        empty.conclude()

    def _given(self, source: Source) -> Iterator[Cells]:
        """Yield the cells of a text, or of a file of cells."""
        words = source.words
        loaded = load_cells(
            source.name if words is None else TEXT + words, open_table(self.table), leave_out=True
        )
        for note in loaded.notes:
            source.note(note)
        texts = (words or "").splitlines()
        for index, cells in enumerate(loaded.paragraphs):
            if cells.strip(BLANK):
                text = texts[index] if len(texts) == len(loaded.paragraphs) else ""
                yield cells, text, _place_on_paper(index, cells)

    def paragraphs(self, source: Source) -> list[str]:
        """Return a document as cells, a line for each paragraph of print or line of embossed
        Braille.
        """
        table = open_table(self.table)
        empty, paragraphs = EmptyPages(source.note), []
        for number, page in source.pages():
            if self._shows_dots(page):
                found = self._decoded(source, number, page)
            else:
                prepared = upright_page(number, page, source.options, source.note)
                text = recognized_text(prepared, source.options, source.note)
                _note_missing(source, number, table, table.missing(text))
                found = table.to_cells(text, leave_out=True).split("\n")
            empty.add(number, any(each.strip(BLANK) for each in found))
            paragraphs += found
        empty.conclude()
        return paragraphs

    def _seen(self, source: Source, number: int, page: Page) -> Iterator[Cells]:
        """Yield the cells of a page, whether it shows Braille or print."""
        if self._shows_dots(page):
            for index, cells in enumerate(self._decoded(source, number, page)):
                if cells.strip(BLANK):
                    yield cells, "", _place_on_paper(index, cells)
            return
        table = open_table(self.table)
        prepared = upright_page(number, page, source.options, source.note)
        missing = ""
        for index, text in recognized_lines(prepared, source.options, source.note):
            missing += "".join(each for each in table.missing(text) if each not in missing)
            cells = table.to_cells(text, leave_out=True)
            if cells.strip(BLANK):
                yield cells, text, _place_on_page(prepared.lines[index], cells)
        _note_missing(source, number, table, missing)

    def _shows_dots(self, page: Page) -> bool:
        return looks_like_braille(page) if self.embossed is None else self.embossed

    def _decoded(self, source: Source, number: int, page: Page) -> list[str]:
        found = read_braille(page, self.light_from_deg)
        for note in found.notes:
            source.note(f"page {number}: {note}")
        return found.lines


def _note_missing(source: Source, number: int, table: BrailleTable, missing: str) -> None:
    if missing:
        source.note(
            f"page {number}: left out, as table {table.name} has no cells for them: "
            + " ".join(missing)
        )


def _place_on_page(line: TextLine, cells: str) -> Place:
    """Return the place of a line of print that became cells: its letters are narrower."""
    width_mm = max(line.right_mm - line.left_mm, 1.0)
    middle_mm = (line.top_mm + line.bottom_mm) / 2
    return Place(line.left_mm, line.right_mm, middle_mm, len(cells) * CELL_MM / width_mm)


def _place_on_paper(index: int, cells: str) -> Place:
    """Return the place of a line of cells on paper."""
    return Place(0.0, len(cells) * CELL_MM, index * LINE_MM, 1.0)
