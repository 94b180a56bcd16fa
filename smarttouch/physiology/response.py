"""Response of one finger to scan sequences: spikes, and measures of them."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isnan, nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import CLASS_COLORS, Afferent
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.spikes import SlotCurrents, SpikeModel, Spikes


@dataclass(frozen=True)
class ResponseQuality:
    """What a pattern fired in a finger, by the one definition that all commands have.

    Active electrodes are those that were to stimulate, whatever the board made of it.
    """

    spikes: int  # of all classes
    afferents: dict[Afferent, int]  # number that fired, of each class
    # fraction of active electrodes without a firing receptor of a wanted class within half a pitch
    silent_points: float
    wrong_class: float  # fraction of spikes of other classes; NaN without a spike
    # fraction of spikes with a receptor beyond a pitch of every active electrode; or NaN
    misplaced: float


def response_quality(
    finger: Finger,
    counts: NDArray[np.intp],
    active: NDArray[np.bool_],
    wanted: Collection[Afferent],
) -> ResponseQuality:
    """Return what spike counts (A,) mean for active electrodes (E,) and the classes wanted."""
    electrodes = finger.profile.electrodes
    fired = np.flatnonzero(counts)
    spikes, classes = counts[fired], finger.classes[fired]
    right = np.isin(np.arange(len(Afferent)), [int(each) for each in wanted])[classes]
    away = finger.receptor_away_mm[np.ix_(fired, active)]
    beyond = (away > electrodes.pitch_mm).all(axis=1)
    reached = (away[right] <= electrodes.pitch_mm / 2).any(axis=0)
    total = int(spikes.sum())
    share = 1 / total if total else nan
    return ResponseQuality(
        total,
        dict(zip(Afferent, np.bincount(classes, minlength=len(Afferent)).tolist(), strict=True)),
        float(1 - reached.mean()) if active.any() else 0.0,
        float(spikes[~right].sum() * share),
        float(spikes[beyond].sum() * share),
    )


def ignore_nan(how: Callable[[list[float]], float], values: Iterable[float]) -> float:
    """Return a mean or median of the values that are numbers; NaN if none is."""
    numbers = [each for each in values if not isnan(each)]
    return how(numbers) if numbers else nan


def middle_90(values: Iterable[float]) -> tuple[float, float, float]:
    """Return the median of the values that are numbers, and the bounds of their middle 90 %; NaN if
    none is."""
    known = [each for each in values if not isnan(each)]
    middle, low, high = np.quantile(known, (0.5, 0.05, 0.95)) if known else (nan, nan, nan)
    return float(middle), float(low), float(high)


def response_map(
    finger: Finger,
    counts: NDArray[np.intp],
    places_mm: NDArray[np.float64],
    blur_mm: float = 1.0,
) -> NDArray[np.float32]:
    """Return spikes of each class around places (P, 2) mm, (3, P), blurred by the standard
    deviation of a receptive field. Ours."""
    fired = counts > 0
    away = places_mm[None] - finger.receptor_mm[fired, None]
    weight = np.exp(-(away**2).sum(axis=2) / (2 * blur_mm**2)) * counts[fired, None]
    classes = finger.classes[fired]
    return np.stack([weight[classes == each].sum(axis=0) for each in Afferent]).astype(np.float32)


def in_color(spikes: NDArray[Any], most: float) -> NDArray[np.float32]:
    """Return spikes (3, ...) as inks on white, (..., 3), with full color at `most` in total."""
    image = np.ones((*spikes.shape[1:], 3), np.float32)
    for afferent, color in CLASS_COLORS.items():
        ink = 1 - np.array([int(color[at : at + 2], 16) for at in (1, 3, 5)]) / 255
        image -= spikes[afferent][..., None] / max(most, 1e-9) * ink.astype(np.float32)
    return np.clip(image, 0, 1)


@dataclass(frozen=True, eq=False)
class Feeling:
    """Spikes of a finger under scan sequences that follow each other."""

    finger: Finger
    spikes: tuple[Spikes, ...]  # one for each sequence
    active: NDArray[np.bool_]  # (E,) electrodes that were meant to stimulate
    # classes that were meant to fire; all for sequences without their steps
    wanted: tuple[Afferent, ...]

    @cached_property
    def counts(self) -> NDArray[np.intp]:
        """Number of spikes of each afferent, (A,)."""
        counts = np.zeros(len(self.finger.classes), np.intp)
        for each in self.spikes:
            counts += each.counts
        return counts

    @cached_property
    def quality(self) -> ResponseQuality:
        """Afferents that fired, silent points, and spikes of other classes and elsewhere."""
        return response_quality(self.finger, self.counts, self.active, self.wanted)


def feel(finger: Finger, given: Any, seed: int = 1) -> Feeling:
    """Return a finger's spikes under a Step, StepResult or ScanSequence, or several in order."""
    parts = list(given) if isinstance(given, Iterable) else [given]
    steps = [getattr(each, "step", each) for each in parts]
    sequences: list[SlotCurrents] = [getattr(each, "sequence", each) for each in steps]
    active = np.zeros(len(finger.profile.electrodes), np.bool_)
    wanted: set[Afferent] = set()
    for each in steps:
        if hasattr(each, "tactile"):
            active |= each.tactile.activation.any(axis=0)
            wanted.update(each.mode.afferents)
        else:
            active[getattr(each, "site", [])] = True
            wanted.update(Afferent)
    model = SpikeModel(finger, seed)
    return Feeling(finger, tuple(fire_all(model, sequences)), active, tuple(sorted(wanted)))


