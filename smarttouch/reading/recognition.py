"""Text recognition by Tesseract, and the orientation of pages."""

import atexit
import contextlib
import itertools
import math
import os
import re
import shutil
import subprocess
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import PageError, ReadingError
from smarttouch.braille.dot_detection import shows_dots
from smarttouch.pages.ink import separate_ink
from smarttouch.pages.page_and_lines import Page
from smarttouch.pages.prepared_page import PreparedPage, prepare_page

Note = Callable[[str], None]
Read = tuple[str, float]
"""Recognized text of a line, and the mean confidence of its words in [0, 1]."""

PAGE, BLOCK, _LINE = 3, 6, 7  # page segmentation modes of Tesseract
LARGEST_SIDE = 32_000  # largest side, pixels; Tesseract's limit is 32,767
_TIMEOUT_S, _IMAGE_TIMEOUT_S = 120.0, 10.0  # time limit of a call, and extra time for each strip
_WORD, _COLUMNS = "5", 12
"""In Tesseract's table: the value of column ``level`` in rows of words, and the number of columns:
level, page, block, paragraph, line, word, left, top, width, height, confidence and text."""
STRIP_MARGIN = 0.25
"""White margin around a strip, relative to its height. On noisy and blurred strips, this value
caused fewer errors than 0.15 and 0.45."""
_STRIP_PX, _NARROWER = 32, 0.85
"""Lines are scaled to this height, ascender to descender, for recognition. Then their width is
multiplied by `_NARROWER`. Larger images take longer, and recognition is not better."""
SURE = 0.6  # mean confidence below which a warning is given
_LEFTWARD = frozenset(["ara", "div", "fas", "heb", "kur", "pus", "snd", "syr", "uig", "urd", "yid"])
"""Tesseract's codes of languages written from right to left."""
_FIRST, _LONGEST = 5, 3  # the first 5 and the longest 3 lines decide the orientation
_UPRIGHT, _FEWEST_LETTERS = 0.7, 30
"""A page counts as upright if mean confidence and number of letters are at least these values."""
_MORE = 1.15  # a page is turned only if the number of recognized letters rises by this factor


@dataclass(frozen=True)
class RecognitionOptions:
    """Options of a document: pages, such as ``1,3-5``, scale, polarity and text recognition."""

    pages: str | None = None
    dpi: float | None = None
    page_width_mm: float | None = None
    password: str | None = None
    light_on_dark: bool | None = None
    languages: str = "eng"
    keep_headers: bool = False  # whether to keep running heads and page numbers


def recognize(
    image: NDArray[np.uint8],
    languages: str = "eng",
    layout: int = PAGE,
    timeout_s: float = _TIMEOUT_S,
) -> str:
    """Recognize the lines of text on an image, (H, W) uint8, dark on bright.

    ``languages`` are codes such as ``eng+deu``. ``layout`` is `PAGE` or `BLOCK`. Paper should be
    white and evenly lit. An x-height of about 20 pixels is best. Enlarge a sharp image if its
    x-height is below 10 pixels.
    """
    lines = itertools.groupby(_words([image], languages, layout, timeout_s), lambda row: row[1:5])
    return "\n".join(_joined(words)[0] for _, words in lines)


def recognize_lines(strips: Sequence[NDArray[np.uint8]], languages: str = "eng") -> list[Read]:
    """Recognize strips, (h, W_i) uint8, in one call of Tesseract. A strip shows one straight line.

    Strips are dark on white, from ascender to descender; a height of 24 pixels is sufficient.
    """
    framed = [
        np.pad(strip, math.ceil(STRIP_MARGIN * len(strip)), constant_values=255) for strip in strips
    ]
    timeout_s = _TIMEOUT_S + _IMAGE_TIMEOUT_S * len(framed)
    words = _words(framed, languages, _LINE, timeout_s)
    lines = {int(page): _joined(row) for page, row in itertools.groupby(words, lambda row: row[1])}
    return [lines.get(index, ("", 0.0)) for index in range(len(strips))]


