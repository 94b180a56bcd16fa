"""Legibility: how much of pages and letters can be read from delivered pulses or from spikes."""

import unicodedata
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import ReadingError, import_extra
from smarttouch.emulator.drivers import SimulatedDriver
from smarttouch.imaging.image_reconstruction import LinePicture
from smarttouch.imaging.reading_profile import pixel_pitch_mm
from smarttouch.imaging.tactile_mapper import Tone
from smarttouch.kernels.bank import KernelBank
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.spikes import (
    ResponseQuality,
    SlotCurrents,
    SpikeModel,
    response_map,
    response_quality,
)
from smarttouch.profile import Profile
from smarttouch.reading.letter_shapes import ALPHABET, draw_letter, require_rows, shape_line
from smarttouch.reading.line_source import LineMotion, ReadingSource, TouchLine
from smarttouch.reading.reading_material import ReadingMaterial
from smarttouch.reading.recognition import BLOCK, recognize, recognized_lines
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.runner import Runner
from smarttouch.running.step_records import StepResult
from smarttouch.sources.source_contract import Pose, Stimulus
from smarttouch.stimulation.safety_gate import MOST_STEP_NS
from smarttouch.stimulation.scan_sequence import NO_SHARING, ScanSequence, SlotPolicy

Floats = NDArray[np.float32]

_SAME_SIGNS = str.maketrans(
    dict.fromkeys("‘’‚‛′`´", "'")
    | dict.fromkeys("“”„‟″«»", '"')
    | dict.fromkeys("‐‑‒–—―−", "-")
    | {"\N{SOFT HYPHEN}": ""}
)
"""Map from typographic variants of characters to plain characters."""


def normalize(text: str) -> str:
    """Return a text without typographic differences.

    Ligatures become letters, and an ellipsis becomes three points (Unicode's NFKC). Quotation marks
    and dashes become plain. White space and line breaks become single spaces. Case does not change.
    """
    # Translate before NFKC, because NFKC changes ´ to a space and a combining mark. Translate
    # again after NFKC, because NFKC can create characters of `_SAME_SIGNS`.
    text = unicodedata.normalize("NFKC", text.translate(_SAME_SIGNS)).translate(_SAME_SIGNS)
    return " ".join(text.split())


def character_error_rate(truth: str, text: str) -> float:
    """Return the Levenshtein distance of normalized texts, divided by the length of the true text.
    The rate is 0 for equal texts, and can exceed 1 if ``text`` is longer than ``truth``."""
    wanted = normalize(truth)
    if not wanted:
        raise ReadingError("the text to compare with is empty: give the text of the page")
    return float(_levenshtein()(wanted, normalize(text))) / len(wanted)


def _levenshtein() -> Any:
    """Import the distance function of the extra ``legibility``."""
    return import_extra(
        "rapidfuzz.distance.Levenshtein", "an error rate", "legibility", ReadingError
    ).distance


@dataclass(frozen=True)
class LineDelivery:
    """Settings of a simulated delivery of lines; the profile is from `profile_for_reading`."""

    profile: Profile
    bank: KernelBank
    tone: Tone  # tone curve from ink to activation
    motion: LineMotion
    mode: Mode = Mode.RA
    sharing: SlotPolicy = NO_SHARING
    intensity: float = 1.0  # in [0, 1], relative to full current
    line_cue: bool = False  # see `RunConfig`


@dataclass(frozen=True, eq=False)
class DeliveredLine:
    """Pulses that the simulated board delivered to the skin for one line."""

    picture: LinePicture
    length_mm: float
    poses: dict[int, Pose]  # by sequence number
    meant: dict[int, NDArray[np.bool_]]  # (E,) requested electrodes, by sequence number
    answers: dict[int, NDArray[np.float32]]  # (E,) responses in [0, 1], by sequence number
    numbers: NDArray[np.uint32]  # (N,), sequence number of each delivered slot
    width_us: NDArray[np.float32]  # (N,)
    current_ua: NDArray[np.int16]  # (N, E), positive is cathodic


