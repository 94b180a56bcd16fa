"""Lines of Braille under the finger: cells of texts, files and pages, on an array of electrodes."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import ReadingError
from smarttouch.braille.cells import (
    BLANK,
    POSITION,
    SIX_DOT_PATTERNS,
    cells_to_dots,
    dots_to_cells,
    pattern,
)
from smarttouch.braille.code_tables import DEFAULT_TABLE, BrailleTable, open_table
from smarttouch.imaging.array_window import pixel_pitch_mm, usual_speed_mm_s
from smarttouch.imaging.tactile_mapper import Tone
from smarttouch.pages.page_image import Page
from smarttouch.profile import Profile
from smarttouch.profile.electrodes import ElectrodeArray
from smarttouch.reading.document_cells import document_cells
from smarttouch.reading.line_feed import TouchLine
from smarttouch.reading.line_source import LineMotion
from smarttouch.reading.material import ReadingMaterial, report_empty_pages
from smarttouch.reading.recognition import recognized_lines, upright_page
from smarttouch.running.delivered import LinePicture

DOT_MM, CELL_MM = 2.34, 6.2
"""Distances from dot to dot and cell to cell (NLS Specification 800)."""
TONE = Tone(0.5, 0.5, prepared=True)  # tone curve of dots: one electrode each, on or off


@dataclass(frozen=True)
class CellLayout:
    """Places of the dots of cells on a grid of electrodes; distances are counted in electrodes."""

    rows: int
    columns: int
    dot_x: int  # from dot to dot
    dot_y: int
    cell: int  # from cell to cell
    eight: bool  # dots a cell, or six
    pitch_mm: tuple[float, float]  # of the electrodes, across and down
    pixel_mm: float  # of the images that are drawn

    @property
    def height(self) -> int:
        """Number of rows of a cell."""
        return (3 if self.eight else 2) * self.dot_y + 1

    @property
    def cell_mm(self) -> float:
        return self.cell * self.pitch_mm[0]

    @property
    def width_mm(self) -> float:
        """Width of the array."""
        return self.columns * self.pitch_mm[0]

    def dots_of(self, cells: str, cell: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return rows and columns of the dots of cells that are ``cell`` electrodes apart."""
        index, dot = np.nonzero(cells_to_dots(cells))
        right, down = POSITION[dot].T
        top = (self.rows - self.height) // 2
        return top + down * self.dot_y, index * cell + right * self.dot_x

    @property
    def margin(self) -> int:
        """Number of columns of the array to the left of a cell in its middle."""
        return (self.columns - self.dot_x - 1) // 2

    def moving(self, cells: str, text: str = "") -> TouchLine:
        """Return cells at their true distances, to be moved under the finger gradually."""
        image = self._draw(*self.dots_of(cells, self.cell), len(cells) * self.cell)
        half_mm, length_mm = self.width_mm / 2, len(cells) * self.cell_mm
        return TouchLine(image, -half_mm, length_mm + half_mm, text, cells)

    def one_by_one(self, cells: str, text: str = "") -> TouchLine:
        """Return cells so far apart that the array shows one at a time, in its middle."""
        rows, columns = self.dots_of(cells, self.columns)
        image = self._draw(rows, columns + self.margin, len(cells) * self.columns)
        first_mm = self.width_mm / 2
        # The last one stays as long as those before it.
        end_mm = first_mm + len(cells) * self.width_mm * (1 - 1e-6)
        return TouchLine(image, first_mm, end_mm, text, cells)

    def decode(self, picture: LinePicture, cells: str, apart: bool) -> str:
        """Return the delivered cells in place of others; ``apart`` if they came one by one."""
        count = 8 if self.eight else 6
        every = dots_to_cells(np.ones((len(cells), count), bool))
        rows, columns = self.dots_of(every, self.columns if apart else self.cell)
        columns = columns + self.margin * apart
        across, down = self.pitch_mm
        dots = picture.at((columns + 0.5) * across, (rows + 0.5) * down) > 0.5
        return dots_to_cells(dots.reshape(len(cells), count))

    def _draw(
        self, rows: NDArray[np.intp], columns: NDArray[np.intp], width: int
    ) -> NDArray[np.uint8]:
        across, down = (pitch / self.pixel_mm for pitch in self.pitch_mm)
        image = np.full((round(self.rows * down), max(1, round(width * across))), 255, np.uint8)
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
            image[
                round(row * down) : round((row + 1) * down),
                round(column * across) : round((column + 1) * across),
            ] = 0
        return image