def _words(
    images: Sequence[NDArray[np.uint8]], languages: str, layout: int, timeout_s: float
) -> list[list[str]]:
    """Return those rows of Tesseract's table that describe words. Column 1 of a row is changed to
    the index of the image that shows the word."""
    if not re.fullmatch(r"\w+(\+\w+)*", languages, re.ASCII):
        raise ReadingError(f"languages {languages!r}: give codes such as eng or eng+deu")
    shown = [k for k, image in enumerate(images) if image.size and image.min() < image.max()]
    if not shown:
        return []
    options = ["-l", languages, "--psm", str(layout), "tsv"]
    if layout == _LINE:
        # Strips are dark on white, so do not try light on dark.
        options[:0] = ["-c", "tessedit_do_invert=0"]
    pages = [_fitting(images[k]) for k in shown]
    # OpenCV writes a TIFF several times as fast as Pillow.
    _, file = cv2.imencodemulti(".tiff", pages, [cv2.IMWRITE_TIFF_COMPRESSION, 1])
    table = _run_tesseract(options, file.tobytes(), timeout_s)
    rows = [line.split("\t", _COLUMNS - 1) for line in table.split("\n")]
    words = [row for row in rows if row[0] == _WORD and row[-1].strip()]
    for row in words:
        row[1] = str(shown[int(row[1]) - 1])
    return words


