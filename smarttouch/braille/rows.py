"""Lines of Braille, joined from single cells."""

import numpy as np
from numpy.typing import NDArray

from smarttouch.braille.cells import BLANK
from smarttouch.braille.network import FoundCells

Points = NDArray[np.float64]

_LEVEL = 0.35  # largest distance of a cell from the line of the one before it, in cells
_LONGEST_GAP = 12.0  # longest gap within a line, in cells
_ONE_LINE = 0.8  # largest distance of two parts of one line, in cells; lines are 1.4 and more apart
_OVERLAP = 0.6  # distance of cells below which they are one, in cells
_LEAST_CERTAINTY = 0.35  # least mean certainty of a row: print beside Braille has less


def cell_pitch(px: Points) -> float:
    """Return the usual distance of neighboring cells, px; 0 if there are none."""
    if len(px) < 2:
        return 0.0
    across = px[None, :, 0] - px[:, None, 0]
    down = np.abs(px[None, :, 1] - px[:, None, 1])
    right = np.where((across > 0) & (down < 0.3 * across), across, np.inf).min(axis=1)
    right = right[np.isfinite(right)]
    return float(np.median(right[right < 1.5 * np.median(right)])) if len(right) else 0.0


def slope_of(px: Points, pitch_px: float) -> float:
    """Return the slope of lines, positive if they fall to the right."""
    steps = (px[None] - px[:, None]).reshape(-1, 2)
    near = (steps[:, 0] > 0.6 * pitch_px) & (steps[:, 0] < 3.5 * pitch_px)
    near &= np.abs(steps[:, 1]) < 0.3 * steps[:, 0]
    return float(np.median(steps[near, 1] / steps[near, 0])) if near.any() else 0.0


def cell_lines(found: FoundCells) -> tuple[list[str], list[int]]:
    """Return lines of cells, with blanks where there is room for them, and the indices of cells,
    without print beside Braille and cells between its lines."""
    pitch_px = cell_pitch(found.px) or 1.0
    slope = slope_of(found.px, pitch_px)
    x, y = found.px.T
    level = np.column_stack([x + slope * y, y - slope * x]) / pitch_px
    rows = [
        row
        for row in _joined(_followed(level), level, found.certainty)
        if found.certainty[row].mean() > _LEAST_CERTAINTY
    ]
    if not rows:
        return [], []
    rows.sort(key=lambda row: float(np.median(level[row, 1])))
    gaps = np.diff([np.median(level[row, 1]) for row in rows])
    usual = float(np.median(gaps)) if len(gaps) else 1.0
    starts = np.sort([level[row[0], 0] for row in rows])
    # A false cell in the margin must not move all lines.
    left = float(starts[len(starts) // 10])
    lines: list[str] = []
    for index, row in enumerate(rows):
        if index:
            lines += [""] * max(0, round(gaps[index - 1] / usual) - 1)
        places = _places(level[row, 0], left)
        line = [BLANK] * (places[-1] + 1)
        for place, each in zip(places, row, strict=True):
            line[place] = chr(ord(BLANK) + int(found.patterns[each]))
        lines.append("".join(line).rstrip(BLANK))
    return lines, [each for row in rows for each in row]


def _followed(level: Points) -> list[list[int]]:
    """Return the cells of each row from left to right, followed from cell to cell."""
    rows: list[list[int]] = []
    for each in np.argsort(level[:, 0], kind="stable").tolist():
        x, y = level[each]
        near = [
            (abs(y - level[row[-1], 1]), row)
            for row in rows
            if 0.5 < x - level[row[-1], 0] < _LONGEST_GAP
        ]
        away, best = min(near, key=lambda found: found[0], default=(np.inf, []))
        if away < _LEVEL:
            best.append(each)
        else:
            rows.append([each])
    return rows


def _joined(rows: list[list[int]], level: Points, certainty: Points) -> list[list[int]]:
    """Join rows that are too near each other for two lines; of cells that overlap, keep one."""
    joined: list[list[int]] = []
    for row in sorted(rows, key=len, reverse=True):
        for other in joined:
            there = np.interp(level[row, 0], level[other, 0], level[other, 1])
            if abs(np.median(level[row, 1] - there)) < _ONE_LINE:
                other += row
                other.sort(key=lambda each: level[each, 0])
                break
        else:
            joined.append(list(row))
    return [_apart(row, level, certainty) for row in joined]


def _apart(row: list[int], level: Points, certainty: Points) -> list[int]:
    """Return a row without the less certain of two cells in one place."""
    kept: list[int] = []
    for each in row:
        if not kept or level[each, 0] - level[kept[-1], 0] > _OVERLAP:
            kept.append(each)
        elif certainty[each] > certainty[kept[-1]]:
            kept[-1] = each
    return kept


def _places(x: NDArray[np.float64], left: float) -> list[int]:
    """Return the column of each cell of a row."""
    steps = np.diff(x)
    close = steps[steps < 1.5]
    own = float(np.median(close)) if len(close) > 2 else 1.0
    counts = np.maximum(1, np.rint(steps / own)).astype(int)
    first = max(0, round((x[0] - left) / own))
    return [first, *(first + np.cumsum(counts)).tolist()]