def cell_layout(profile: Profile, eight: bool = False) -> CellLayout:
    """Return the layout of Braille on an array, at the distances of Braille on paper."""
    electrodes = profile.electrodes
    rows, columns = _grid_of(electrodes, profile.name)
    pitch_x, pitch_y = electrodes.cell_mm
    dot_x, dot_y = max(1, round(DOT_MM / pitch_x)), max(1, round(DOT_MM / pitch_y))
    # Cells must be farther apart than their dots to be distinguishable.
    cell = max(2 * dot_x + 1, round(CELL_MM / pitch_x))
    layout = CellLayout(
        rows, columns, dot_x, dot_y, cell, eight, (pitch_x, pitch_y), pixel_pitch_mm(profile)
    )
    if layout.height > rows or dot_x + 1 > columns:
        raise ReadingError(
            f"{profile.name} has {rows} x {columns} electrodes, Braille with "
            f"{8 if eight else 6} dots needs {layout.height} x {dot_x + 1}: choose another profile"
        )
    return layout


def _grid_of(electrodes: ElectrodeArray, name: str) -> tuple[int, int]:
    """Return rows and columns of a grid that is numbered row by row."""
    x, y = (np.unique(np.round(electrodes.position_mm[:, axis], 6)) for axis in (0, 1))
    if len(x) * len(y) != len(electrodes):
        raise ReadingError(
            f"the electrodes of {name} are no grid of rows and columns, dots would fall between "
            "them: choose another profile, or read letter shapes"
        )
    return len(y), len(x)


Cells = tuple[str, str]  # a line of cells, and its text if known


class Presentation(StrEnum):
    """Presentations of cells under the finger."""

    LINE = "line"
    """A line moves through, electrode by electrode."""
    CELL = "cell"
    """One cell at a time, in the middle of the array."""


@dataclass(frozen=True)
class Braille:
    """Braille presentation: cells under the finger, by a table of `open_table`."""

    table: str = DEFAULT_TABLE
    presentation: Presentation = Presentation.LINE

    @property
    def tone(self) -> Tone:
        """Tone curve from dots to activation."""
        return TONE

    def motion(
        self, profile: Profile, speed_mm_s: float | None = None, rate_hz: float | None = None
    ) -> LineMotion:
        """Return the motion of cells: as fast as shapes, in steps of an electrode or a cell."""
        speed_mm_s = usual_speed_mm_s(profile, rate_hz) if speed_mm_s is None else speed_mm_s
        layout = self.layout(profile)
        if self.presentation is Presentation.LINE:
            return LineMotion(speed_mm_s, layout.pitch_mm[0])
        # A cell stays for as long as a line would take to move on by one.
        return LineMotion(speed_mm_s * layout.width_mm / layout.cell_mm, layout.width_mm, gaps=True)

    def layout(self, profile: Profile, cells: str = "") -> CellLayout:
        """Return the places of the dots of a line of cells on an array."""
        return cell_layout(profile, any(pattern(each) >= SIX_DOT_PATTERNS for each in cells))

    def lines(self, source: ReadingMaterial, profile: Profile) -> Iterator[TouchLine]:
        """Yield lines of cells."""
        self.layout(profile)
        for cells, text in self._cells_of(source):
            layout = self.layout(profile, cells)
            if self.presentation is Presentation.CELL:
                yield layout.one_by_one(cells, text)
            else:
                yield layout.moving(cells, text)

    def _cells_of(self, source: ReadingMaterial) -> Iterator[Cells]:
        table = open_table(self.table)
        if table.note and not source.holds_cells:
            source.note(table.note)
        if source.words is not None or source.holds_cells:
            paragraphs = document_cells(source, table, source.note).paragraphs
            texts = (source.words or "").splitlines()
            for index, cells in enumerate(paragraphs):
                if cells.strip(BLANK):
                    text = texts[index] if len(texts) == len(paragraphs) else ""
                    yield cells, text
            return
        found: dict[int, bool] = {}
        for number, page in source.pages():
            found[number] = False
            for each in self._seen(source, number, page, table):
                found[number] = True
                yield each
        report_empty_pages(found, source.note)

    def _seen(
        self, source: ReadingMaterial, number: int, page: Page, table: BrailleTable
    ) -> Iterator[Cells]:
        """Yield the cells of a page of print."""
        prepared = upright_page(number, page, source.options, source.note)
        signs: dict[str, None] = {}
        for _, text in recognized_lines(prepared, source.options, source.note):
            signs |= dict.fromkeys(text)
            cells = table.to_cells(text, leave_out=True)
            if cells.strip(BLANK):
                yield cells, text
        if losses := table.losses("".join(signs)):
            source.note(f"page {number}: {losses}")