def deliver_pulses(line: TouchLine, reading: LineDelivery) -> DeliveredLine:
    """Read a line with a virtual finger on a simulated board.

    Everything except the clock is as in a live run: frames, kernels, pressure gate, ramp, safety
    gate, packets and the checks of the board.
    """
    profile = reading.profile
    source = ReadingSource("a line", profile, iter([line]), reading.motion)
    # Wait until the whole text is prepared, so that frames do not depend on CPU speed.
    source.line(1, wait=True)
    poses: dict[int, Pose] = {}
    meant: dict[int, NDArray[np.bool_]] = {}

    def watch(sent: StepResult) -> None:
        if sent.number is not None and sent.sequence.intensity > 0:
            poses[sent.number] = sent.input.pose
            meant[sent.number] = np.asarray(sent.step.tactile.activation.any(axis=0))

    config = RunConfig(
        mode=reading.mode, tone=reading.tone, scan=reading.sharing, intensity=reading.intensity,
        line_cue=reading.line_cue,
    )  # fmt: skip
    with Display("simulated:", profile) as display:
        Runner(
            source, display, config, listeners=[watch], load_kernels=lambda _: reading.bank
        ).run()
        driver = display.board.driver
        assert isinstance(driver, SimulatedDriver)
        pulses = driver.take_pulses()
    source.close()
    length_mm = int(line.image.shape[1]) * pixel_pitch_mm(profile)
    picture = LinePicture(profile.electrodes, length_mm)
    answers = reading.bank.responses(profile, reading.mode.afferents, *pulses)
    silent = np.zeros(len(profile.electrodes), np.float32)
    for number, pose in poses.items():
        picture.add(pose.x_mm, answers.get(number, silent))
    return DeliveredLine(picture, length_mm, poses, meant, answers, *pulses)


def deliver_lines(lines: Sequence[TouchLine], reading: LineDelivery) -> Iterator[DeliveredLine]:
    """Deliver lines on all cores; yield each when it is done."""
    # Deliver a single line in this process, because starting another process takes longer.
    work = Parallel(n_jobs=-1 if len(lines) > 1 else 1, return_as="generator", max_nbytes=None)
    yield from work(delayed(deliver_pulses)(line, reading) for line in lines)


_LINE_PIXELS = 56  # height of delivered lines for recognition, ascender to descender
_GAP = 0.45  # gap between lines for recognition, relative to their height


@dataclass(frozen=True)
class Legibility:
    """Legibility of letter shapes: error rates and texts recognized by Tesseract.

    ``page_error_rate`` is the error rate of recognition on the page itself. It is None if no true
    text was given.
    """

    character_error_rate: float
    page_error_rate: float | None
    text: str
    page_text: str
    truth: str
    lines: int


def legibility_of_shapes(
    source: ReadingMaterial,
    reading: LineDelivery,
    truth: str | None = None,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Legibility:
    """Simulate reading of letter shapes, recognize text from the pulses, and count the errors.

    By default, the true text is the text that Tesseract recognizes on the page. ``progress`` is
    called with the number of lines done and the total number of lines.
    """
    require_rows(reading.profile, source.note)
    _levenshtein()  # fail before the long run if the extra is missing
    options = source.options
    page_texts: list[str] = []
    texts: list[str] = []
    total = 0
    for page in source.prepared():
        indices = range(len(page.lines))
        page_texts += [text for _, text in recognized_lines(page, options, source.note)]
        lines = [shape_line(page, index, reading.profile) for index in indices]
        shown: list[DeliveredLine] = []
        for line in deliver_lines(lines, reading):
            shown.append(line)
            progress(total + len(shown), total + len(lines))
        texts.append(read_pictures([shown_line.picture for shown_line in shown], options.languages))
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
    )


def read_pictures(pictures: Sequence[LinePicture], languages: str) -> str:
    """Place pictures of lines below each other, as on a page, and recognize the text.

    Tesseract recognizes blurred lines better if they have neighbors. It cannot read a single line
    without ascenders.
    """
    strips = [picture.picture(_LINE_PIXELS) for picture in pictures]
    gap = round(_GAP * _LINE_PIXELS)
    widest = max(strip.shape[1] for strip in strips)
    sheet = np.full((len(strips) * (_LINE_PIXELS + gap) + gap, widest + 2 * gap), 255, np.uint8)
    for index, strip in enumerate(strips):
        top = gap + index * (_LINE_PIXELS + gap)
        sheet[top : top + _LINE_PIXELS, gap : gap + strip.shape[1]] = strip
    return recognize(sheet, languages, BLOCK)


