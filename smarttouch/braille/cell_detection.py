"""Cells of Braille found in a picture by a small convolutional network, and joined into lines.

Its weights come from rendered pages alone; no photograph went into them.
"""

import threading
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.braille.cells import BLANK

STRIDE = 4
"""Pixels of the picture per position of the network's map."""
LEAST = 0.4
"""Least certainty of a position where a cell is found."""
_NEAR_PX, _AROUND_PX = (
    41,
    81,
)  # sides of the squares over which brightness and contrast are normalized
_APART_PX = 11, 14
"""Least distance of cells, across and down: those of the finest pages have 18 and 28."""

Image = NDArray[np.float32]


class FoundCells(NamedTuple):
    """Cells found in a picture."""

    px: NDArray[np.float64]  # (N, 2), middles: column and row
    patterns: NDArray[np.int_]  # (N,), bit k is dot k + 1
    certainty: NDArray[np.float64]  # (N,) in [0, 1], that all of a cell is right


def find_cells(grey: NDArray[np.uint8]) -> FoundCells:
    """Return the cells of a picture whose dots are 8 to 13 pixels apart, lit from above."""
    return cells_of(looked_at(grey)[1])


def looked_at(grey: NDArray[np.uint8]) -> tuple[Image, Image]:
    """Return a picture with normalized contrast, and the network's maps of it, (9, H, W)."""
    height, width = grey.shape
    edges = 0, -height % (2 * STRIDE), 0, -width % (2 * STRIDE)
    framed = cv2.copyMakeBorder(grey, *edges, borderType=cv2.BORDER_REFLECT)
    even = evened(np.asarray(framed, np.uint8))
    return even, _run(even)


def cells_of(maps: Image, least: float = LEAST) -> FoundCells:
    """Return the cells at the peaks of the network's maps, each at least so certain."""
    there = maps[0]
    peaks = (there >= cv2.dilate(there, np.ones((3, 3), np.uint8))) & (there > least)
    rows, columns = np.nonzero(peaks)
    strength, dots = there[rows, columns], maps[3:, rows, columns]
    px = np.column_stack([columns + maps[1, rows, columns], rows + maps[2, rows, columns]])
    px = px.astype(float) * STRIDE + (STRIDE - 1) / 2
    kept = _without_overlaps(px, strength)
    dots = dots[:, kept]
    return FoundCells(
        px[kept],
        (dots > 0.5).T @ (1 << np.arange(6)),
        np.asarray(strength[kept] * np.maximum(dots, 1 - dots).prod(axis=0), float),
    )


def evened(grey: NDArray[np.uint8]) -> Image:
    """Return a picture with normalized background and contrast."""
    picture = grey.astype(np.float32)
    near = picture - cv2.blur(picture, (_NEAR_PX,) * 2, borderType=cv2.BORDER_REFLECT)
    spread = np.maximum(cv2.blur(near * near, (_AROUND_PX,) * 2, borderType=cv2.BORDER_REFLECT), 0)
    return np.asarray(np.clip(near / (np.sqrt(spread) + 2), -4, 4), np.float32)


def _run(picture: Image) -> Image:
    """Return maps, (9, H, W): certainty of a cell, its two offsets, and its six dots."""
    with _lock:
        network = _network()
        network.setInput(picture[None, None])
        maps = np.array(network.forward()[0], np.float32)
    for each in (0, *range(3, 9)):
        maps[each] = 1 / (1 + np.exp(-np.clip(maps[each], -30, 30)))
    return maps


_lock = threading.Lock()
"""Lock of the network, which keeps the layers of its last picture."""


@cache
def _network() -> cv2.dnn.Net:
    data = np.fromfile(Path(__file__).with_name("network.onnx"), np.uint8)
    network = cv2.dnn.readNetFromONNX(data)
    # Its product of rounded numbers would move cells of doubtful dots.
    network.enableWinograd(False)
    return network


def _without_overlaps(px: NDArray[np.float64], strength: Image) -> NDArray[np.int_]:
    """Return the indices, (M,), of the most certain of cells that overlap."""
    kept: list[int] = []
    across, down = _APART_PX
    for each in np.argsort(-strength, kind="stable"):
        away = np.abs(px[kept] - px[each])
        if not ((away[:, 0] < across) & (away[:, 1] < down)).any():
            kept.append(int(each))
    return np.array(sorted(kept), int)


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


def level_rows(found: FoundCells) -> tuple[list[list[int]], Points, Callable[[Points], Points]]:
    """Return the cells of each row from the left, rows from the top, without print beside Braille
    and cells between its lines; the places of all cells with level rows, in distances of cells;
    and the map of such places to pixels."""
    pitch_px = cell_pitch(found.px) or 1.0
    slope = slope_of(found.px, pitch_px)
    turn = np.array([[1, -slope], [slope, 1]]) / pitch_px
    level = found.px @ turn
    rows = [
        row
        for row in _joined(_followed(level), level, found.certainty)
        if found.certainty[row].mean() > _LEAST_CERTAINTY
    ]
    rows.sort(key=lambda row: float(np.median(level[row, 1])))
    back = np.linalg.inv(turn)
    return rows, level, lambda places: places @ back


def cell_lines(found: FoundCells) -> tuple[list[str], list[int]]:
    """Return lines of cells, with blanks where there is room for them, and the indices of cells,
    without print beside Braille and cells between its lines."""
    rows, level, _ = level_rows(found)
    if not rows:
        return [], []
    gaps = np.diff([np.median(level[row, 1]) for row in rows])
    usual = float(np.median(gaps)) if len(gaps) else 1.0
    starts = np.sort([level[row[0], 0] for row in rows])
    # A false cell in the margin must not move all lines.
    left = float(starts[len(starts) // 10])
    lines: list[str] = []
    for index, row in enumerate(rows):
        if index:
            lines += [""] * max(0, round(gaps[index - 1] / usual) - 1)
        places = columns_of(level[row, 0], left)
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
    spans: list[tuple[float, float]] = []
    for row in sorted(rows, key=len, reverse=True):
        top, bottom = float(level[row, 1].min()), float(level[row, 1].max())
        for k, other in enumerate(joined):
            if top - spans[k][1] > _ONE_LINE or spans[k][0] - bottom > _ONE_LINE:
                continue
            there = np.interp(level[row, 0], level[other, 0], level[other, 1])
            if abs(np.median(level[row, 1] - there)) < _ONE_LINE:
                other += row
                other.sort(key=lambda each: level[each, 0])
                spans[k] = min(top, spans[k][0]), max(bottom, spans[k][1])
                break
        else:
            joined.append(list(row))
            spans.append((top, bottom))
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


def columns_of(x: NDArray[np.float64], left: float | None = None) -> list[int]:
    """Return the column of each cell of a row, from ``left`` or its first cell."""
    left = float(x[0]) if left is None else left
    steps = np.diff(x)
    close = steps[steps < 1.5]
    own = float(np.median(close)) if len(close) > 2 else 1.0
    counts = np.maximum(1, np.rint(steps / own)).astype(int)
    first = max(0, round((x[0] - left) / own))
    return [first, *(first + np.cumsum(counts)).tolist()]
