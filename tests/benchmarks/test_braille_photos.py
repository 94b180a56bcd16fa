"""Cells of real photographs and scans of Braille, against labels made by people.

Give a folder in ``SMARTTOUCH_BRAILLE_PAGES``: pictures, each with a ``.csv`` as in the Angelina
data set (left;top;right;bottom;dots) or a ``.txt`` as in DSBI (skew, columns, rows, cells).
"""

import os
from collections import defaultdict
from pathlib import Path

import cv2
import numpy as np
import pytest
from rapidfuzz.distance import Levenshtein
from scipy.spatial import cKDTree

from smarttouch.base.errors import PageError
from smarttouch.braille.cell_detection import FoundCells, cell_lines, cell_pitch
from smarttouch.braille.photo import BraillePage, looks_like_braille, read_braille
from smarttouch.pages.page_image import Page

FOLDER = os.environ.get("SMARTTOUCH_BRAILLE_PAGES")
NEAR = 0.45
"""Largest distance of a cell from its place, in distances of cells."""
NONE = BraillePage([], np.zeros((0, 2)), np.zeros(0, int), 0.0, [])


def labels_of(path, shape):
    """Return middles of cells in pixels and their patterns."""
    size = np.array(shape[::-1])
    if path.suffix == ".csv":
        rows = np.loadtxt(path, delimiter=";", ndmin=2)
        return (rows[:, :2] + rows[:, 2:4]) / 2 * size, rows[:, 4].astype(int)
    skew, columns, rows, *cells = (line.split() for line in path.read_text().splitlines() if line)
    x, y = np.array(columns, float), np.array(rows, float)
    named = np.array(cells, int)
    column, row = named[:, 1] - 1, named[:, 0] - 1
    px = np.column_stack([x[2 * column] + x[2 * column + 1], 2 * y[3 * row + 1]]) / 2
    # The rows of the labels are level, those of the picture are not.
    angle = np.radians(float(skew[0]))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    either = [(px - size / 2) @ way + size / 2 for way in (turn, turn.T)]
    return either, named[:, 2:] @ (1 << np.arange(6))


def hits(px, patterns, found):
    """Return how many cells were found in their places with all their dots right."""
    if not len(found.cells_px):
        return 0
    away, nearest = cKDTree(found.cells_px).query(px)
    near = away < NEAR * cell_pitch(px)
    right = near & (found.patterns[nearest] == patterns)
    return len(set(nearest[right]))


@pytest.mark.skipif(FOLDER is None, reason="SMARTTOUCH_BRAILLE_PAGES names no folder")
def test_real_pages():
    sums = defaultdict(lambda: np.zeros(8))
    for path in sorted(Path(FOLDER or "").glob("*.jpg")):
        grey = np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.uint8)
        labels = next(
            each for each in (path.with_suffix(".csv"), path.with_suffix(".txt")) if each.exists()
        )
        px, patterns = labels_of(labels, grey.shape)
        try:
            found, refused = read_braille(Page(grey, 0.1)), 0
        except PageError:
            found, refused = NONE, 1
        ways = px if isinstance(px, list) else [px]
        right, px = max(
            ((hits(each, patterns, found), each) for each in ways), key=lambda way: way[0]
        )
        wanted = "\n".join(cell_lines(FoundCells(px, patterns, np.ones(len(px))))[0])
        errors = Levenshtein.distance("\n".join(found.lines), wanted)
        f = 2 * right / (len(px) + len(found.cells_px))
        warned = any("certain" in note for note in found.notes)
        print(f"{path.stem}: F {f:.3f}, certainty {found.certainty:.2f}")
        silent = f < 0.9 and not warned and not refused
        known = looks_like_braille(Page(grey, 0.1))
        counted = 2 * right, len(px) + len(found.cells_px), errors, len(wanted)
        sums[path.stem.partition("_")[0]] += [*counted, refused, warned, silent, known]
    for kind, (twice, cells, errors, characters, *counts) in sums.items():
        names = ("refused", "warned of", "wrong without warning", "known for Braille")
        told = ", ".join(f"{name} {count:.0f}" for name, count in zip(names, counts, strict=True))
        print(f"{kind}: F {twice / cells:.3f}, characters {1 - errors / characters:.3f}, {told}")
    assert sums
    assert all(each[0] / each[1] > 0.9 and not each[6] for each in sums.values())