_PERIODS = 10
"""Number of periods for each letter. Noise and refractoriness change the spikes in each period."""
_RAMP_US = MOST_STEP_NS // 1000
"""Period of sequences while intensity rises. It is the longest useful period: with a longer one,
the rise of intensity from one sequence to the next would be the same."""


@dataclass(frozen=True)
class LetterResponse:
    """Response of one finger to one letter. A model recognizes the letter: it compares the map of
    spikes with letter templates. Its errors are not those of people."""

    letter: str
    seed: int
    quality: ResponseQuality
    read_as: str  # best-matching letter; empty without spikes


def letter_sequences(
    letters: str,
    profile: Profile,
    bank: KernelBank,
    mode: Mode,
    scan: str = "auto",
    intensity: float = 1.0,
) -> dict[str, tuple[ScanSequence, NDArray[np.bool_]]]:
    """Return for each letter a scan sequence, and a mask of its electrodes, (E,) bool."""
    pipeline = Pipeline(profile, bank, RunConfig(mode=mode, scan=scan))
    force_n = profile.force.full_n
    period_us = round(1e6 / profile.pulse.rate_hz)
    shown, time_ns = {}, 0
    for letter in letters:
        drawn = draw_letter(letter, profile)
        activation = np.zeros((len(Afferent), len(drawn)), np.float32)
        activation[list(mode.afferents)] = drawn
        pipeline.restart_at_zero()
        level = 0.0
        while level < intensity and drawn.any():
            # The ramp raises intensity only while pulses are sent, so repeat the letter.
            step = pipeline.process(Stimulus(activation, time_ns, force_n, _RAMP_US), intensity)
            level, time_ns = step.sequence.intensity, time_ns + 1000 * _RAMP_US
        step = pipeline.process(Stimulus(activation, time_ns, force_n, period_us), intensity)
        time_ns += 1000 * period_us
        shown[letter] = step.sequence, drawn > 0
    return shown


def letters_on_finger(
    finger: Finger,  # simulated finger; `finger.seed` also seeds the noise of spikes
    # slots and electrodes of each letter, from `letter_sequences`
    shown: Mapping[str, tuple[SlotCurrents, NDArray[np.bool_]]],
    wanted: Sequence[Afferent],
    known: Mapping[str, Floats],  # see `letter_templates`
) -> list[LetterResponse]:
    """Return the response of a finger to each letter, presented for ten periods."""
    model, letters = SpikeModel(finger, finger.seed), []
    for letter, (slots, active) in shown.items():
        above = model.drive(slots.current_ua, slots.width_us)
        counts, read_as = spikes_and_letter(model, slots, above, known)
        quality = response_quality(finger, counts, active, wanted)
        letters.append(LetterResponse(letter, finger.seed, quality, read_as))
    return letters


def spikes_and_letter(
    model: SpikeModel,
    slots: SlotCurrents,
    above: Floats,
    known: Mapping[str, Floats],
    periods: int = _PERIODS,
) -> tuple[NDArray[np.intp], str]:
    """Simulate the spikes of A afferents while S slots are repeated for ``periods`` periods. The
    array ``above``, (A, S), is the drive of each afferent in each slot. Return the spike count of
    each afferent, (A,), and the letter that matches best, or "" if there are no spikes."""
    model.reset()
    counts = np.sum([model.fire(slots, above).counts for _ in range(periods)], axis=0)
    places = model.finger.profile.electrodes.position_mm
    return counts, _most_like(response_map(model.finger, counts, places).sum(axis=0), known)


def letter_templates(profile: Profile) -> dict[str, Floats]:
    """Return a template of each letter, (E,), with mean 0 and norm 1."""
    return {letter: _centered(draw_letter(letter, profile)) for letter in ALPHABET}


def _most_like(values: Floats, known: Mapping[str, Floats]) -> str:
    if not values.any():
        return ""
    mine = _centered(values)
    return max(known, key=lambda letter: float(known[letter] @ mine))


def _centered(values: Floats) -> Floats:
    """Return values shifted to mean 0 and scaled to norm 1."""
    away = np.asarray(values, np.float32) - values.mean()
    return np.asarray(away / max(float(np.linalg.norm(away)), 1e-9), np.float32)
