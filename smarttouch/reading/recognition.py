"""Recognition of a page of print: options, the turn that makes it upright, its lines as text."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import PageError, ReadingError
from smarttouch.braille.dot_detection import shows_dots
from smarttouch.pages.ink import separate_ink
from smarttouch.pages.page_image import Page
from smarttouch.pages.pdf_text import PdfPage
from smarttouch.pages.prepared_page import DOUBTFUL, LEFT_OUT, PreparedPage, prepare_page
from smarttouch.pages.straighten import QUARTER
from smarttouch.reading.ocr import likely_turns, recognize_lines

_STRIP_PIXELS = (32, 56)  # range of the height of lines for recognition: ascender to descender
SURE = 0.6  # mean confidence below which a page is reported as poorly recognized

Note = Callable[[str], None]


@dataclass(frozen=True)
class RecognitionOptions:
    """Pages of a document, such as ``1,3-5``, their scale and polarity, and recognition of text."""

    pages: str | None = None
    dpi: float | None = None
    page_width_mm: float | None = None
    password: str | None = None
    light_on_dark: bool | None = None
    languages: str = "eng"
    keep_headers: bool = False  # running heads and page numbers stay in a text


def upright_page(number: int, page: Page, options: RecognitionOptions, note: Note) -> PreparedPage:
    """Return a page straight and upright, ink on white paper, its lines in reading order.

    A page that brings its text is so already. A picture of Braille is refused.
    """
    if isinstance(page, PdfPage):
        for words in page.notes:
            note(f"page {number}: {words}")
    if isinstance(page, PdfPage) and page.lines:
        ink = separate_ink(page.grey, options.light_on_dark)
        return PreparedPage(page, ink.cleaned, page.lines, ink.light_on_dark, (), page.words)
    if shows_dots(page.grey):
        raise PageError(
            f"page {number} shows Braille dots, and pictures of Braille are not read: give a text "
            "or a .brf file, or leave the page out as in ?pages=1-3"
        )
    prepared, turn_deg = _most_legible(_prepared(page, options), options)
    notes = list(prepared.notes)
    if turn_deg:
        notes.insert(0, f"it was turned by {turn_deg}° to be upright")
    for words in notes:
        note(f"page {number}: {words}")
    return prepared


_LEFTWARD = frozenset(["ara", "div", "fas", "heb", "kur", "pus", "snd", "syr", "uig", "urd", "yid"])
"""Tesseract's codes of languages that are read from the right."""
_FIRST, _LONGEST = 5, 3  # first lines, and longest ones, by which a page is known to be upright
_UPRIGHT, _FEWEST_LETTERS = 0.7, 30
"""Mean confidence of letters from which a page is upright, and the fewest that show it."""
_MANY_LETTERS, _CLEARLY_MORE = 100, 1.5
"""Letters of the sample, and factor by which it is more legible than upside down, from which no
other turn is tried."""
_MORE = 1.15  # factor by which more must be recognized after a turn for it to be kept


