"""Order and text of typeset pages and of photographs of print, whose truth is known.

Run ``python -m tests.benchmarks.typeset_pages``: thirty pages of ten layouts, ours beside
Tesseract's own layout (``--psm 3``), then ten photographs by perspective, curl, shadow, blur and
JPEG of quality 30, beside Tesseract on the flat page.
"""

import math
import subprocess
import tempfile
from pathlib import Path

import cv2
import numpy as np
from scipy.stats import kendalltau

from smarttouch.pages.page_image import Page
from smarttouch.pages.prepared_page import prepare_page
from smarttouch.reading.legibility import character_error_rate
from smarttouch.reading.recognition import RecognitionOptions, recognized_lines, upright_page
from tests.pages import typeset
from tests.pages.photographed import photographs

SEEDS = 3
_LINE, _WORD = "4", "5"


def ours(page):
    """Return a prepared page and its text."""
    options = RecognitionOptions()
    prepared = upright_page(1, page, options, lambda _: None)
    return prepared, "\n".join(text for _, text in recognized_lines(prepared, options, print))


def tesseract(grey):
    """Return the lines of Tesseract's own layout, (left, right, baseline), px, and its text."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "page.png")
        cv2.imwrite(str(path), grey)
        command = ["tesseract", str(path), "-", "--psm", "3", "tsv"]
        table = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    rows = [row.split("\t") for row in table.splitlines()]
    lines, words = [], []
    for row in rows:
        left, top, width, height = (
            (int(each) for each in row[6:10]) if row[0] != "level" else [0] * 4
        )
        if row[0] == _LINE:
            # Of all but descenders.
            lines.append((left, left + width, lambda _, y=top + 0.78 * height: y))
            words.append([])
        elif row[0] == _WORD:
            words[-1].append(row[11])
    return lines, "\n".join(" ".join(line) for line in words)


def tau(order):
    """Return Kendall's tau of an order, and how many pieces were not found."""
    found = np.flatnonzero(order >= 0)
    return kendalltau(found, order[found]).statistic, int((order < 0).sum())


def main() -> None:
    """Print a line for each layout and each photograph."""
    for layout in typeset.LAYOUTS:
        figures = []
        for seed in range(SEEDS):
            sheet = typeset.typeset(layout, seed)
            page = Page(sheet.grey, typeset.MM_PER_PIXEL)
            if layout is typeset.leftward:
                # Data for Hebrew are rarely installed: lines count, not their text.
                prepared, text = prepare_page(page, leftward=True), None
            else:
                prepared, text = ours(page)
            lines, theirs = tesseract(sheet.grey)
            errors = [
                math.nan if text is None else character_error_rate(sheet.text, each or "")
                for each in (text, theirs)
            ]
            figures.append(
                (*tau(typeset.prepared_order(sheet, prepared)), errors[0],
                 *tau(typeset.found_order(sheet.pieces, lines)), errors[1])
            )  # fmt: skip
        values = np.mean(figures, axis=0)
        print(
            f"{layout.__name__:14s} ours: tau {values[0]:.3f}, missed {values[1]:.1f}, error "
            f"{values[2]:.3f}; Tesseract: {values[3]:.3f}, {values[4]:.1f}, {values[5]:.3f}",
            flush=True,
        )
    for name, flat, photo in photographs(10):
        truth = "\n".join(line.text for line in flat.lines)
        error = character_error_rate(truth, ours(photo.page)[1])
        theirs = [
            character_error_rate(truth, tesseract(each.page.grey)[1]) for each in (flat, photo)
        ]
        print(f"{name}: ours {error:.3f}, Tesseract flat {theirs[0]:.3f}, photo {theirs[1]:.3f}")


if __name__ == "__main__":
    cv2.setNumThreads(1)
    main()
