"""Legibility: the part of a text or of cells that can be read from the delivered pulses."""

import unicodedata
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from smarttouch.base.errors import ReadingError
from smarttouch.base.lazy_names import import_extra
from smarttouch.braille.code_tables import open_table
from smarttouch.imaging.array_window import rows_of
from smarttouch.pages.file_kinds import read_plain_text
from smarttouch.physiology.anatomy import Anatomy
from smarttouch.physiology.finger import Finger
from smarttouch.reading.braille_lines import Braille
from smarttouch.reading.delivered_lines import (
    DeliveredLine,
    LineDelivery,
    NerveReading,
    deliver_lines,
    read_at_nerve,
)
from smarttouch.reading.letter_shapes import Shapes, require_rows, shape_line
from smarttouch.reading.line_feed import TouchLine
from smarttouch.reading.material import ReadingMaterial
from smarttouch.reading.ocr import Layout, recognize
from smarttouch.reading.recognition import recognized_lines
from smarttouch.running.delivered import LinePicture

_SAME_SIGNS = str.maketrans(
    dict.fromkeys("‘’‚‛′`´", "'")
    | dict.fromkeys("“”„‟″«»", '"')
    | dict.fromkeys("‐‑‒–—―−", "-")
    | {"\N{SOFT HYPHEN}": ""}
)
"""Signs that differ only by typeface or style."""


def normalize(text: str) -> str:
    """Return a text without differences of typeface.

    Signs are taken apart and together again by Unicode's NFKC (ligatures become
    letters, an ellipsis three points), quotation marks and dashes become their
    plain forms, and white space, line breaks too, becomes single spaces. Upper
    and lower case stay.
    """
    # Before NFKC, which makes a space and a joining accent of a lone one, and after, as it makes
    # some of these signs from others.
    text = unicodedata.normalize("NFKC", text.translate(_SAME_SIGNS)).translate(_SAME_SIGNS)
    return " ".join(text.split())


def character_error_rate(truth: str, text: str) -> float:
    """Return the Levenshtein distance of normalized texts per character of the truth.

    It is 0 for equal texts and above 1 where more was read than is there.
    """
    wanted = normalize(truth)
    if not wanted:
        raise ReadingError("the text to compare with is empty: give the text of the page")
    return float(_levenshtein()(wanted, normalize(text))) / len(wanted)


def _levenshtein() -> Any:
    """Return the function for the distance of two sequences, from the extra ``legibility``."""
    return import_extra(
        "rapidfuzz.distance.Levenshtein", "an error rate", "legibility", ReadingError
    ).distance


Progress = Callable[[int, int], None]  # callback with the number of finished lines and of all


def no_progress(_done: int, _total: int) -> None:
    """Report nothing."""


def _deliver(
    lines: Sequence[TouchLine], reading: LineDelivery, before: int, total: int, progress: Progress
) -> list[DeliveredLine]:
    """Return all lines as delivered, and report each as it comes."""
    delivered: list[DeliveredLine] = []
    for line in deliver_lines(lines, reading):
        delivered.append(line)
        progress(before + len(delivered), total)
    return delivered


_LINE_PIXELS = 56  # height of delivered lines for recognition: ascender to descender
_GAP = 0.45  # gap between lines for recognition, relative to their height


@dataclass(frozen=True)
class Legibility:
    """Legibility of letter shapes: error rates of what Tesseract read, and its texts.

    ``page_error_rate`` is that of the page itself, None where the other is compared with its text.
    ``delivered`` has the lines and languages of each page.
    """

    character_error_rate: float
    page_error_rate: float | None
    text: str
    page_text: str
    truth: str
    lines: int
    delivered: Sequence[tuple[Sequence[DeliveredLine], str]] = ()


def legibility_of_shapes(
    source: ReadingMaterial,
    reading: LineDelivery,
    truth: str | None = None,
    progress: Progress = no_progress,
) -> Legibility:
    """Deliver letter shapes, and compare the text recognized in what was delivered with the truth.

    The truth is Tesseract's text of the page itself if not given.
    """
    _levenshtein()  # before a long run that would end without it
    options = source.options
    page_texts: list[str] = []
    texts: list[str] = []
    total = 0
    delivered: list[tuple[list[DeliveredLine], str]] = []
    for page in source.prepared():
        indices = range(len(page.lines))
        page_texts += [text for _, text in recognized_lines(page, options, source.note)]
        lines = [shape_line(page, index, reading.profile) for index in indices]
        shown = _deliver(lines, reading, total, total + len(indices), progress)
        delivered.append((shown, options.languages))
        texts.append(read_pictures([each.picture for each in shown], options.languages))
        total += len(indices)
    page_text, text = "\n".join(page_texts), "\n".join(texts)
    compared = page_text if truth is None else truth
    return Legibility(
        character_error_rate=character_error_rate(compared, text),
        page_error_rate=None if truth is None else character_error_rate(compared, page_text),
        text=text,
        page_text=page_text,
        truth=compared,
        lines=total,
        delivered=delivered,
    )


