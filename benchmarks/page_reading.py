"""Comparison of SmartTouch with Tesseract on the same pages: text, reading order and CPU time.

``python -m benchmarks.page_reading --seed N --jobs 2`` reads eleven layouts, flat, scanned and
photographed. ``--folder DIR`` reads the pages of a folder. Their true text is in ``PAGE.txt`` or
``PAGE.gold.txt``; a page without such a file is compared with Tesseract's text.
"""

import argparse
import os
import re
import resource
import subprocess
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import cv2
import numpy as np
from scipy.stats import kendalltau

from benchmarks.page_layouts import LAYOUTS, MEDIA, page_of
from smarttouch.base.errors import SmartTouchError
from smarttouch.pages.document import Document
from smarttouch.reading.legibility import character_error_rate, normalize
from smarttouch.reading.recognition import RecognitionOptions, recognized_lines, upright_page


@dataclass(frozen=True)
class Figures:
    """Results of a page, as pairs (SmartTouch, Tesseract); order is NaN if lines are unknown."""

    name: str
    medium: str
    error: tuple[float, float]
    order: tuple[float, float]
    cpu_s: tuple[float, float]


def cpu_s():
    """Return the CPU time of this process and of its finished child processes."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def ours(page):
    """Return the text of a page as SmartTouch reads it."""
    options = RecognitionOptions()
    prepared = upright_page(1, page, options, lambda _: None)
    return "\n".join(text for _, text in recognized_lines(prepared, options, lambda _: None))


def tesseracts(page):
    """Return the text of a page as Tesseract reads it by itself, on one thread."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "page.png")
        cv2.imwrite(str(path), page.grey, [cv2.IMWRITE_PNG_COMPRESSION, 0])
        environment = {**os.environ, "OMP_THREAD_LIMIT": "1"}
        return subprocess.run(
            ["tesseract", path, "-", "--psm", "3"],
            check=True, capture_output=True, text=True, env=environment,
        ).stdout  # fmt: skip


def plain(text):
    """Return a normalized text without dot leaders and rules."""
    return normalize(re.sub(r"([.·…,:_]\s*){3,}", " ", text))


def order_of(pieces, text):
    """Locate lines in a text by their words; return Kendall's tau of their order (1: correct)."""
    read = plain(text).split()
    places = []
    for piece in pieces:
        words = plain(piece).split()
        hits = np.isin(read, words).astype(float)
        if hits.any():
            window = np.convolve(hits, np.ones(len(words)))[len(words) - 1 :]
            if window.max() >= max(1, len(words) / 2):
                places.append(int(window.argmax()))
    return float(kendalltau(range(len(places)), places).statistic) if len(places) > 1 else 0.0


def measured(name, medium, page, truth, pieces=()):
    """Return the results of a page; without a true text, Tesseract's text is the reference."""
    marks, texts = [cpu_s()], []
    for read in (ours, tesseracts):
        texts.append(read(page))
        marks.append(cpu_s())
    error = [character_error_rate(plain(truth or texts[1]), plain(text)) for text in texts]
    order = [order_of(pieces, text) if pieces else np.nan for text in texts]
    return Figures(name, medium, tuple(error), tuple(order), tuple(np.diff(marks)))


def typeset(task):
    """Return the results of the typeset page of a layout, medium and seed."""
    layout, medium, seed = task
    page, pieces = page_of(layout, medium, seed)
    return measured(layout.__name__, medium, page, "\n".join(pieces), pieces)


def real(path):
    """Return the results of the first page of a file; None if the file cannot be opened."""
    try:
        with Document(path) as document:
            page = document.page(0)
    except SmartTouchError:
        return None
    truths = [each for end in (".txt", ".gold.txt") if (each := path.with_suffix(end)).exists()]
    truth = truths[0].read_text() if truths else None
    return measured(path.name, "real" if truth else "compared", page, truth)


def main():
    """Print the results of each page, and a summary of each medium."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, nargs="+", default=[0])
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--folder", type=Path)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    tasks = [*product(LAYOUTS, MEDIA, options.seed)]
    work, tasks = (real, sorted(options.folder.iterdir())) if options.folder else (typeset, tasks)
    found = []
    with ProcessPoolExecutor(options.jobs, initializer=cv2.setNumThreads, initargs=(1,)) as pool:
        for each in filter(None, pool.map(work, tasks)):
            found.append(each)
            print(
                f"{each.name:18s}{each.medium:13s} (Tesseract in brackets): "
                f"error {each.error[0]:.3f} ({each.error[1]:.3f}), "
                f"order {each.order[0]:.3f} ({each.order[1]:.3f}), "
                f"CPU time relative to Tesseract {each.cpu_s[0] / each.cpu_s[1]:.2f}",
                flush=True,
            )
    for medium in dict.fromkeys(each.medium for each in found):
        figures = [each for each in found if each.medium == medium]
        error, order, cost = (
            np.array([getattr(each, name) for each in figures])
            for name in ("error", "order", "cpu_s")
        )
        nine = np.quantile(error, 0.9, axis=0, method="higher")
        print(
            f"{medium}, {len(figures)} pages (Tesseract in brackets): mean error "
            f"{error[:, 0].mean():.3f} ({error[:, 1].mean():.3f}), median error "
            f"{np.median(error[:, 0]):.3f}, 90 % quantile {nine[0]:.3f}; mean order "
            f"{order[:, 0].mean():.3f} ({order[:, 1].mean():.3f}); "
            f"median CPU time relative to Tesseract {np.median(cost[:, 0] / cost[:, 1]):.2f}"
        )


if __name__ == "__main__":
    main()
