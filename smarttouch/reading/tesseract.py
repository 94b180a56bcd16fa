"""Tesseract, the command-line program: words of images."""

import io
import os
import re
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from smarttouch.errors import ReadingError

LARGEST_SIDE = 32_000
"""Largest side in pixels; Tesseract refuses images with a side above 32,767."""
SURE = 2.0
"""Least confidence by Tesseract of an orientation. It was at most 1.1 where the answer was wrong
(of photographs without text), and at least 3 on pages of five lines and more, however noisy."""
_WORD = "5"
"""Level of a word's row in Tesseract's table; others are pages, blocks, paragraphs and lines."""
_COLUMNS = 12
"""Columns of Tesseract's table: level, page, block, paragraph, line, word, left, top, width,
height, confidence, text.
"""


class Layout(Enum):
    """Layout of an image: Tesseract's page segmentation modes."""

    PAGE = 3
    BLOCK = 6
    LINE = 7


class TooSlowError(ReadingError):
    """Tesseract was stopped after its time limit."""


@dataclass(frozen=True)
class Word:
    """A word, with its image and its place in it."""

    text: str
    image: int
    line: tuple[int, int, int]  # block, paragraph of the block, line of the paragraph
    confidence: float  # in [0, 1]


def find_tesseract() -> Path:
    """Return the path of the program."""
    found = shutil.which("tesseract")
    if found is None:
        raise ReadingError(
            "Tesseract is not installed: apt install tesseract-ocr (or brew install tesseract)",
            about="tesseract",
            remedy="apt install tesseract-ocr",
        )
    return Path(found)


def read_words(
    images: Sequence[NDArray[np.uint8]],
    languages: str,
    layout: Layout,
    timeout_s: float,
    dpi: float | None = None,
) -> list[Word]:
    """Return the words of images, (H_i, W_i) uint8, dark on bright, in reading order, by one call.

    Blank and empty images have no words; ``languages`` are codes joined by plus signs.
    """
    if not re.fullmatch(r"\w+(\+\w+)*", languages, re.ASCII):
        raise ReadingError(
            f"languages {languages!r}: give codes such as eng or eng+deu", about="languages"
        )
    find_tesseract()
    shown = [index for index, image in enumerate(images) if not _is_blank(image)]
    if not shown:
        return []
    options = ["-l", languages, "--psm", str(layout.value)]
    if dpi is not None:
        options += ["--dpi", f"{dpi:.0f}"]
    file = _one_file([_fitting(images[index]) for index in shown])
    done = _run(["stdin", "stdout", *options, "tsv"], file, timeout_s)
    _require_success(done)
    words = []
    for row in done.stdout.split("\n"):
        cells = row.split("\t", _COLUMNS - 1)
        if cells[0] != _WORD or not cells[-1].strip():
            continue
        page, block, paragraph, line = (int(each) for each in cells[1:5])
        confidence = min(max(float(cells[10]) / 100, 0.0), 1.0)
        words.append(Word(cells[-1].strip(), shown[page - 1], (block, paragraph, line), confidence))
    return words


def read_orientation(image: NDArray[np.uint8], timeout_s: float) -> int | None:
    """Return the clockwise rotation of an image in degrees; None if Tesseract is not sure.

    It is never sure of fewer than 50 letters, nor where its data for orientations (osd) are
    missing.
    """
    find_tesseract()
    if _is_blank(image):
        return None
    output = _run(["stdin", "stdout", "--psm", "0"], _one_file([_fitting(image)]), timeout_s).stdout
    turn = re.search(r"^Rotate: (\d+)", output, re.MULTILINE)
    sure = re.search(r"^Orientation confidence: ([\d.]+)", output, re.MULTILINE)
    if turn is None or sure is None or float(sure[1]) < SURE:
        return None
    return int(turn[1])


def _is_blank(image: NDArray[np.uint8]) -> bool:
    return not image.size or bool(image.min() == image.max())


def _fitting(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an image made smaller if a side of it is too long for Tesseract."""
    scale = LARGEST_SIDE / max(image.shape)
    if scale >= 1:
        return image
    height, width = (max(1, round(side * scale)) for side in image.shape)
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def _one_file(images: Sequence[NDArray[np.uint8]]) -> bytes:
    """Return a TIFF with an image on each page."""
    pages = [Image.fromarray(np.ascontiguousarray(image)) for image in images]
    file = io.BytesIO()
    pages[0].save(file, "TIFF", save_all=True, append_images=pages[1:])
    return file.getvalue()


def _run(
    arguments: Sequence[str], data: bytes, timeout_s: float
) -> "subprocess.CompletedProcess[str]":
    program = find_tesseract()
    try:
        done = subprocess.run(
            [program, *arguments],
            input=data,
            capture_output=True,
            timeout=timeout_s,
            # With more threads, most of the time goes into waiting for each other.
            env={**os.environ, "OMP_THREAD_LIMIT": "1"},
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise TooSlowError(
            f"Tesseract did not finish within {timeout_s:g} s: give it a smaller image",
            about="tesseract",
        ) from None
    except OSError as error:
        raise ReadingError(
            f"{program} does not start: {error.strerror}", about="tesseract"
        ) from None
    out, errors = (each.decode("utf-8", "replace") for each in (done.stdout, done.stderr))
    return subprocess.CompletedProcess(done.args, done.returncode, out, errors)


def _require_success(done: "subprocess.CompletedProcess[str]") -> None:
    # Missing ones of several languages do not change its exit status.
    missing = re.search(r"Failed loading language '(.+)'", done.stderr)
    if missing is not None:
        package = "tesseract-ocr-" + missing[1].lower().replace("_", "-")
        raise ReadingError(
            f"Tesseract has no data for the language {missing[1]}: apt install {package}",
            about="languages",
            remedy=f"apt install {package}",
        )
    if done.returncode:
        reason = done.stderr.strip().split("\n")[-1] or "no message"
        raise ReadingError(
            f"Tesseract failed with status {done.returncode}: {reason}", about="tesseract"
        )
