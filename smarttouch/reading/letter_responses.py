"""Letters on many fingers: what the board delivers, and the spikes of all afferents.

A letter is recognized by its correlation with the letters as they were meant, from the spikes, put
where the receptors are. No person was asked: errors are of this reader, not of readers.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.kernels.bank import KernelBank
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.response import (
    ResponseQuality,
    response_map,
    response_quality,
)
from smarttouch.physiology.spikes import (
    SlotCurrents,
    SpikeModel,
)
from smarttouch.profile import Profile
from smarttouch.reading.letter_shapes import ALPHABET, draw_letter
from smarttouch.running.config import RunConfig
from smarttouch.running.pipeline import Pipeline
from smarttouch.sources.source_contract import Stimulus
from smarttouch.stimulation.ramp import MOST_STEP_NS
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


def letter_sequences(
    letters: str,
    profile: Profile,
    bank: KernelBank,
    mode: Mode,
    scan: str = "auto",
    intensity: float = 1.0,
) -> dict[str, tuple[ScanSequence, NDArray[np.bool_]]]:
    """Return the scan sequence of each letter at full comfort, and its electrodes, (E,)."""
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
