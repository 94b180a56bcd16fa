"""Legibility: the part of a text that can be recognized from the delivered pulses."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from smarttouch.braille.files import read_plain_text
from smarttouch.delivered.line import LinePicture
from smarttouch.physiology.anatomy import Anatomy, load_anatomy
from smarttouch.physiology.finger import Finger
from smarttouch.reading.braille import Braille
from smarttouch.reading.cell_legibility import Progress, collect, legibility_of_braille, no_progress
from smarttouch.reading.deliver import DeliveredLine, Reading, deliver_lines, ideal_picture
from smarttouch.reading.error_rate import character_error_rate, word_error_rate
from smarttouch.reading.nerve import NerveReading, nerve_figures, read_at_nerve
from smarttouch.reading.ocr import recognize
from smarttouch.reading.printed import LINE_PIXELS, recognized_lines
from smarttouch.reading.shapes import Shapes, Style, require_rows, shape_line
from smarttouch.reading.source import Source
from smarttouch.reading.tesseract import Layout
from smarttouch.reading.window import rows_of

_GAP = 0.45  # gap between lines for recognition, relative to their height


@dataclass(frozen=True)
class Legibility:
    """Legibility of letter shapes: error rates of what Tesseract read, and its texts.

    ``sampling_limit`` is the character error rate for the ideal of the array: the ink in the cell
    of each electrode, at the same pitch and sweep; ``page_error_rate`` that for the page itself,
    None where the others are compared with its text. ``delivered`` has the lines and languages of
    each page.
    """

    character_error_rate: float
    word_error_rate: float
    sampling_limit: float
    page_error_rate: float | None
    text: str
    limit_text: str
    page_text: str
    truth: str
    lines: int
    delivered: Sequence[tuple[Sequence[DeliveredLine], str]] = ()


def legibility_of_shapes(
    source: Source,
    reading: Reading,
    shapes: Shapes,
    truth: str | None = None,
    progress: Progress = no_progress,
) -> Legibility:
    """Deliver letter shapes, and compare the text recognized in what was delivered with the truth.

    The truth is Tesseract's text of the page itself if not given.
    """
    options, profile = source.options, reading.profile
    step_mm = reading.motion.speed_mm_s / profile.pulse.rate_hz
    page_texts: list[str] = []
    texts: list[str] = []
    limit_texts: list[str] = []
    total = 0
    delivered: list[tuple[list[DeliveredLine], str]] = []
    for page in source.prepared():
        indices = range(len(page.lines))
        page_texts += [text for _, text in recognized_lines(page, options, source.note)]
        lines = [shape_line(page, index, profile, shapes.style) for index in indices]
        shown = collect(deliver_lines(lines, reading), total, total + len(indices), progress)
        graded = (shape_line(page, index, profile, Style.GRADED) for index in indices)
        ideal = [ideal_picture(line, profile, step_mm) for line in graded]
        delivered.append((shown, options.languages))
        texts.append(_read([each.picture for each in shown], options.languages))
        limit_texts.append(_read(ideal, options.languages))
        total += len(indices)
    page_text, text, limit_text = ("\n".join(each) for each in (page_texts, texts, limit_texts))
    compared = page_text if truth is None else truth
    return Legibility(
        character_error_rate=character_error_rate(compared, text),
        word_error_rate=word_error_rate(compared, text),
        sampling_limit=character_error_rate(compared, limit_text),
        page_error_rate=None if truth is None else character_error_rate(compared, page_text),
        text=text,
        limit_text=limit_text,
        page_text=page_text,
        truth=compared,
        lines=total,
        delivered=delivered,
    )


def legibility_at_nerve(
    found: Legibility,
    reading: Reading,
    fingers: int,
    anatomy: str | Anatomy,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Return error rates at the board and at the nerves of simulated fingers, by seeds from 1 on.

    They are ``at_board``, ``at_nerve`` with ``median`` and ``worst_tenth``, ``wrong_class``,
    ``misplaced`` and ``silent_points``.
    """
    work = Parallel(n_jobs=-1 if fingers > 1 else 1, return_as="generator", max_nbytes=None)
    seeds = range(1, fingers + 1)
    each = work(delayed(legibility_on_finger)(found, reading, seed, anatomy) for seed in seeds)
    readings, errors = zip(*collect(each, 0, fingers, progress), strict=True)
    return {"at_board": found.character_error_rate, **nerve_figures(readings, errors)}