def fire_all(model: SpikeModel, sequences: Sequence[SlotCurrents]) -> Iterator[Spikes]:
    """Yield the spikes of sequences that follow each other; equal slots are computed once."""
    if not sequences:
        return
    current_ua = np.concatenate([each.current_ua for each in sequences])
    width_us = np.concatenate([each.width_us for each in sequences])
    above = model.drive(current_ua, width_us, firing=True)
    begin = 0
    for each in sequences:
        end = begin + len(each.width_us)
        yield model.fire(each, above[:, begin:end])
        begin = end


Counts = dict[int, NDArray[np.intp]]  # spikes of each afferent, (A,), by sequence number

FIELD_MM = 1.0  # standard deviation of a receptive field. Ours.
MOST_SLOTS = 10_000  # slots that are looked at; of more, sequences are left out evenly


@dataclass(frozen=True, eq=False)
class DeliveredSlots:
    """Slots of one delivered sequence, as `SpikeModel` takes them."""

    current_ua: NDArray[np.int16]
    width_us: NDArray[np.uint16]
    discharge_us: NDArray[np.uint16]
    period_us: int


def delivered_spikes(
    finger: Finger,
    numbers: NDArray[np.uint32],
    width_us: NDArray[np.float32],
    current_ua: NDArray[np.int16],
    period_us: Mapping[int, int],
    most_slots: int | None = None,
    model: SpikeModel | None = None,
) -> Counts:
    """Return the spikes of a finger under delivered slots (N,) of the sequences that ``period_us``
    names, those of one sequence one after another; above ``most_slots``, sequences are left out
    evenly. A model of the finger that is used again knows the patterns of before, and fires as a
    new one."""
    begins = np.flatnonzero(np.diff(numbers.astype(np.int64), prepend=-1))
    parts = zip(begins, np.append(begins[1:], len(numbers)), strict=False)
    sequences = {}
    for begin, end in parts:
        number, part = int(numbers[begin]), slice(begin, end)
        if number in period_us:
            width = width_us[part].astype(np.uint16)
            discharge = np.full(len(width), finger.profile.pulse.discharge_us, np.uint16)
            sequences[number] = DeliveredSlots(
                current_ua[part], width, discharge, period_us[number]
            )
    every = 1 if most_slots is None else 1 + len(numbers) // most_slots
    kept = dict(list(sequences.items())[::every])
    model = SpikeModel(finger) if model is None else model
    model.reset()
    spikes = fire_all(model, list(kept.values()))
    return {number: each.counts for number, each in zip(kept, spikes, strict=True)}
