"""Processor time of reading a page over that of plain Tesseract.

Run with::

    pytest tests/benchmarks/test_page_cost.py --benchmark-only -n0

Straightening, layout and recognition of nine typeset pages, of five made photographs, and of the
pages in the folder that ``SMARTTOUCH_PAGES`` names, in turn with ``tesseract --psm 3`` on the same
pages; the least of some rounds each, by page, and their median.
"""

import os
import resource
import shutil
import subprocess
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from smarttouch.base.errors import SmartTouchError
from smarttouch.pages.document import open_document
from smarttouch.pages.page_image import Page
from smarttouch.reading.recognition import RecognitionOptions, recognized_lines, upright_page

from ..pages import typeset
from ..pages.photographed import photographs

ROUNDS = 2
TITLE = "Processor time of a page"


def pages(quick):
    """Yield names and pages; one if it is to be quick."""
    # Data for Hebrew are rarely installed.
    layouts = [each for each in typeset.LAYOUTS if each is not typeset.leftward]
    for layout in layouts[:1] if quick else layouts:
        yield layout.__name__, Page(typeset.typeset(layout, 0).grey, typeset.MM_PER_PIXEL)
    if quick:
        return
    for number, (_, _, photo) in enumerate(photographs(5), 1):
        yield f"photograph {number}", photo.page
    folder = os.environ.get("SMARTTOUCH_PAGES")
    for path in sorted(Path(folder).iterdir()) if folder else ():
        try:
            with open_document(path) as document:
                yield path.name, document.page(0)
        except SmartTouchError:
            continue


def cpu_s():
    """Return the processor time of this process and of the programs that it started."""
    of_others = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + of_others.ru_utime + of_others.ru_stime


def ours(page):
    """Return the texts of a page's lines."""
    options = RecognitionOptions()
    prepared = upright_page(1, page, options, lambda _: None)
    return [text for _, text in recognized_lines(prepared, options, lambda _: None)]


def tesseracts(path):
    """Return the text of a page by plain Tesseract, on one thread as ours."""
    return subprocess.run(
        ["tesseract", path, "-", "--psm", "3"],
        check=True,
        capture_output=True,
        env={**os.environ, "OMP_THREAD_LIMIT": "1"},
    ).stdout


@pytest.mark.skipif(shutil.which("tesseract") is None, reason="needs Tesseract")
def test_cost(tmp_path, row, quick):
    file = tmp_path / "page.png"
    ratios = []
    for name, page in pages(quick):
        cv2.imwrite(str(file), page.grey)
        seconds = []
        for _ in range(1 if quick else ROUNDS):
            marks = [cpu_s()]
            read = ours(page)
            marks.append(cpu_s())
            assert tesseracts(file)
            marks.append(cpu_s())
            seconds.append(np.diff(marks))
        assert read
        own_s, plain_s = np.min(seconds, axis=0)
        ratios.append(own_s / plain_s)
        row(TITLE, {"page": name, "ours, s": f"{own_s:.2f}", "Tesseract, s": f"{plain_s:.2f}",
                    "ours over it": f"{ratios[-1]:.2f}"})  # fmt: skip
    row(TITLE, {"page": f"median of {len(ratios)}", "ours over it": f"{np.median(ratios):.2f}"})
    if not quick:
        assert np.median(ratios) < 1.5
