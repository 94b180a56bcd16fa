"""Braille cells on an array of electrodes, and back from what was delivered."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from smarttouch.braille.cells import POSITION, cells_to_dots, dots_to_cells
from smarttouch.delivered.line import LinePicture
from smarttouch.electrodes import ElectrodeArray
from smarttouch.errors import ReadingError
from smarttouch.imaging.mapping import Tone
from smarttouch.profile import Profile
from smarttouch.reading.touch_line import Place, TouchLine
from smarttouch.reading.window import pixel_of

DOT_MM, CELL_MM, LINE_MM = 2.34, 6.2, 10.0
"""Distances from dot to dot, cell to cell and line to line (NLS Specification 800)."""
TONE = Tone(0.5, 0.5, prepared=True)
"""Tone curve of dots: one electrode each, on or off."""


@dataclass(frozen=True)
class CellLayout:
    """Places of the dots of cells on a grid of electrodes; distances are counted in electrodes."""

    rows: int
    columns: int
    dot_x: int  # from dot to dot
    dot_y: int
    cell: int  # from cell to cell
    line: int  # from line to line
    lines: int  # under the finger at once
    eight: bool  # dots a cell, or six
    pitch_mm: tuple[float, float]  # of the electrodes, across and down
    pixel_mm: float  # of the images that are drawn

    @property
    def height(self) -> int:
        """Number of rows of the lines."""
        return (3 if self.eight else 2) * self.dot_y + 1 + (self.lines - 1) * self.line

    @property
    def cell_mm(self) -> float:
        return self.cell * self.pitch_mm[0]

    @property
    def width_mm(self) -> float:
        """Width of the array."""
        return self.columns * self.pitch_mm[0]

    def dots_of(
        self, lines: tuple[str, ...], cell: int
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return rows and columns of the dots of cells that are ``cell`` electrodes apart."""
        rows, columns = [], []
        top = (self.rows - self.height) // 2
        for number, cells in enumerate(lines):
            index, dot = np.nonzero(cells_to_dots(cells))
            right, down = POSITION[dot].T
            rows.append(top + number * self.line + down * self.dot_y)
            columns.append(index * cell + right * self.dot_x)
        return np.concatenate(rows), np.concatenate(columns)

    def moving(
        self, lines: tuple[str, ...], text: str = "", place: Place | None = None
    ) -> TouchLine:
        """Return cells at their true distances, to be moved under the finger gradually."""
        longest = max(map(len, lines))
        image = self._draw(*self.dots_of(lines, self.cell), longest * self.cell)
        half_mm, length_mm = self.width_mm / 2, longest * self.cell_mm
        return TouchLine(image, -half_mm, length_mm + half_mm, text, lines, place)

    def one_by_one(self, lines: tuple[str, ...], text: str = "") -> TouchLine:
        """Return cells so far apart that the array shows one at a time, in its middle."""
        longest = max(map(len, lines))
        rows, columns = self.dots_of(lines, self.columns)
        columns = columns + (self.columns - self.dot_x - 1) // 2
        image = self._draw(rows, columns, longest * self.columns)
        first_mm = self.width_mm / 2
        # The last one stays as long as those before it.
        end_mm = first_mm + longest * self.width_mm * (1 - 1e-6)
        return TouchLine(image, first_mm, end_mm, text, lines)

    def decode(self, picture: LinePicture, lines: tuple[str, ...], apart: bool) -> tuple[str, ...]:
        """Return the delivered cells in place of those of ``lines``; ``apart`` if they came one by
        one.
        """
        found = []
        count = 8 if self.eight else 6
        for number, cells in enumerate(lines):
            every = (*[""] * number, dots_to_cells(np.ones((len(cells), count), bool)))
            rows, columns = self.dots_of(every, self.columns if apart else self.cell)
            if apart:
                columns = columns + (self.columns - self.dot_x - 1) // 2
            across, down = self.pitch_mm
            dots = picture.at((columns + 0.5) * across, (rows + 0.5) * down) > 0.5
            found.append(dots_to_cells(dots.reshape(len(cells), count)))
        return tuple(found)

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


def cell_layout(profile: Profile, lines: int = 1, eight: bool = False) -> CellLayout:
    """Return the layout of Braille on an array, at the distances of Braille on paper."""
    electrodes = profile.electrodes
    rows, columns = _grid_of(electrodes, profile.name)
    pitch_x, pitch_y = electrodes.cell_mm
    dot_x, dot_y = max(1, round(DOT_MM / pitch_x)), max(1, round(DOT_MM / pitch_y))
    layout = CellLayout(
        rows=rows,
        columns=columns,
        dot_x=dot_x,
        dot_y=dot_y,
        # Cells must be farther apart than their dots to be distinguishable.
        cell=max(2 * dot_x + 1, round(CELL_MM / pitch_x)),
        line=max(3 * dot_y + 1, round(LINE_MM / pitch_y)),
        lines=lines,
        eight=eight,
        pitch_mm=(pitch_x, pitch_y),
        pixel_mm=pixel_of(profile),
    )
    if lines < 1:
        raise ReadingError(
            f"{lines} lines of Braille at once are not possible: give 1 or more", about="lines"
        )
    if layout.height > rows or dot_x + 1 > columns:
        fewer = lines > 1 and replace(layout, lines=1).height <= rows
        raise ReadingError(
            f"{profile.name} has {rows} x {columns} electrodes, {lines} line{'s' * (lines > 1)} of "
            f"Braille with {8 if eight else 6} dots need {layout.height} x {dot_x + 1}: choose "
            + ("fewer lines" if fewer else "another profile"),
            about="profile",
            remedy="lines" if fewer else "",
        )
    return layout


def _grid_of(electrodes: ElectrodeArray, name: str) -> tuple[int, int]:
    """Return rows and columns of a grid that is numbered row by row."""
    x, y = (np.unique(np.round(electrodes.position_mm[:, axis], 6)) for axis in (0, 1))
    if len(x) * len(y) != len(electrodes):
        raise ReadingError(
            f"the electrodes of {name} are no grid of rows and columns, dots would fall between "
            "them: choose another profile, or read letter shapes",
            about="profile",
        )
    return len(y), len(x)
