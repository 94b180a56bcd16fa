"""Material to read: images, documents, texts and files of cells, page by page."""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import ReadingError
from smarttouch.braille.cell_pages import TEXT
from smarttouch.braille.cells import FileKind, file_kind, read_plain_text
from smarttouch.pages.document import open_document, parse_pages
from smarttouch.pages.ink import separate_ink
from smarttouch.pages.page_image import Page
from smarttouch.pages.prepared_page import (
    DOUBTFUL,
    LEFT_OUT,
    PreparedPage,
    prepare_page,
    prepare_text,
)
from smarttouch.pages.straighten import QUARTER
from smarttouch.pages.structured_text import read_structured_text
from smarttouch.pages.text_layer import LayeredPage, PicturedPage
from smarttouch.pages.text_lines import TextLine
from smarttouch.reading.ocr import likely_turns, recognize_lines

_GAP = 1.35  # lines farther apart than this part of the usual distance begin a paragraph
_LARGER = 1.2
"""Ratio of x-heights from which lines are of different prints, as a heading and its text."""
_INDENT, _MOST_INDENT = 0.8, 8.0
"""Indent of a paragraph's first line, in x-heights; beside a picture it is more."""
_LEADERS = re.compile(r"(?:\s?[.·…•_]){4,}\s*")
"""Dots that lead to a page's number in a table of contents."""
_NUMBER = re.compile(r"[\W_]*(?:\d{1,4}|[ivxlc]{1,7})[\W_]*", re.IGNORECASE)
"""A line that is the number of a page."""
_NUMBERED = re.compile(r"(?:\d{1,4}|[ivxlc]{2,7})\s.+|.+\s(?:\d{1,4}|[ivxlc]{2,7})", re.IGNORECASE)
"""A line that begins or ends with one."""
_HEAD_GAP = 1.2  # distance of a running head from the text, of the usual one, at least
_HEAD_WORDS = 9


def paragraphs(
    lines: Sequence[TextLine], texts: Sequence[str], keep_headers: bool = False
) -> list[str]:
    """Return the paragraphs and headings of a page from its lines and their texts.

    A paragraph begins after a gap, with an indented or centered line, and with print of another
    size; a column continues in the next. Words that lines divide are joined; a hyphen stays where
    the page has the word with it.
    """
    step_mm = _usual_step_mm(lines)
    kept = list(range(len(texts)))
    if not keep_headers:
        kept = [k for k in kept if not _is_header(k, lines, texts, step_mm)]
    words = {word.lower() for text in texts for word in re.findall(r"\w+-\w+", text)}
    found: list[str] = []
    before: int | None = None
    right_mm = -np.inf
    for k in kept:
        text = _LEADERS.sub(" ", texts[k]).strip()
        if not text:
            continue
        if before is not None:
            right_mm = max(right_mm, lines[before].right_mm)
        cell = lines[k].cell
        if before is not None and cell > 1 and lines[before].cell == cell - 1:
            found[-1] += f"; {text}"
        elif (
            before is None
            or cell == 1
            or lines[before].cell
            or _begins(lines[before], lines[k], step_mm, right_mm)
        ):
            found.append(text)
        else:
            found[-1] = _joined(found[-1], text, words)
        if before is not None and _middle_mm(lines[k]) < _middle_mm(lines[before]):
            # The next column has its own right edge.
            right_mm = -np.inf
        before = k
    return found


def _middle_mm(line: TextLine) -> float:
    return (line.top_mm + line.bottom_mm) / 2


def _usual_step_mm(lines: Sequence[TextLine]) -> float:
    """Return the usual distance of lines; infinite for fewer than two."""
    steps = np.diff([_middle_mm(line) for line in lines])
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else np.inf


def _begins(before: TextLine, line: TextLine, step_mm: float, right_mm: float) -> bool:
    """Return whether a line begins a paragraph; ``right_mm`` is how far lines above it reach."""
    if before.cell or line.cell:
        return True
    sizes = sorted((before.x_height_mm, line.x_height_mm))
    step = _middle_mm(line) - _middle_mm(before)
    if sizes[1] > _LARGER * sizes[0] or step >= _GAP * step_mm:
        return True
    if step <= 0:
        # The paragraph continues in the next column.
        return False
    indent = (line.left_mm - before.left_mm) / line.x_height_mm
    short, shorter = (
        (end_mm - line.right_mm) / line.x_height_mm for end_mm in (right_mm, before.right_mm)
    )
    centered = min(indent, short) > _INDENT or max(indent, shorter) < -_MOST_INDENT
    return _INDENT < indent < _MOST_INDENT or centered