def _fitting(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an image, scaled down if a side is too long for Tesseract."""
    scale = LARGEST_SIDE / max(image.shape)
    if scale >= 1:
        return np.ascontiguousarray(image)
    height, width = (max(1, round(side * scale)) for side in image.shape)
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def _run_tesseract(options: Sequence[str], image: bytes, timeout_s: float) -> str:
    """Run Tesseract on an image; return its output."""
    program = shutil.which("tesseract")
    if program is None:
        raise ReadingError(
            "Tesseract is not installed: apt install tesseract-ocr (or brew install tesseract)"
        )
    try:
        running = subprocess.Popen(
            [program, "stdin", "stdout", *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            # More threads of OpenMP would mostly wait for each other.
            env={**os.environ, "OMP_THREAD_LIMIT": "1"},
        )
    except OSError as error:
        raise ReadingError(f"{program} does not start: {error.strerror}") from None
    with running:
        # Kill Tesseract at exit: a thread that waits for it would keep this program alive.
        atexit.register(running.kill)
        try:
            output, messages = (stream.decode("utf-8", "replace")
                            for stream in running.communicate(image, timeout_s))  # fmt: skip
        except subprocess.TimeoutExpired:
            raise ReadingError(
                f"Tesseract did not finish within {timeout_s:g} s: give a smaller image"
            ) from None
        finally:
            atexit.unregister(running.kill)
            running.kill()
    # If one of several languages is missing, the exit status is still 0.
    missing = re.search(r"Failed loading language '(.+)'", messages)
    if missing is not None:
        package = "tesseract-ocr-" + missing[1].lower().replace("_", "-")
        raise ReadingError(
            f"Tesseract has no data for the language {missing[1]}: apt install {package}"
        )
    if running.returncode:
        reason = messages.strip().split("\n")[-1] or "no message"
        raise ReadingError(f"Tesseract failed with status {running.returncode}: {reason}")
    return output


def _joined(words: Iterable[list[str]]) -> Read:
    """Join words to a line, with spaces between words except in Chinese and Japanese."""
    text, sure, letters = "", 0.0, 0
    for row in words:
        word = row[-1].strip()
        unspaced = not text or (_is_ideographic(text[-1]) and _is_ideographic(word[0]))
        text += word if unspaced else f" {word}"
        sure += len(word) * min(max(float(row[10]) / 100, 0.0), 1.0)
        letters += len(word)
    return text, sure / letters


def _is_ideographic(sign: str) -> bool:
    wide = unicodedata.east_asian_width(sign) in "WF"
    return wide and not unicodedata.name(sign, "").startswith("HANGUL")


def upright_page(number: int, page: Page, options: RecognitionOptions, note: Note) -> PreparedPage:
    """Return a straight and upright page, ink on white paper, with lines in reading order.

    If the file contains the text, the page is not turned. Raises PageError for pictures of Braille.
    """
    for words in page.notes:
        note(f"page {number}: {words}")
    if page.lines:
        ink = separate_ink(page.grey, options.light_on_dark)
        return PreparedPage(page, ink.cleaned, page.lines, ink.light_on_dark, (), page.words)
    prepared, turn_deg = _turned(page, 0, options), 0
    # Without Tesseract, keep the orientation of the page.
    with contextlib.suppress(ReadingError):
        _recognize(prepared, range(len(prepared.lines)), options)
    legible, letters = _legible(prepared.known.values())
    if letters < _FEWEST_LETTERS or legible < _UPRIGHT * letters:
        if shows_dots(page.grey):
            raise PageError(
                f"page {number} shows Braille dots, and pictures of Braille cannot be read: give a "
                "text or a .brf file, or list only the other pages, for example ?pages=1-3"
            )
        with contextlib.suppress(ReadingError):
            prepared, turn_deg = _most_legible(page, prepared, options)
    notes = list(prepared.notes)
    if turn_deg:
        notes.insert(0, f"the page was turned by {turn_deg}° to be upright")
    for words in notes:
        note(f"page {number}: {words}")
    return prepared


def _most_legible(
    page: Page, prepared: PreparedPage, options: RecognitionOptions
) -> tuple[PreparedPage, int]:
    """Turn the page so that most letters are recognized. Return the page and its clockwise
    rotation, degrees."""
    best, most_legible = (prepared, 0), _sampled(prepared, options)
    for turn_deg in (90, 180, 270):
        candidate = _turned(page, turn_deg, options)
        legible = _sampled(candidate, options)
        if legible > _MORE * most_legible:
            best, most_legible = (candidate, turn_deg), legible
    return best


def _turned(page: Page, turn_deg: int, options: RecognitionOptions) -> PreparedPage:
    page = replace(page, grey=np.ascontiguousarray(np.rot90(page.grey, -turn_deg // 90)))
    leftward = options.languages.partition("+")[0] in _LEFTWARD
    return prepare_page(page, options.light_on_dark, leftward=leftward)


def _sampled(prepared: PreparedPage, options: RecognitionOptions) -> float:
    """Return the number of letters recognized in a sample of lines, weighted by confidence."""
    lines = prepared.lines
    longest = sorted(range(len(lines)), key=lambda k: lines[k].left_mm - lines[k].right_mm)
    sample = sorted({*range(min(_FIRST, len(lines))), *longest[:_LONGEST]})
    _recognize(prepared, sample, options)
    return _legible(prepared.known[k] for k in sample)[0]


def _recognize(prepared: PreparedPage, indices: Iterable[int], options: RecognitionOptions) -> None:
    """Recognize those of the given lines that are not recognized yet, in one call of Tesseract."""
    unknown = [k for k in indices if k not in prepared.known]
    read = recognize_lines([_strip(prepared, k) for k in unknown], options.languages)
    prepared.known.update(zip(unknown, read, strict=True))


def _strip(prepared: PreparedPage, index: int) -> NDArray[np.uint8]:
    strip = prepared.strip(index, _STRIP_PX)
    size = (max(1, round(_NARROWER * strip.shape[1])), _STRIP_PX)
    return np.asarray(cv2.resize(strip, size, interpolation=cv2.INTER_AREA), np.uint8)


def _legible(read: Iterable[Read]) -> tuple[float, int]:
    """Return the number of recognized letters twice: weighted by confidence, and unweighted."""
    known = list(read)
    return sum(len(text) * sure for text, sure in known), sum(len(text) for text, _ in known)


def recognized_lines(
    prepared: PreparedPage, options: RecognitionOptions, note: Note
) -> Iterator[tuple[int, str]]:
    """Yield the index and the text of each line of a page."""
    if prepared.words:
        yield from enumerate(prepared.words)
        return
    _recognize(prepared, range(len(prepared.lines)), options)
    for index in range(len(prepared.lines)):
        yield index, prepared.known[index][0]
    legible, letters = _legible(prepared.known.values())
    sure = legible / max(1, letters)
    if sure < SURE:
        note(
            f"the text was recognized with only {sure:.0%} confidence: if it is print in another "
            f"language than {options.languages}, add for example ?languages=deu to the file's name"
        )
