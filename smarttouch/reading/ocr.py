"""Text recognition of images by Tesseract, line by line."""

import atexit
import io
import itertools
import math
import os
import queue
import re
import shutil
import subprocess
import tempfile
import threading
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import IO

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from smarttouch.base.errors import ReadingError

LARGEST_SIDE = 32_000  # largest side in pixels; Tesseract refuses images with a side above 32,767
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
    """Tesseract was stopped, as nothing came from it within its time limit."""


class OcrFailedError(ReadingError):
    """Tesseract ended with an error."""


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
            "Tesseract is not installed: apt install tesseract-ocr (or brew install tesseract)"
        )
    return Path(found)


def read_words(
    images: Sequence[NDArray[np.uint8]],
    languages: str,
    layout: Layout,
    timeout_s: float,
) -> Iterator[Word]:
    """Yield the words of images, (H_i, W_i) uint8, dark on bright, in reading order, by one call.

    They come while later images are being recognized. Blank and empty images have no words;
    ``languages`` are codes joined by plus signs.
    """
    if not re.fullmatch(r"\w+(\+\w+)*", languages, re.ASCII):
        raise ReadingError(f"languages {languages!r}: give codes such as eng or eng+deu")
    find_tesseract()
    shown = [index for index, image in enumerate(images) if not _is_blank(image)]
    if not shown:
        return
    options = ["-l", languages, "--psm", str(layout.value)]
    if layout is Layout.LINE:
        # They are dark on white: a poor line is not read again as light on dark.
        options += ["-c", "tessedit_do_invert=0"]
    for row in _run([*options, "tsv"], [images[index] for index in shown], timeout_s):
        cells = row.rstrip("\n").split("\t", _COLUMNS - 1)
        if cells[0] != _WORD or not cells[-1].strip():
            continue
        page, block, paragraph, line = (int(each) for each in cells[1:5])
        confidence = min(max(float(cells[10]) / 100, 0.0), 1.0)
        yield Word(cells[-1].strip(), shown[page - 1], (block, paragraph, line), confidence)


def read_orientation(image: NDArray[np.uint8], timeout_s: float) -> int | None:
    """Return the clockwise rotation of an image in degrees; None if Tesseract is not sure.

    It is never sure of fewer than 50 letters, nor where its data for orientations (osd) are
    missing. It may be wrong where it is: it turned a table of figures by 180°.
    """
    if _is_blank(image):
        return None
    try:
        rows = list(_run(["--psm", "0"], [image], timeout_s))
    except OcrFailedError:
        return None
    turn = re.search(r"^Rotate: (\d+)", "".join(rows), re.MULTILINE)
    sure = re.search(r"^Orientation confidence: ([\d.]+)", "".join(rows), re.MULTILINE)
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
    options: Sequence[str], images: Sequence[NDArray[np.uint8]], timeout_s: float
) -> Iterator[str]:
    """Yield what Tesseract writes about images, line by line."""
    program = find_tesseract()
    with tempfile.TemporaryFile() as given, tempfile.TemporaryFile() as said:
        given.write(_one_file([_fitting(image) for image in images]))
        given.seek(0)
        try:
            running = subprocess.Popen(
                [program, "stdin", "stdout", *options],
                stdin=given,
                stdout=subprocess.PIPE,
                stderr=said,
                # With more threads, most of the time goes into waiting for each other.
                env={**os.environ, "OMP_THREAD_LIMIT": "1"},
                encoding="utf-8",
                errors="replace",
            )
        except OSError as error:
            raise ReadingError(f"{program} does not start: {error.strerror}") from None
        assert running.stdout is not None
        # It is never kept waiting by a slow reader, which would count as its own time.
        rows: queue.SimpleQueue[str] = queue.SimpleQueue()
        written = threading.Thread(target=_put_all, args=(running.stdout, rows), daemon=True)

        def end_it() -> None:
            running.kill()
            written.join()

        # A program may end before its pages do, and no thread may be reading then.
        atexit.register(end_it)
        try:
            written.start()
            # Each image has that time: on a busy computer, a page of many lines takes minutes.
            while row := rows.get(timeout=timeout_s):
                yield row
            status = running.wait()
        except queue.Empty:
            raise TooSlowError(
                f"Tesseract read nothing for {timeout_s:g} s: give it a smaller image"
            ) from None
        finally:
            atexit.unregister(end_it)
            end_it()
            running.stdout.close()
            running.wait()
        said.seek(0)
        _require_success(status, said.read().decode("utf-8", "replace"))


def _put_all(output: IO[str], rows: "queue.SimpleQueue[str]") -> None:
    """Put all lines of an output into a queue, and an empty one at its end."""
    for row in output:
        rows.put(row)
    rows.put("")


def _require_success(status: int, said: str) -> None:
    # Missing ones of several languages do not change its exit status.
    missing = re.search(r"Failed loading language '(.+)'", said)
    if missing is not None:
        package = "tesseract-ocr-" + missing[1].lower().replace("_", "-")
        raise ReadingError(
            f"Tesseract has no data for the language {missing[1]}: apt install {package}"
        )
    if status:
        reason = said.strip().split("\n")[-1] or "no message"
        raise OcrFailedError(f"Tesseract failed with status {status}: {reason}")


