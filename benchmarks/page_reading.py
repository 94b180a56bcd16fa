"""Text, order and cost of pages as read, beside plain Tesseract on the same pages.

Run ``python -m benchmarks.page_reading --seed N --jobs 2``: each layout flat, scanned and
photographed.
"""

import argparse
import os
import re
import resource
import subprocess
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path

import cv2
import numpy as np
from scipy.stats import kendalltau

from benchmarks.page_layouts import LAYOUTS, MEDIA, page_of
from smarttouch.reading.legibility import character_error_rate, normalize
from smarttouch.reading.recognition import RecognitionOptions, recognized_lines, upright_page


def cpu_s():
    """Return the processor time of this process and of the programs that it started."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def ours(page):
    """Return the text of a page."""
    options = RecognitionOptions()
    prepared = upright_page(1, page, options, lambda _: None)
    return "\n".join(text for _, text in recognized_lines(prepared, options, lambda _: None))


def tesseracts(page):
    """Return the text of a page by plain Tesseract, on one thread as ours."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "page.png")
        cv2.imwrite(str(path), page.grey, [cv2.IMWRITE_PNG_COMPRESSION, 0])
        environment = {**os.environ, "OMP_THREAD_LIMIT": "1"}
        return subprocess.run(
            ["tesseract", path, "-", "--psm", "3"],
            check=True, capture_output=True, text=True, env=environment,
        ).stdout  # fmt: skip


def plain(text):
    """Return a text without leaders and rules."""
    return normalize(re.sub(r"([.·…,:_]\s*){3,}", " ", text))


def order_of(pieces, text):
    """Return Kendall's tau of the places where most words of each line are found in a text."""
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


def measured(task):
    """Return errors, order and processor times of a layout, medium and seed, (3, 2).

    Ours comes first, then Tesseract's.
    """
    page, pieces = page_of(*task)
    marks, texts = [cpu_s()], []
    for read in (ours, tesseracts):
        texts.append(read(page))
        marks.append(cpu_s())
    truth = plain("\n".join(pieces))
    errors = [character_error_rate(truth, plain(text)) for text in texts]
    return np.array([errors, [order_of(pieces, text) for text in texts], np.diff(marks)])


def main():
    """Print a line for each page, and one for each medium."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, nargs="+", default=[0])
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    tasks = [*product(LAYOUTS, MEDIA, options.seed)]
    found = {medium: [] for medium in MEDIA}
    with ProcessPoolExecutor(options.jobs, initializer=cv2.setNumThreads, initargs=(1,)) as pool:
        for (layout, medium, _), figures in zip(tasks, pool.map(measured, tasks), strict=True):
            found[medium].append(figures)
            (error, theirs), (order, _), (took_s, their_s) = figures
            print(f"{layout.__name__:14s}{medium:13s} error {error:.3f} ({theirs:.3f})", end=" ")
            print(f"order {order:.3f} time {took_s / their_s:.2f}", flush=True)
    for medium, figures in found.items():
        error, order, cost_s = np.stack(figures, axis=1)
        nine = np.quantile(error, 0.9, axis=0, method="higher")
        print(
            f"{medium}, {len(figures)} pages (Tesseract): mean error {error[:, 0].mean():.3f} "
            f"({error[:, 1].mean():.3f}), nine of ten at most {nine[0]:.3f}; "
            f"order {order[:, 0].mean():.3f} ({order[:, 1].mean():.3f}); "
            f"time {np.median(cost_s[:, 0] / cost_s[:, 1]):.2f}"
        )


if __name__ == "__main__":
    main()
