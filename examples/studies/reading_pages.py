"""Study of pages that are read from the spikes of simulated fingers, with different settings.

``python examples/studies/reading_pages.py 20 pages.jsonl`` reads the sample page with 20 fingers of
each anatomy that were not used to choose settings. Add your own pages at the end of the command.
Results are stored in the file ``pages.jsonl``, from which a later run continues.
"""

import itertools
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from functools import cache
from pathlib import Path
from statistics import fmean
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap
from threadpoolctl import threadpool_limits

from smarttouch.base.afferent import Mode
from smarttouch.imaging.image_reconstruction import LinePicture
from smarttouch.imaging.reading_profile import profile_for_reading
from smarttouch.kernels.bank import load_bank
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.spikes import (
    FIELD_MM,
    SpikeModel,
    delivered_spikes,
    ignore_nan,
    response_quality,
)
from smarttouch.profile import Profile, load_profile
from smarttouch.reading.legibility import (
    DeliveredLine,
    LineDelivery,
    character_error_rate,
    deliver_pulses,
    read_pictures,
)
from smarttouch.reading.letter_shapes import Shapes, shape_line
from smarttouch.reading.line_source import LineMotion, TouchLine
from smarttouch.reading.reading_material import ReadingMaterial
from smarttouch.reading.recognition import recognized_lines
from smarttouch.running.config import RunConfig

Counts, Values = NDArray[np.intp], NDArray[np.float32]
ANATOMIES = ("paper", "branched")
TUNED, HELD_OUT = (1, 2), 101
"""`TUNED`: seeds of the fingers on which settings are chosen. `HELD_OUT`: first seed of the fingers
on which they are tested."""
MOST_LINES = 2  # largest number of lines read on a page
LEAST_LOWER = 16
"""Smallest number of lowercase letters in a line that is read, so that headings are skipped."""
MOST_LAG = 24  # largest lag that `step_by_spikes` tries, in pulses
SAMPLE = "sample_images/page.png"
OBSERVERS = ("knows the path", "spikes alone")
JITTER_MM = (0.5, 1.0)
"""Standard deviations of position errors, which are independent from pulse to pulse."""


@dataclass(frozen=True)
class Setting:
    """Settings with which a page is presented to a finger."""

    level: float = 1.0  # current, relative to the strongest comfortable current
    style: str = "graded"
    scan: str = "auto"
    speed: float = 1.0  # at 1, each electrode pulses four times per pitch
    size: float = 1.0  # height of a line, relative to the height of the array


BEFORE = Setting()
LEVELS, STYLES = (1.0, 0.7, 0.5, 0.4), ("graded", "plain")
CHANGES: dict[str, tuple[Any, ...]] = {
    "scan": ("points", "frame"), "speed": (0.5, 2.0), "size": (0.75,),
}  # fmt: skip
"""Values to test. Each test changes one of these settings; level and style are the best ones."""


@cache
def profile() -> Profile:
    """Return the profile of the array on which pages are read."""
    return profile_for_reading(load_profile("electric-mouse"))


def smaller(line: TouchLine, size: float) -> TouchLine:
    """Return a line that is scaled by ``size`` and vertically centered on the array."""
    rows, columns = line.image.shape
    shape = max(1, round(columns * size)), max(1, round(rows * size))
    image = cv2.resize(line.image, shape, interpolation=cv2.INTER_AREA)
    top = (rows - shape[1]) // 2
    sides = top, rows - shape[1] - top, 0, 0
    image = cv2.copyMakeBorder(image, *sides, cv2.BORDER_CONSTANT, value=255)
    end_mm = line.end_mm - (columns - shape[0]) * (line.end_mm + line.start_mm) / columns
    return replace(line, image=np.asarray(image, np.uint8), end_mm=end_mm)


@cache
def delivered(page: str, setting: Setting) -> tuple[tuple[DeliveredLine, ...], str]:
    """Return the delivered pulses of the first lines of running text, and the text of the lines."""
    chosen, shapes = profile(), Shapes(setting.style == "graded")
    speed_mm_s = setting.speed * shapes.motion(chosen).speed_mm_s
    reading = LineDelivery(
        chosen, load_bank(chosen), shapes.tone, LineMotion(speed_mm_s), Mode.RA,
        RunConfig(scan=setting.scan).sharing(chosen), setting.level,
    )  # fmt: skip
    source = ReadingMaterial(page)
    sheet = next(iter(source.prepared()))
    read = recognized_lines(sheet, source.options, source.note)
    running = (each for each in read if sum(map(str.islower, each[1])) >= LEAST_LOWER)
    found = [*itertools.islice(running, MOST_LINES)]
    if not found:
        raise SystemExit(f"no line of {page} has {LEAST_LOWER} lowercase letters: give other pages")
    indices, texts = zip(*found, strict=True)
    lines = [smaller(shape_line(sheet, k, chosen), setting.size) for k in indices]
    truth = "\n".join(texts)
    return tuple(deliver_pulses(line, reading) for line in lines), truth