def _is_header(index: int, lines: Sequence[TextLine], texts: Sequence[str], step_mm: float) -> bool:
    """Return whether a line is a running head, or the number of the page."""
    line, text = lines[index], texts[index].strip()
    middle = _middle_mm(line)
    others = np.array([_middle_mm(each) for k, each in enumerate(lines) if k != index])
    if not len(others):
        return False
    above, below = others[others < middle], others[others > middle]
    outermost = not (len(above) and len(below)) or (
        min(len(above), len(below)) == 1 and abs(np.sort(np.abs(others - middle))[0]) < step_mm / 2
    )
    if not outermost:
        return False
    if _NUMBER.fullmatch(text) and any(sign.isdigit() for sign in text):
        return True
    apart = float(np.abs(others - middle).min()) > _HEAD_GAP * step_mm
    return apart and len(text.split()) <= _HEAD_WORDS and bool(_NUMBERED.fullmatch(text))


def _joined(before: str, after: str, words: set[str]) -> str:
    """Return two lines as one: a hyphen goes where it divides a word, and stays in North-South."""
    if not before.endswith("-") or before.endswith(" -"):
        return f"{before} {after}"
    parts = re.search(r"\w+-$", before), re.match(r"\w+", after)
    whole = "".join(part[0] for part in parts if part is not None).lower()
    keeps = not after[:1].islower() or whole in words
    return (before if keeps else before[:-1]) + after


_STRIP_PIXELS = (32, 56)
"""Range of the height of lines for recognition: ascender to descender."""
SURE = 0.6
"""Mean confidence below which a page is reported as poorly recognized."""

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
    scale_matters: bool = False  # millimeters on the page count


def document_pages(
    path: Path, options: RecognitionOptions, note: Note
) -> Iterator[tuple[int, Page]]:
    """Yield numbers and pages of a document, one in memory at a time.

    An assumed scale is reported only where it matters: every line is made as high as the array.
    """
    with open_document(
        path, dpi=options.dpi, page_width_mm=options.page_width_mm, password=options.password
    ) as document:
        wanted = (
            parse_pages(options.pages, len(document)) if options.pages else range(len(document))
        )
        for index in wanted:
            before = len(document.notes)
            page = document.page(index)
            if options.scale_matters:
                for words in document.notes[before:]:
                    note(words)
            yield index + 1, page


def upright_page(number: int, page: Page, options: RecognitionOptions, note: Note) -> PreparedPage:
    """Return a page straight and upright, ink on white paper, its lines in reading order.

    A page that brings its text is so already.
    """
    if isinstance(page, LayeredPage):
        ink = separate_ink(page.grey, options.light_on_dark)
        return PreparedPage(page, ink.cleaned, page.lines, ink.light_on_dark, (), page.words)
    if isinstance(page, PicturedPage):
        note(f"page {number}: {page.reason}, so its picture is recognized instead")
    prepared, turn_deg = _most_legible(_prepared(page, options), options)
    notes = list(prepared.notes)
    if turn_deg:
        notes.insert(0, f"it was turned by {turn_deg}° to be upright")
    for words in notes:
        note(f"page {number}: {words}")
    return prepared


_LEFTWARD = frozenset(["ara", "div", "fas", "heb", "kur", "pus", "snd", "syr", "uig", "urd", "yid"])
"""Tesseract's codes of languages that are read from the right."""
_FIRST, _LONGEST = 5, 3
"""First lines, and longest ones, by which a page is known to be upright."""
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
    if letters >= _MANY_LETTERS and legible > _CLEARLY_MORE * upside_down:
        # It is upright, and hard to read.
        return []
    if QUARTER in prepared.notes:
        turns.append(90)
    others = likely_turns(prepared.cleaned, options.languages)
    return turns + [each for each in others if each not in (180, *turns)]


def _with_sample(prepared: PreparedPage, options: RecognitionOptions) -> tuple[PreparedPage, float]:
    """Return a page with a few lines recognized, and the number of legible letters in them."""
    lines = prepared.lines
    longest = sorted(range(len(lines)), key=lambda k: lines[k].left_mm - lines[k].right_mm)
    sample = sorted({*range(min(_FIRST, len(lines))), *longest[:_LONGEST]})
    strips = [_strip(prepared, index) for index in sample]
    read = [(each.text, each.confidence) for each in recognize_lines(strips, options.languages)]
    known = dict(zip(sample, read, strict=True))
    return replace(prepared, known=known), _legible(read)[0]


def _strip(prepared: PreparedPage, index: int) -> NDArray[np.uint8]:
    """Return a line for recognition, as fine as the page if that is fine enough."""
    line_px = round(prepared.lines[index].height_mm / prepared.page.mm_per_pixel)
    return prepared.strip(index, min(max(line_px, _STRIP_PIXELS[0]), _STRIP_PIXELS[1]))


def _legible(read: Iterable[tuple[str, float]]) -> tuple[float, int]:
    """Return the number of letters, each counted by its confidence, and their number."""
    found = [(len(text) * confidence, len(text)) for text, confidence in read]
    return sum(sure for sure, _ in found), sum(letters for _, letters in found)


