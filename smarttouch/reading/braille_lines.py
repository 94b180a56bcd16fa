"""Braille of texts, files and pages, as paragraphs of cells and as lines that a finger reads."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import BrailleError, ReadingError
from smarttouch.braille.brf import read_brf
from smarttouch.braille.cells import (
    BLANK,
    POSITION,
    SIX_DOT_PATTERNS,
    Pages,
    cells_to_dots,
    pattern,
)
from smarttouch.braille.code_tables import DEFAULT_TABLE, BrailleTable, open_table
from smarttouch.braille.page_layout import COLUMNS, INDENT, ROWS, join, lay_out
from smarttouch.imaging.reading_profile import pixel_pitch_mm, usual_speed_mm_s
from smarttouch.imaging.tactile_mapper import Tone
from smarttouch.profile import Profile
from smarttouch.reading.line_source import LineMotion, TouchLine
from smarttouch.reading.reading_material import ReadingMaterial
from smarttouch.reading.recognition import Note, recognized_lines

DOT_MM, CELL_MM = 2.34, 6.2
"""Distances between dots and between cells (NLS Specification 800)."""


@dataclass(frozen=True)
class DocumentCells:
    """A document as paragraphs of cells, and its pages if it is a BRF file."""

    paragraphs: list[str]
    pages: Pages | None = None

    def laid_out(self, columns: int | None, rows: int | None, indent: int = INDENT) -> Pages:
        """Return pages of cells. Without a given size, the pages of a BRF file stay unchanged."""
        if self.pages is not None and columns is None and rows is None:
            return self.pages
        columns, rows = COLUMNS if columns is None else columns, ROWS if rows is None else rows
        return lay_out(self.paragraphs, columns, rows, indent)


def document_cells(source: ReadingMaterial, table: BrailleTable, progress: Note) -> DocumentCells:
    """Convert a text, a file of cells or a document to cells.

    Calls ``source.note`` with a sentence about omitted parts. If a document has several pages,
    calls ``progress`` with the number of pages done.
    """
    if source.holds_cells:
        pages = read_brf(Path(source.name), source.note)
        cells = DocumentCells(join(pages), pages)
    else:
        text = source.words
        if text is None:
            text = "\n".join(source.paragraphs(progress))
        cells = DocumentCells(table.paragraphs(text, source.note))
    if not any(paragraph.strip(BLANK) for paragraph in cells.paragraphs):
        raise BrailleError("there is nothing to read: give a text, or a file that contains text")
    return cells


@dataclass(frozen=True)
class CellLayout:
    """Layout of the dots of cells on a grid of electrodes."""

    rows: int
    columns: int
    dot_x: int  # electrodes from one column of dots to the next
    dot_y: int  # electrodes from one row of dots to the next
    cell: int  # electrodes from one cell to the next
    eight: bool  # whether cells have eight dots, not six
    pitch_mm: tuple[float, float]  # pitch of the electrodes, across and down
    pixel_mm: float  # pixel size of drawn images

    @property
    def height(self) -> int:
        """Number of rows of electrodes of a cell."""
        return (3 if self.eight else 2) * self.dot_y + 1

    def dots_of(self, cells: str) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the row and the column of the electrode for each dot of ``cells``."""
        index, dot = np.nonzero(cells_to_dots(cells))
        right, down = POSITION[dot].T
        top = (self.rows - self.height) // 2
        return top + down * self.dot_y, index * self.cell + right * self.dot_x

    @property
    def margin(self) -> int:
        """Number of columns of electrodes to the left of a cell that is centered on the array."""
        return (self.columns - self.dot_x - 1) // 2

    def line(self, cells: str, text: str = "") -> TouchLine:
        """Draw cells as a line that moves under the finger."""
        dots = np.full((self.rows, max(1, len(cells) * self.cell)), 255, np.uint8)
        dots[self.dots_of(cells)] = 0
        across, down = (pitch / self.pixel_mm for pitch in self.pitch_mm)
        size = (round(dots.shape[1] * across), round(self.rows * down))
        image = np.asarray(cv2.resize(dots, size, interpolation=cv2.INTER_NEAREST), np.uint8)
        half_mm = self.columns * self.pitch_mm[0] / 2
        length_mm = len(cells) * self.cell * self.pitch_mm[0]
        return TouchLine(image, -half_mm, length_mm + half_mm, text, cells)


def cell_layout(profile: Profile, eight: bool = False) -> CellLayout:
    """Return the layout of Braille on an array, with distances close to those on paper."""
    electrodes = profile.electrodes
    rows, columns = (
        len(np.unique(np.round(electrodes.position_mm[:, axis], 6))) for axis in (1, 0)
    )  # fmt: skip
    if rows * columns != len(electrodes):
        raise ReadingError(
            f"the electrodes of {profile.name} are not a grid of rows and columns, so dots would "
            "fall between electrodes: choose another profile, or read letter shapes"
        )
    pitch_x, pitch_y = electrodes.cell_mm
    dot_x, dot_y = max(1, round(DOT_MM / pitch_x)), max(1, round(DOT_MM / pitch_y))
    # Gaps between cells must be wider than gaps between dots.
    cell = max(2 * dot_x + 1, round(CELL_MM / pitch_x))
    layout = CellLayout(
        rows, columns, dot_x, dot_y, cell, eight, (pitch_x, pitch_y), pixel_pitch_mm(profile)
    )
    if layout.height > rows or dot_x + 1 > columns:
        raise ReadingError(
            f"{profile.name} has {rows} x {columns} electrodes, but Braille with "
            f"{8 if eight else 6} dots needs {layout.height} x {dot_x + 1}: choose another profile"
        )
    return layout


@dataclass(frozen=True)
class Braille:
    """Presentation as Braille cells; `table` is a name for `open_table`."""

    table: str = DEFAULT_TABLE
    tone: ClassVar[Tone] = Tone(0.5, 0.5, prepared=True)
    """Tone curve of Braille: a step, so that each electrode is either on or off."""

    def motion(
        self, profile: Profile, speed_mm_s: float | None = None, rate_hz: float | None = None
    ) -> LineMotion:
        """Return a motion in steps of one electrode. By default, it is as fast as for letters."""
        speed_mm_s = usual_speed_mm_s(profile, rate_hz) if speed_mm_s is None else speed_mm_s
        return LineMotion(speed_mm_s, cell_layout(profile).pitch_mm[0])

    def lines(self, source: ReadingMaterial, profile: Profile) -> Iterator[TouchLine]:
        """Yield lines of cells."""
        cell_layout(profile)
        for cells, text in self._cells_of(source):
            if cells.strip(BLANK):
                eight = any(pattern(cell) >= SIX_DOT_PATTERNS for cell in cells)
                yield cell_layout(profile, eight).line(cells, text)

    def _cells_of(self, source: ReadingMaterial) -> Iterator[tuple[str, str]]:
        """Yield lines of cells with their texts, which are empty if unknown."""
        table = open_table(self.table)
        if table.note and not source.holds_cells:
            source.note(table.note)
        if source.words is not None or source.holds_cells:
            paragraphs = document_cells(source, table, source.note).paragraphs
            texts = (source.words or "").splitlines()
            known = len(texts) == len(paragraphs)
            yield from zip(paragraphs, texts if known else itertools.repeat(""), strict=False)
            return
        for prepared in source.prepared():
            signs: dict[str, None] = {}
            for _, text in recognized_lines(prepared, source.options, source.note):
                signs |= dict.fromkeys(text)
                yield table.to_cells(text, leave_out=True), text
            if losses := table.losses("".join(signs)):
                source.note(losses)