def step_by_spikes(values: NDArray[np.float32]) -> float:
    """Estimate how far the finger moves from pulse to pulse, mm. The spikes of neighboring columns
    correlate most at some lag, in pulses. The estimate is the pitch divided by this lag.
    ``values``, (N, E), are the spikes around each electrode."""
    places_mm = profile().electrodes.position_mm[:, 0]
    columns = np.unique(places_mm.round(3))
    by_column = np.stack([values[:, np.isclose(places_mm, x)] for x in columns], axis=1)
    by_column -= by_column.mean(axis=(0, 2))[None, :, None]
    lags = range(1, min(len(values) - 1, MOST_LAG) + 1)
    alike = [float((by_column[:-lag, 1:] * by_column[lag:, :-1]).mean()) for lag in lags]
    at = int(np.argmax(alike))
    lag = 1.0 + at
    if 0 < at < len(alike) - 1:
        below, here, above = alike[at - 1 : at + 2]
        lag += (below - above) / (2 * (below - 2 * here + above))
    return float(columns[1] - columns[0]) / lag


FULL_QUANTILE = 0.99  # over all sequences, this quantile of their largest values is scaled to 1


def spikes_of(lines: Sequence[DeliveredLine], finger: Finger) -> Iterator[dict[int, Counts]]:
    """Yield, for each line, a dictionary from sequence numbers to spikes of each afferent, (A,)."""
    model, silent = SpikeModel(finger), np.zeros(len(finger.classes), np.intp)
    for line in lines:
        periods = dict.fromkeys(line.poses, round(1e6 / finger.profile.pulse.rate_hz))
        slots = line.numbers, line.width_us, line.current_ua
        spikes = delivered_spikes(finger, *slots, periods, model=model)
        yield {number: spikes.get(number, silent) for number in line.poses}


def shown_by(lines: Sequence[dict[int, Counts]], finger: Finger) -> list[list[Values]]:
    """Return, for each line and sequence, the spikes of all classes around each electrode, (E,).
    Values are scaled as `FULL_QUANTILE` states, and clipped to [0, 1]."""
    away_mm = finger.receptor_mm[:, None] - finger.profile.electrodes.position_mm
    field = np.exp(-(away_mm**2).sum(axis=2) / (2 * FIELD_MM**2)).astype(np.float32)
    felt = [[counts @ field for counts in line.values()] for line in lines]
    full = max(np.quantile([each.max() for line in felt for each in line], FULL_QUANTILE), 1e-9)
    return [[np.clip(each / full, 0, 1).astype(np.float32) for each in line] for line in felt]


@dataclass(frozen=True)
class PageRow:
    """Result of one finger that reads one page."""

    page: str
    anatomy: str
    seed: int
    setting: Setting
    errors: dict[str, float]  # share of wrong characters, by observer
    silent_points: float
    wrong_class: float
    misplaced: float


def read_page(page: str, anatomy: str, seed: int, setting: Setting) -> PageRow:
    """Return the errors of each observer who reads a page from the spikes of one finger."""
    lines, truth = delivered(page, setting)
    with threadpool_limits(limits=1, user_api="blas"):
        finger = Finger(profile(), seed, anatomy)
        spikes = list(spikes_of(lines, finger))
        seen = shown_by(spikes, finger)
    qualities = [
        response_quality(finger, counts, line.meant[number], Mode.RA.afferents)
        for line, each in zip(lines, spikes, strict=True)
        for number, counts in each.items()
        if number in line.answers
    ]
    random = np.random.default_rng(seed)

    def rate(places_mm: Sequence[NDArray[np.float64]]) -> float:
        pictures = []
        for line, shown, x_mm in zip(lines, seen, places_mm, strict=True):
            longest_mm = max(line.length_mm, float(x_mm.max()) + 10)
            picture = LinePicture(profile().electrodes, longest_mm)
            for x, values in zip(x_mm, shown, strict=True):
                picture.add(float(x), values)
            pictures.append(picture)
        return character_error_rate(truth, read_pictures(pictures, "eng"))

    true_mm = [np.array([pose.x_mm for pose in line.poses.values()]) for line in lines]
    errors = {OBSERVERS[0]: rate(true_mm)}
    for spread in JITTER_MM if seed in TUNED else ():
        off = [each + spread * random.standard_normal(len(each)) for each in true_mm]
        errors[f"off by {spread:g} mm"] = rate(off)
    guessed = []
    for x_mm, shown in zip(true_mm, seen, strict=True):
        # The finger rests at the start of a line while a point marks the start.
        moving = x_mm > x_mm[0]
        step_mm = step_by_spikes(np.array(shown)[moving])
        guessed.append(x_mm[0] + step_mm * np.cumsum(moving))
    errors[OBSERVERS[1]] = rate(guessed)
    return PageRow(
        Path(page).name, anatomy, seed, setting, errors,
        *(ignore_nan(fmean, (getattr(quality, name) for quality in qualities))
          for name in ("silent_points", "wrong_class", "misplaced")),
    )  # fmt: skip