def _most_legible(prepared: PreparedPage, options: RecognitionOptions) -> tuple[PreparedPage, int]:
    """Return a page turned so that most of it is recognized, and that turn in degrees, clockwise.

    A few of its lines are read, as part of the page. Only where they are hardly legible they are
    read upside down, and other turns tried.
    """
    try:
        best, most = _with_sample(prepared, options)
        letters = sum(len(text) for text, _ in best.known.values())
        if letters >= _FEWEST_LETTERS and most >= _UPRIGHT * letters:
            return best, 0
        best_turn_deg = 0
        for turn_deg in _turns_to_try(prepared, list(best.known), most, options):
            turned = np.ascontiguousarray(np.rot90(prepared.page.grey, -turn_deg // 90))
            page = replace(prepared.page, grey=turned)
            candidate = _prepared(page, options, quarter=False)
            candidate, legible = _with_sample(candidate, options)
            if legible > _MORE * most:
                best, most, best_turn_deg = candidate, legible, turn_deg
    except ReadingError:
        # Without Tesseract a page stays as it is.
        return prepared, 0
    if not best_turn_deg:
        return best, 0
    notes = [
        words for words in prepared.notes if words != DOUBTFUL and not words.startswith(LEFT_OUT)
    ]
    if QUARTER in notes:
        # That turn was a guess, counterclockwise.
        notes.remove(QUARTER)
        best_turn_deg = (best_turn_deg - 90) % 360
    return replace(best, notes=(*notes, *best.notes)), best_turn_deg


def _prepared(page: Page, options: RecognitionOptions, quarter: bool = True) -> PreparedPage:
    leftward = options.languages.partition("+")[0] in _LEFTWARD
    return prepare_page(page, options.light_on_dark, quarter=quarter, leftward=leftward)


def _turns_to_try(
    prepared: PreparedPage, sample: list[int], legible: float, options: RecognitionOptions
) -> list[int]:
    """Return clockwise turns, in degrees, by which more of a page may be legible."""
    strips = [_strip(prepared, index)[::-1, ::-1] for index in sample]
    read = list(recognize_lines(strips, options.languages))
    upside_down, letters = _legible((each.text, each.confidence) for each in read)
    turns = [180] if upside_down > _MORE * legible else []
    if letters >= _FEWEST_LETTERS and upside_down > _UPRIGHT * letters and turns:
        return turns
    if QUARTER in prepared.notes:
        # That turn was a guess.
        turns.append(90)
    elif letters >= _MANY_LETTERS and legible > _CLEARLY_MORE * upside_down:
        # It is upright, and hard to read.
        return []
    others = likely_turns(prepared.cleaned, options.languages)
    return turns + [each for each in others if each not in (180, *turns)]


def _with_sample(prepared: PreparedPage, options: RecognitionOptions) -> tuple[PreparedPage, float]:
    """Return a page with a few lines recognized, the others being so by the same call, and the
    number of legible letters in them."""
    lines = prepared.lines
    longest = sorted(range(len(lines)), key=lambda k: lines[k].left_mm - lines[k].right_mm)
    sample = sorted({*range(min(_FIRST, len(lines))), *longest[:_LONGEST]})
    others = sorted(set(range(len(lines))) - set(sample))
    found = _read(prepared, [*sample, *others], options)
    known = dict(zip(sample, islice(found, len(sample)), strict=True))
    return replace(prepared, known=known, others=found), _legible(known.values())[0]


def _read(
    prepared: PreparedPage, indices: list[int], options: RecognitionOptions
) -> Iterator[tuple[str, float]]:
    """Yield texts of lines of a page, with a confidence in [0, 1], as they are recognized."""
    strips = [_strip(prepared, index) for index in indices]
    for line in recognize_lines(strips, options.languages):
        yield line.text, line.confidence


def _strip(prepared: PreparedPage, index: int) -> NDArray[np.uint8]:
    """Return a line for recognition, as fine as the page if that is fine enough."""
    line_px = round(prepared.lines[index].height_mm / prepared.page.mm_per_pixel)
    return prepared.strip(index, min(max(line_px, _STRIP_PIXELS[0]), _STRIP_PIXELS[1]))


def _legible(read: Iterable[tuple[str, float]]) -> tuple[float, int]:
    """Return the number of letters, each counted by its confidence, and their number."""
    found = [(len(text) * confidence, len(text)) for text, confidence in read]
    return sum(sure for sure, _ in found), sum(letters for _, letters in found)


def recognized_lines(
    prepared: PreparedPage, options: RecognitionOptions, note: Note
) -> Iterator[tuple[int, str]]:
    """Yield numbers and texts of the lines of a page; the first of them early."""
    if prepared.words:
        yield from enumerate(prepared.words)
        return
    known = prepared.known
    waiting = [index for index in range(len(prepared.lines)) if index not in known]
    found = prepared.others if prepared.others is not None else _read(prepared, waiting, options)
    for index in range(len(prepared.lines)):
        if index not in known:
            known[index] = next(found)
        yield index, known[index][0]
    legible, letters = _legible(known.values())
    sure = legible / max(1, letters)
    if sure < SURE:
        note(
            f"the text was recognized with a confidence of {sure:.0%} only: it may be handwriting, "
            f"a picture, or in another language than {options.languages}"
        )