class EmptyPages:
    """List of pages without anything readable, reported by a note at the end."""

    def __init__(self, note: Note) -> None:
        self._note = note
        self._found = False
        self._empty: list[int] = []

    def add(self, number: int, found: bool) -> None:
        """Add the result of a page."""
        self._found |= found
        if not found:
            self._empty.append(number)

    def conclude(self) -> None:
        """Report the empty pages; raise if all are."""
        if not self._found:
            raise ReadingError(
                "no line of text was found: is it a page of print, sharp, and large enough "
                "(letters of 6 pixels and more)?",
                about="page",
            )
        if self._empty:
            self._note(f"no line of text on page {', '.join(map(str, self._empty))}")


def prepared_pages(
    pages: Iterator[tuple[int, Page]], options: RecognitionOptions, note: Note
) -> Iterator[PreparedPage]:
    """Yield the pages that carry text, see `upright_page`; raise if none does."""
    empty = EmptyPages(note)
    for number, page in pages:
        prepared = upright_page(number, page, options, note)
        empty.add(number, bool(prepared.lines))
        if prepared.lines:
            yield prepared
    empty.conclude()


def recognized_lines(
    prepared: PreparedPage, options: RecognitionOptions, note: Note
) -> Iterator[tuple[int, str]]:
    """Yield numbers and texts of the lines of a page; the first of them early."""
    if prepared.words:
        yield from enumerate(prepared.words)
        return
    waiting = [index for index in range(len(prepared.lines)) if index not in prepared.known]
    strips = [_strip(prepared, index) for index in waiting]
    found = recognize_lines(strips, options.languages)
    confidences: list[tuple[int, float]] = []
    for index in range(len(prepared.lines)):
        if index in prepared.known:
            text, confidence = prepared.known[index]
        else:
            line = next(found)
            text, confidence = line.text, line.confidence
        confidences.append((len(text), confidence))
        yield index, text
    characters = sum(length for length, _ in confidences)
    sure = sum(length * each for length, each in confidences) / max(1, characters)
    if sure < SURE:
        note(
            f"the text was recognized with a confidence of {sure:.0%} only: it may be handwriting, "
            f"a picture, or in another language than {options.languages}"
        )


def recognized_text(prepared: PreparedPage, options: RecognitionOptions, note: Note) -> str:
    """Return the text of a page, a line for each paragraph, see `paragraphs`."""
    texts = [text for _, text in recognized_lines(prepared, options, note)]
    return "\n".join(paragraphs(prepared.lines, texts, options.keep_headers))


_PRINTED_AT_ONCE = 20  # lines of a text on one printed page


@dataclass(frozen=True)
class ReadingMaterial:
    """Material that can be read: a file, or ``text:`` and words; warnings go to ``note``."""

    name: str
    options: RecognitionOptions = field(default_factory=RecognitionOptions)
    note: Note = lambda _words: None

    @property
    def title(self) -> str:
        """Title on the screen."""
        return "a text" if self.name.startswith(TEXT) else Path(self.name).name

    @cached_property
    def kind(self) -> FileKind:
        """Kind of what it holds."""
        return FileKind.TEXT if self.name.startswith(TEXT) else file_kind(Path(self.name))

    @property
    def holds_cells(self) -> bool:
        """True if it is a file of Braille cells."""
        return self.kind in (FileKind.BRF, FileKind.PEF)

    @cached_property
    def words(self) -> str | None:
        """The text itself; None for images and cells."""
        if self.name.startswith(TEXT):
            return self.name[len(TEXT) :]
        if self.kind is FileKind.TEXT:
            return read_plain_text(Path(self.name))
        if self.kind is FileKind.STRUCTURED:
            return read_structured_text(Path(self.name)).text
        return None

    def numbers(self) -> list[int]:
        """Return the numbers of the pages of a document that are asked for."""
        with open_document(Path(self.name), password=self.options.password) as document:
            count = len(document)
        if not self.options.pages:
            return list(range(1, count + 1))
        return [index + 1 for index in parse_pages(self.options.pages, count)]

    def pages(self) -> Iterator[tuple[int, Page]]:
        """Yield numbers and pages of a document."""
        return document_pages(Path(self.name), self.options, self.note)

    def prepared(self) -> Iterator[PreparedPage]:
        """Yield pages with print on them: of a document, or of a text as it is printed."""
        words = self.words
        if words is None:
            yield from prepared_pages(self.pages(), self.options, self.note)
            return
        lines = words.splitlines()
        parts = [
            "\n".join(lines[start : start + _PRINTED_AT_ONCE])
            for start in range(0, len(lines), _PRINTED_AT_ONCE)
        ]
        for part in [part for part in parts if part.strip()] or [""]:
            yield prepare_text(part)
