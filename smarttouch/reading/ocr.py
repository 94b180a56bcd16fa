"""Text recognition of images by Tesseract, line by line."""

import itertools
import math
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.reading.tesseract import (
    Layout,
    TooSlowError,
    Word,
    read_orientation,
    read_words,
)

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
_USUAL_TIMEOUT_S = 120.0


@dataclass(frozen=True)
class RecognizedLine:
    """Recognized line of text; empty, with a confidence of 0, if it has no words."""

    text: str
    confidence: float  # in [0, 1], mean over its words, weighted by their lengths
    paragraph: int = 0


@dataclass(frozen=True)
class Recognized:
    """Recognized text of an image, its lines in reading order."""

    lines: tuple[RecognizedLine, ...]

    @property
    def text(self) -> str:
        """All lines, with an empty one between paragraphs."""
        paragraphs = itertools.groupby(self.lines, key=lambda line: line.paragraph)
        return "\n\n".join("\n".join(line.text for line in lines) for _, lines in paragraphs)

    @property
    def confidence(self) -> float:
        """Mean over all lines, in [0, 1], weighted by their lengths; 0 without any."""
        return _mean((line.confidence, line.text) for line in self.lines)


def recognize(
    image: NDArray[np.uint8],
    *,
    languages: str = "eng",
    layout: Layout = Layout.PAGE,
    dpi: float | None = None,
    timeout_s: float = _USUAL_TIMEOUT_S,
) -> Recognized:
    """Recognize the text of an image, (H, W) uint8, dark on bright.

    ``languages`` are codes as in ``eng+deu``. Tesseract does not correct an image: paper should be
    white and evenly lit, and an x about 20 pixels high. Below 10, enlarge it first, unless it is
    blurred.
    """
    words = read_words([image], languages, layout, timeout_s, dpi)
    lines: list[RecognizedLine] = []
    paragraph, last = -1, None
    for place, of_line in itertools.groupby(words, key=lambda word: word.line):
        paragraph += place[:2] != last
        last = place[:2]
        lines.append(_line(list(of_line), paragraph))
    return Recognized(tuple(lines))


def recognize_lines(
    strips: Sequence[NDArray[np.uint8]],
    languages: str = "eng",
) -> list[RecognizedLine]:
    """Recognize strips, (h, W_i) uint8, of one straight line each, by one call of Tesseract.

    Strips are dark on white, from ascenders to descenders; a height of 24 pixels is enough.
    """
    framed = [
        np.pad(strip, math.ceil(STRIP_MARGIN * len(strip)), constant_values=255)
        if strip.size
        else strip
        for strip in strips
    ]
    words: list[list[Word]] = [[] for _ in strips]
    for word in read_words(framed, languages, Layout.LINE, _USUAL_TIMEOUT_S):
        words[word.image].append(word)
    return [_line(each) for each in words]


def upright(
    image: NDArray[np.uint8], languages: str = "eng", timeout_s: float = _USUAL_TIMEOUT_S
) -> int:
    """Return the clockwise rotation that makes a page upright, in degrees; 0 if unsure.

    Tesseract's own judgment counts where it is sure. Where it is not, mostly on pages of a few
    words, the page is read all four ways: the most legible one is right if it is legible enough,
    and clearly more so than the page as it is.
    """
    probe = _busiest(image)
    try:
        turn_deg = read_orientation(probe, timeout_s)
        if turn_deg is not None:
            return turn_deg
        ways = [np.rot90(probe, -turns) for turns in range(4)]
        words = read_words(ways, languages, Layout.BLOCK, timeout_s)
    except TooSlowError:
        # Only pictures and noise take that long.
        return 0
    legible = [
        _mean((word.confidence, word.text) for word in words if word.image == turns)
        for turns in range(4)
    ]
    best = int(np.argmax(legible))
    return 90 * best if legible[best] >= max(LEGIBLE, legible[0] + CLEARER) else 0


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


def _line(words: Sequence[Word], paragraph: int = 0) -> RecognizedLine:
    """Return words as a line, with spaces between them but for Chinese and Japanese."""
    text = ""
    for word in words:
        unspaced = not text or (_is_ideographic(text[-1]) and _is_ideographic(word.text[0]))
        text += word.text if unspaced else f" {word.text}"
    return RecognizedLine(text, _mean((word.confidence, word.text) for word in words), paragraph)


def _is_ideographic(sign: str) -> bool:
    wide = unicodedata.east_asian_width(sign) in "WF"
    return wide and not unicodedata.name(sign, "").startswith("HANGUL")


def _mean(read: Iterable[tuple[float, str]]) -> float:
    """Return the mean confidence of texts, weighted by their lengths; 0 without any."""
    weighted = [(confidence * len(text), len(text)) for confidence, text in read]
    letters = sum(length for _, length in weighted)
    return sum(weight for weight, _ in weighted) / letters if letters else 0.0