def legibility_on_finger(
    found: Legibility, reading: LineDelivery, seed: int, anatomy: str | Anatomy
) -> tuple[NerveReading, float]:
    """Return a finger's response to delivered shapes, without pictures, and the error rate
    there.
    """
    lines = [line for page, _ in found.delivered for line in page]
    response = read_at_nerve(lines, Finger(reading.profile, seed, anatomy), reading.mode.afferents)
    pictures = iter(response.pictures)
    texts = [
        read_pictures([next(pictures) for _ in page], languages)
        for page, languages in found.delivered
    ]
    return replace(response, pictures=[], shown=[]), character_error_rate(
        found.truth, "\n".join(texts)
    )


def read_pictures(pictures: Sequence[LinePicture], languages: str) -> str:
    """Return the text of pictures placed below each other, as on a page.

    Tesseract reads such soft lines with the help of those around them; it reads nothing from a
    single line without ascenders.
    """
    strips = [picture.picture(_LINE_PIXELS) for picture in pictures]
    gap = round(_GAP * _LINE_PIXELS)
    widest = max(strip.shape[1] for strip in strips)
    sheet = np.full((len(strips) * (_LINE_PIXELS + gap) + gap, widest + 2 * gap), 255, np.uint8)
    for index, strip in enumerate(strips):
        top = gap + index * (_LINE_PIXELS + gap)
        sheet[top : top + _LINE_PIXELS, gap : gap + strip.shape[1]] = strip
    return recognize(sheet, languages=languages, layout=Layout.BLOCK)


@dataclass(frozen=True)
class Measured:
    """Legibility of a text: figures for a JSON file, the main ones by name, and the text read."""

    figures: dict[str, Any]
    rows: list[tuple[str, str]]
    text: str


def measure_legibility(
    source: ReadingMaterial,
    reading: LineDelivery,
    presented: Shapes | Braille,
    truth: Path | None = None,
    progress: Progress = no_progress,
) -> Measured:
    """Deliver a text as shapes or Braille, and read it back.

    ``truth`` is a file of the true text of shapes.
    """
    if isinstance(presented, Braille):
        return _measured_braille(source, reading, presented, progress)
    require_rows(reading.profile, source.note)
    true_text = source.words if truth is None else read_plain_text(truth)
    found = legibility_of_shapes(source, reading, true_text, progress)
    rate = found.page_error_rate
    rows = [
        ("characters", str(len(found.truth))),
        ("lines", str(found.lines)),
        ("error rate, page", "-" if rate is None else f"{rate:.3f}"),
        ("error rate, delivered", f"{found.character_error_rate:.3f}"),
    ]
    figures = {
        "as": "shapes",
        "rows": rows_of(reading.profile),
        "speed_mm_s": reading.motion.speed_mm_s,
    }
    figures |= {f.name: getattr(found, f.name) for f in fields(found) if f.name != "delivered"}
    return Measured(figures, rows, found.text)


def _measured_braille(
    source: ReadingMaterial, reading: LineDelivery, braille: Braille, progress: Progress
) -> Measured:
    """Deliver cells, and decode the delivered dots."""
    lines = list(braille.lines(source, reading.profile))
    wanted = [line.cells for line in lines]
    delivered = [
        braille.layout(reading.profile, cells).decode(
            line.picture, cells, apart=reading.motion.gaps
        )
        for cells, line in zip(
            wanted, _deliver(lines, reading, 0, len(lines), progress), strict=True
        )
    ]
    pairs = list(zip("".join(wanted), "".join(delivered), strict=True))
    rate = sum(one != other for one, other in pairs) / len(pairs)
    table, shown = open_table(braille.table), "\n".join(delivered)
    text = table.to_text(shown) if table.code.goes_back else None
    figures = {
        "as": "braille",
        "table": braille.table,
        "cells_as": braille.presentation.value,
        "speed_mm_s": reading.motion.speed_mm_s,
        "cell_error_rate": rate,
        "cells": len(pairs),
        "lines": len(lines),
        "wanted": "\n".join(wanted),
        "delivered": shown,
        "text": text,
    }
    rows = [
        ("cells", str(len(pairs))),
        ("lines", str(len(lines))),
        ("error rate, delivered", f"{rate:.3f}"),
    ]
    return Measured(figures, rows, shown if text is None else text)