def rows_of(
    kept: Path, page: str, anatomy: str, seeds: Sequence[int], setting: Setting
) -> list[PageRow]:
    """Return a row for each finger. Compute and store the rows that are not in the file."""
    lines = kept.read_text().splitlines() if kept.is_file() else []
    known = [
        PageRow(**row | {"setting": Setting(**row["setting"])}) for row in map(json.loads, lines)
    ]
    wanted = Path(page).name, anatomy, setting
    found = {each.seed: each for each in known if (each.page, each.anatomy, each.setting) == wanted}
    for seed in seeds:
        if seed not in found:
            found[seed] = read_page(page, anatomy, seed, setting)
            with kept.open("a") as file:
                file.write(json.dumps(asdict(found[seed])) + "\n")
    return [found[seed] for seed in seeds]


def with_interval(values: Sequence[float]) -> str:
    """Return the median and its 95 % confidence interval, by bootstrap over fingers, as text."""
    middle = f"{np.median(values):.2f}"
    if len(values) < 3 or len(set(values)) == 1:
        return middle
    low, high = bootstrap((values,), np.median, method="percentile", rng=1).confidence_interval
    return f"{middle} ({low:.2f}-{high:.2f})"


def table(rows: Sequence[PageRow]) -> Iterator[str]:
    """Yield a table row for each page, anatomy and setting: the errors and the misplaced spikes."""
    groups: dict[tuple[str, str, Setting], list[PageRow]] = {}
    for row in rows:
        groups.setdefault((row.page, row.anatomy, row.setting), []).append(row)
    for (page, anatomy, setting), those in groups.items():
        cells = [with_interval([row.errors[name] for row in those]) for name in those[0].errors]
        cells.append(with_interval([row.misplaced for row in those]))
        values = ", ".join(f"{each}" for each in astuple(setting))
        yield f"| {page} | {anatomy} | {values} | " + " | ".join(cells) + " |"


def worst(rows: Sequence[PageRow]) -> dict[Setting, float]:
    """Return for each setting the mean error of the observer who knows the path. Of the two
    anatomies, the one with the larger mean error counts."""
    errors: dict[tuple[Setting, str], list[float]] = {}
    for row in rows:
        errors.setdefault((row.setting, row.anatomy), []).append(row.errors[OBSERVERS[0]])
    found: dict[Setting, float] = {}
    for (setting, _), those in errors.items():
        found[setting] = max(found.get(setting, 0.0), fmean(those))
    return found


def chosen(kept: Path) -> tuple[Setting, list[PageRow]]:
    """Return the best level and style on the `TUNED` fingers, and rows of each tested setting."""
    grid = [Setting(level, style) for style in STYLES for level in LEVELS]
    both = itertools.product(grid, ANATOMIES)
    rows = [row for each, one in both for row in rows_of(kept, SAMPLE, one, TUNED, each)]
    errors = worst(rows)
    return min(errors, key=lambda each: errors[each]), rows


def main(fingers: str, kept: str, *pages: str) -> None:
    """Choose level and style on the sample page and the `TUNED` fingers. Test the choice on other
    fingers, with each change in `CHANGES`, and on other pages."""
    file = Path(kept)
    best, rows = chosen(file)
    print(*table(rows), sep="\n", flush=True)
    seeds = range(HELD_OUT, HELD_OUT + int(fingers))
    changed = [replace(best, **{name: each}) for name, values in CHANGES.items() for each in values]
    asked = [BEFORE, replace(BEFORE, level=best.level), best, *changed]
    judged = [*itertools.product([SAMPLE], ANATOMIES, asked)]
    judged += itertools.product(pages, ANATOMIES, [BEFORE, best])
    for page, anatomy, setting in judged:
        print(*table(rows_of(file, page, anatomy, seeds, setting)), sep="\n", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