def legibility_on_finger(
    found: Legibility, reading: Reading, seed: int, anatomy: str | Anatomy
) -> tuple[NerveReading, float]:
    """Return a finger's response to delivered shapes, without pictures, and the error rate
    there.
    """
    lines = [line for page, _ in found.delivered for line in page]
    response = read_at_nerve(lines, Finger(reading.profile, seed, anatomy), reading.mode.afferents)
    pictures = iter(response.pictures)
    texts = [
        _read([next(pictures) for _ in page], languages) for page, languages in found.delivered
    ]
    return replace(response, pictures=[]), character_error_rate(found.truth, "\n".join(texts))


def _read(pictures: Sequence[LinePicture], languages: str) -> str:
    """Return the text of pictures placed below each other, as on a page.

    Tesseract reads such soft lines with the help of those around them; it reads nothing from a
    single line without ascenders.
    """
    strips = [picture.picture(LINE_PIXELS) for picture in pictures]
    gap = round(_GAP * LINE_PIXELS)
    widest = max(strip.shape[1] for strip in strips)
    sheet = np.full((len(strips) * (LINE_PIXELS + gap) + gap, widest + 2 * gap), 255, np.uint8)
    for index, strip in enumerate(strips):
        top = gap + index * (LINE_PIXELS + gap)
        sheet[top : top + LINE_PIXELS, gap : gap + strip.shape[1]] = strip
    return recognize(sheet, languages=languages, layout=Layout.BLOCK).text


@dataclass(frozen=True)
class Measured:
    """Legibility of a text: figures for a JSON file, the main ones by name, and the text read."""

    figures: dict[str, Any]
    rows: list[tuple[str, str]]
    text: str


def measure_legibility(
    source: Source,
    reading: Reading,
    presented: Shapes | Braille,
    truth: Path | None = None,
    progress: Progress = no_progress,
    fingers: int = 0,
    anatomy: str = "branched",
) -> Measured:
    """Deliver a text as shapes or Braille, and read it back; shapes at the nerves of fingers, too.

    ``truth`` is a file of the true text of shapes.
    """
    speed = {"speed_mm_s": reading.motion.speed_mm_s}
    if isinstance(presented, Braille):
        cells = legibility_of_braille(source, reading, presented, progress)
        how = {"as": "braille", "table": presented.table, "cells_as": presented.presentation.value}
        rows = [
            ("cells", str(cells.cells)),
            ("lines", str(cells.lines)),
            ("error rate, delivered", f"{cells.cell_error_rate:.3f}"),
        ]
        text = cells.delivered if cells.text is None else cells.text
        return Measured({**how, **speed, **asdict(cells)}, rows, text)
    paths = load_anatomy(anatomy)
    require_rows(reading.profile, source.note)
    true_text = source.words if truth is None else read_plain_text(truth)
    found = legibility_of_shapes(source, reading, presented, true_text, progress)
    rate = found.page_error_rate
    rows = [
        ("characters", str(len(found.truth))),
        ("lines", str(found.lines)),
        ("error rate, page", "-" if rate is None else f"{rate:.3f}"),
        ("error rate, sampling limit", f"{found.sampling_limit:.3f}"),
        ("error rate, delivered", f"{found.character_error_rate:.3f}"),
    ]
    shape = {"as": "shapes", "style": presented.style.value, "rows": rows_of(reading.profile)}
    figures = {f.name: getattr(found, f.name) for f in fields(found) if f.name != "delivered"}
    if fingers:
        nerve = legibility_at_nerve(found, reading, fingers, paths, progress)
        figures |= {"fingers": fingers, "anatomy": anatomy, **nerve}
        rows += [
            (f"error rate, nerve, {name.replace('_', ' ')}", f"{rate:.3f}")
            for name, rate in nerve["at_nerve"].items()
        ]
    return Measured({**shape, **speed, **figures}, rows, found.text)
