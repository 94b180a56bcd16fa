"""Letters on many fingers: what the board delivers, and the spikes of all afferents.

A letter is recognized by its correlation with the letters as they were meant: at the board from
the answers of one receptor under each electrode, at the nerve from the spikes, put where the
receptors are. No person was asked; errors at the nerve are of this reader, not of readers.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean, median

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.kernels.bank import KernelBank
from smarttouch.physiology.anatomy import Anatomy
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.response import (
    ResponseQuality,
    ignore_nan,
    response_map,
    response_quality,
    worst_tenth,
)
from smarttouch.physiology.spikes import (
    Bystanders,
    SlotCurrents,
    SpikeModel,
    margins,
    nociceptive_margin,
)
from smarttouch.profile import Profile
from smarttouch.reading.letter_shapes import ALPHABET, draw_letter
from smarttouch.running.config import RunConfig
from smarttouch.running.delivered import Perception
from smarttouch.running.pipeline import Pipeline
from smarttouch.sources.source_contract import Stimulus
from smarttouch.stimulation.intensity import MOST_STEP_NS
from smarttouch.stimulation.scan_sequence import ScanSequence

Floats = NDArray[np.float32]

_PERIODS = 10
"""Periods of a letter that a finger feels: noise and refractoriness differ between them."""
_OPENING_US = MOST_STEP_NS // 1000
"""Of the pulses that open the intensity: longer ones would open no more of it."""


@dataclass(frozen=True)
class LetterResponse:
    """One letter on one finger."""

    letter: str
    seed: int
    quality: ResponseQuality
    read_as: str  # letter that the spikes resemble most; empty without a spike


def letter_sequence(
    letter: str, profile: Profile, bank: KernelBank, mode: Mode
) -> tuple[ScanSequence, NDArray[np.bool_]]:
    """Return the scan sequence of a letter at full comfort, and its electrodes, (E,)."""
    return letter_sequences(letter, profile, bank, mode)[letter]


def letter_sequences(
    letters: str,
    profile: Profile,
    bank: KernelBank,
    mode: Mode,
    scan: str = "auto",
    intensity: float = 1.0,
) -> dict[str, tuple[ScanSequence, NDArray[np.bool_]]]:
    """Return `letter_sequence` of each letter; what scans are made of is prepared once."""
    pipeline = Pipeline(profile, bank, RunConfig(mode=mode, scan=scan))
    force_n = profile.force.full_n
    period_us = round(1e6 / profile.pulse.rate_hz)
    # Pulses open the intensity, as long as they last.
    opening = [_OPENING_US] * (math.ceil(1e6 * profile.limits.ramp_s / _OPENING_US) + 2)
    shown, time_ns = {}, 0
    for letter in letters:
        drawn = draw_letter(letter, profile)
        activation = np.zeros((len(Afferent), len(drawn)), np.float32)
        activation[list(mode.afferents)] = drawn
        pipeline.restart_softly()
        for each_us in (*opening, period_us):
            step = pipeline.process(Stimulus(activation, time_ns, force_n, each_us), intensity)
            time_ns += 1000 * each_us
        shown[letter] = step.sequence, drawn > 0
    return shown


def respond_to_letters(
    profile: Profile,  # of an array with rows and columns
    bank: KernelBank,
    mode: Mode,  # RA, SAI or PC
    anatomy: str,  # name or file of the fingers' anatomy
    seeds: Sequence[int],  # of the fingers
    letters: str = ALPHABET,
    # called with the number of finished fingers and of all
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> list[LetterResponse]:
    """Put letters on fingers, each at full comfort in one mode."""
    shown = letter_sequences(letters, profile, bank, mode)
    known = letter_templates(profile)
    found: list[LetterResponse] = []
    for done, seed in enumerate(seeds):
        finger = Finger(profile, seed, anatomy)
        found += letters_on_finger(finger, shown, mode.afferents, known)
        progress(done + 1, len(seeds))
    return found


def letters_on_finger(
    finger: Finger,  # its seed is that of the noise, too
    # slots and electrodes of each letter, see `letter_sequences`
    shown: Mapping[str, tuple[SlotCurrents, NDArray[np.bool_]]],
    wanted: Sequence[Afferent],
    known: Mapping[str, Floats],  # see `letter_templates`
) -> list[LetterResponse]:
    """Return the response of a finger to letters, each for ten periods."""
    model, found = SpikeModel(finger, finger.seed), []
    for letter, (slots, active) in shown.items():
        above = model.drive(slots.current_ua, slots.width_us, firing=True)
        counts, read_as = spikes_and_letter(model, slots, above, known)
        quality = response_quality(finger, counts, active, wanted)
        found.append(LetterResponse(letter, finger.seed, quality, read_as))
    return found


def spikes_and_letter(
    model: SpikeModel,
    slots: SlotCurrents,
    above: Floats,
    known: Mapping[str, Floats],
    periods: int = _PERIODS,
) -> tuple[NDArray[np.intp], str]:
    """Return the spike counts, (A,), of periods of slots with these drives, (A, S), and the letter
    that they resemble most; none without a spike."""
    model.reset()
    counts = np.sum([model.fire(slots, above).counts for _ in range(periods)], axis=0)
    places = model.finger.profile.electrodes.position_mm
    return counts, _most_like(response_map(model.finger, counts, places).sum(axis=0), known)


def read_at_board(
    profile: Profile, bank: KernelBank, mode: Mode, letters: str = ALPHABET
) -> dict[str, str]:
    """Return what each letter is read as from the answers under the electrodes."""
    answers = Perception(profile, bank, mode.afferents)
    known = letter_templates(profile)
    read = {}
    for letter, (sequence, _) in letter_sequences(letters, profile, bank, mode).items():
        width = sequence.width_us.astype(np.float32)
        numbers = np.zeros(sequence.slots, np.uint32)
        answer = answers.answers(numbers, width, sequence.current_ua).get(0)
        read[letter] = "" if answer is None else _most_like(answer, known)
    return read


def summary(found: Sequence[LetterResponse]) -> dict[str, float]:
    """Return medians over fingers of the means over letters, and error rates at the nerve."""
    by_finger = finger_means(found)
    errors = by_finger.pop("median")
    figures = {name: ignore_nan(median, each) for name, each in by_finger.items()}
    return {**figures, "median": median(errors), "worst_tenth": worst_tenth(errors)}


def finger_means(found: Sequence[LetterResponse]) -> dict[str, list[float]]:
    """Return each finger's means over letters: the measures of `ResponseQuality` and, as
    ``median``, its error rate."""
    by_finger: dict[int, list[LetterResponse]] = {}
    for each in found:
        by_finger.setdefault(each.seed, []).append(each)
    measures = ("silent_points", "wrong_class", "misplaced")
    means = {
        name: [
            ignore_nan(fmean, (getattr(one.quality, name) for one in them))
            for them in by_finger.values()
        ]
        for name in measures
    }
    wrong = [fmean(one.read_as != one.letter for one in them) for them in by_finger.values()]
    return {**means, "median": wrong}


def fired(found: Sequence[LetterResponse]) -> dict[str, float]:
    """Return how many afferents of each class fire: medians over letters and fingers."""
    return {each.name: median(one.quality.afferents[each] for one in found) for each in Afferent}


def letter_templates(profile: Profile) -> dict[str, Floats]:
    """Return the letters of the alphabet as they are meant, with mean 0 and length 1."""
    return {each: _centered(draw_letter(each, profile)) for each in ALPHABET}


def _most_like(values: Floats, known: Mapping[str, Floats]) -> str:
    if not values.any():
        return ""
    mine = _centered(values)
    return max(known, key=lambda each: float(known[each] @ mine))


def _centered(values: Floats) -> Floats:
    """Return values of mean 0 and length 1."""
    away = np.asarray(values, np.float32) - values.mean()
    return np.asarray(away / max(float(np.linalg.norm(away)), 1e-9), np.float32)


def error_at_board(
    profile: Profile, bank: KernelBank, mode: Mode, letters: str = ALPHABET
) -> float:
    """Return the part of letters that are read as another from the answers at the electrodes."""
    read = read_at_board(profile, bank, mode, letters)
    return fmean(letter != seen for letter, seen in read.items())


def bystander_margins(
    profile: Profile,
    bank: KernelBank,
    mode: Mode,
    anatomy: str | Anatomy,
    seeds: Sequence[int],
    letters: str = ALPHABET,
) -> dict[str, float]:
    """Return the factor on all currents at which the first of each class fires, and the smaller of
    Aδ and C as "nociceptive".

    Medians over fingers, of the worst letter each; above 1 none fires at full comfort. Infinite
    where no legal currents fire it.
    """
    shown = [each for each, _ in letter_sequences(letters, profile, bank, mode).values()]
    rows: list[dict[str, float]] = []
    for seed in seeds:
        found = margins(Bystanders(profile, seed, anatomy), shown)
        row = {each.name: one.margin for each, one in found.items()}
        rows.append(row | {"nociceptive": nociceptive_margin(found)})
    return {name: median(row[name] for row in rows) for name in rows[0]}
