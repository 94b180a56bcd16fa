"""F1 score and time of `separate_ink` on pages with known ink, compared with other methods.

Run ``python -m benchmarks.ink_separation FOLDER``. For each page, the folder contains the image
``NAME_source.png`` and the true ink ``NAME_target.png``, in which ink is black.
"""

import math
import sys
import time
from pathlib import Path

import cv2
import numpy as np
from skimage.filters import threshold_sauvola

from smarttouch.pages.ink import separate_ink

ROUNDS = 10
NOISE = 40
"""Number of test images that contain noise but no ink."""


def closed(grey):
    """Divide a page by an estimate of its paper (morphological closing); apply Otsu's threshold."""
    small = cv2.resize(grey, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    paper = cv2.morphologyEx(small, cv2.MORPH_CLOSE, np.ones((13, 13), np.uint8))
    paper = cv2.resize(cv2.medianBlur(paper, 5), grey.shape[::-1])
    return otsu(np.asarray(cv2.divide(grey, paper, scale=255), np.uint8))


def otsu(grey):
    """Return ink by Otsu's threshold, one for the whole page."""
    return cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY_INV | cv2.THRESH_OTSU)[1] > 0


METHODS = {
    "separate_ink": lambda grey: separate_ink(grey).ink,
    "closed background, Otsu": closed,
    "Otsu": otsu,
    "Sauvola (51 px)": lambda grey: grey <= threshold_sauvola(grey, 51, k=0.15),
}


def sheets_of_noise():
    """Yield images of paper grain, from fine to coarse and from faint to strong."""
    random = np.random.default_rng(1)
    for k in range(NOISE):
        grain = random.normal(0, 1, (500, 700)).astype(np.float32)
        if k % 4:
            grain = cv2.GaussianBlur(grain, (0, 0), k % 4)
        levels = random.uniform(90, 250) + random.uniform(1, 30) * grain / grain.std()
        yield np.clip(levels, 0, 255).astype(np.uint8)


def main() -> None:
    """Print the results of each method; methods take turns, so that delays affect all of them."""
    pages = []
    for source in sorted(Path(sys.argv[1]).glob("*_source.png")):
        target = source.with_name(source.name.replace("_source", "_target"))
        pages.append([cv2.imread(str(each), cv2.IMREAD_GRAYSCALE) for each in (source, target)])
    megapixels = sum(grey.size for grey, _ in pages) / 1e6
    seconds, inks = dict.fromkeys(METHODS, math.inf), {}
    for _ in range(ROUNDS):
        for name, method in METHODS.items():
            start = time.process_time()
            inks[name] = [method(grey) for grey, _ in pages]
            seconds[name] = min(seconds[name], time.process_time() - start)
    for name, method in METHODS.items():
        masks = [(ink, true < 128) for ink, (_, true) in zip(inks[name], pages, strict=True)]
        f = [200 * (ink & true).sum() / max(1, ink.sum() + true.sum()) for ink, true in masks]
        blank = sum(not ink.any() for ink in inks[name])
        inked = sum(bool(method(sheet).any()) for sheet in sheets_of_noise())
        print(
            f"{name:24s} F1 {np.mean(f):5.1f}, worst {min(f):5.1f}, pages without ink {blank}, "
            f"{1000 * seconds[name] / megapixels:5.1f} ms/Mpx, "
            f"ink on {inked} of {NOISE} sheets of noise"
        )


if __name__ == "__main__":
    cv2.setNumThreads(1)
    main()