STRIP_MARGIN = 0.25
"""White margin around a strip, relative to its height. Over noisy and blurred strips, 1.6 % of the
characters were wrong with it, 3.1 % with 0.15 and 2.3 % with 0.45."""
LEGIBLE = 0.75
"""Least confidence of a text that is upright. Over 44 prints of one to five words
it was 0.78 to 0.97, that of the same prints turned at most 0.87."""
CLEARER = 0.08
"""Least difference of confidence between upright and turned; over the same prints, 0.12."""
_PROBE_SIDE = 1600  # side of the part of a page by which its orientation is determined
_PROBE_GRID = 8  # grid, in pixels, on which that part is placed
_USUAL_TIMEOUT_S, _PROBE_TIMEOUT_S = 120.0, 30.0


@dataclass(frozen=True)
class RecognizedLine:
    """Recognized line of text; empty, with a confidence of 0, if it has no words."""

    text: str
    confidence: float  # in [0, 1], mean over its words, weighted by their lengths


def recognize(
    image: NDArray[np.uint8],
    *,
    languages: str = "eng",
    layout: Layout = Layout.PAGE,
    timeout_s: float = _USUAL_TIMEOUT_S,
) -> str:
    """Return the text of an image, (H, W) uint8, dark on bright, an empty line between paragraphs.

    ``languages`` are codes as in ``eng+deu``. Tesseract does not correct an image: paper should be
    white and evenly lit, and an x about 20 pixels high. Below 10, enlarge it first, unless it is
    blurred.
    """
    words = read_words([image], languages, layout, timeout_s)
    grouped = itertools.groupby(words, key=lambda word: word.line)
    lines = ((place[:2], _line(list(of_line)).text) for place, of_line in grouped)
    paragraphs = itertools.groupby(lines, key=lambda line: line[0])
    return "\n\n".join("\n".join(text for _, text in part) for _, part in paragraphs)


def recognize_lines(
    strips: Sequence[NDArray[np.uint8]], languages: str = "eng"
) -> Iterator[RecognizedLine]:
    """Recognize strips, (h, W_i) uint8, of one straight line each, by one call of Tesseract.

    Strips are dark on white, from ascenders to descenders; a height of 24 pixels is enough. Lines
    come while later ones are being recognized.
    """
    framed = [
        np.pad(strip, math.ceil(STRIP_MARGIN * len(strip)), constant_values=255)
        if strip.size
        else strip
        for strip in strips
    ]
    done = 0
    found = read_words(framed, languages, Layout.LINE, _USUAL_TIMEOUT_S)
    for index, words in itertools.groupby(found, key=lambda word: word.image):
        yield from [_line(())] * (index - done)
        yield _line(list(words))
        done = index + 1
    yield from [_line(())] * (len(strips) - done)


def likely_turns(
    image: NDArray[np.uint8], languages: str = "eng", timeout_s: float = _PROBE_TIMEOUT_S
) -> list[int]:
    """Return clockwise rotations, in degrees, that may make a page upright.

    They are Tesseract's opinion where it is sure. Where it is not, mostly on pages of a few words,
    the page is read all four ways: the most legible one is likely if it is legible enough, and
    clearly more so than the page as it is.
    """
    probe = _busiest(image)
    try:
        turn_deg = read_orientation(probe, timeout_s)
        if turn_deg is not None:
            return [turn_deg] if turn_deg else []
        ways = [np.rot90(probe, -turns) for turns in range(4)]
        words = list(read_words(ways, languages, Layout.BLOCK, timeout_s))
    except TooSlowError:
        # Only pictures and noise take that long.
        return []
    legible = [
        _mean((word.confidence, word.text) for word in words if word.image == turns)
        for turns in range(4)
    ]
    best = int(np.argmax(legible))
    return [90 * best] * (best > 0 and legible[best] >= max(LEGIBLE, legible[0] + CLEARER))


def _busiest(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the part of a page with the most edges, large enough to determine its orientation."""
    height, width = (min(side, _PROBE_SIDE) for side in image.shape)
    if (height, width) == image.shape:
        return image
    edges = cv2.convertScaleAbs(cv2.Laplacian(image, cv2.CV_16S))
    coarse = tuple(max(1, side // _PROBE_GRID) for side in image.shape[::-1])
    edges = cv2.resize(edges, coarse, interpolation=cv2.INTER_AREA)
    part = (max(1, width // _PROBE_GRID), max(1, height // _PROBE_GRID))
    around = cv2.boxFilter(edges, cv2.CV_32F, part, borderType=cv2.BORDER_CONSTANT)
    row, column = np.unravel_index(int(np.argmax(around)), around.shape)
    top = min(max(0, int(row) * _PROBE_GRID - height // 2), image.shape[0] - height)
    left = min(max(0, int(column) * _PROBE_GRID - width // 2), image.shape[1] - width)
    return image[top : top + height, left : left + width]


def _line(words: Sequence[Word]) -> RecognizedLine:
    """Return words as a line, with spaces between them but for Chinese and Japanese."""
    text = ""
    for word in words:
        unspaced = not text or (_is_ideographic(text[-1]) and _is_ideographic(word.text[0]))
        text += word.text if unspaced else f" {word.text}"
    return RecognizedLine(text, _mean((word.confidence, word.text) for word in words))


def _is_ideographic(sign: str) -> bool:
    wide = unicodedata.east_asian_width(sign) in "WF"
    return wide and not unicodedata.name(sign, "").startswith("HANGUL")


def _mean(read: Iterable[tuple[float, str]]) -> float:
    """Return the mean confidence of texts, weighted by their lengths; 0 without any."""
    weighted = [(confidence * len(text), len(text)) for confidence, text in read]
    letters = sum(length for _, length in weighted)
    return sum(weight for weight, _ in weighted) / letters if letters else 0.0
