"""Spikes of a simulated finger's afferents, and the quality of its response."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isnan, nan
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import CLASS_COLORS, Afferent
from smarttouch.physiology.finger import Finger, strength

Floats = NDArray[np.float32]

_KNOWN = 1024  # largest number of slots whose drives are cached
_AT_ONCE = 64  # slots whose drives are computed together, which takes about 40 MB
_FARTHEST = 6.0
"""An afferent is assumed silent this far below threshold, in standard deviations of noise."""


class SlotCurrents(Protocol):
    """Currents over time: a scan sequence, or an object with the same fields."""

    @property
    def current_ua(self) -> NDArray[np.int16]: ...
    @property
    def width_us(self) -> NDArray[np.uint16]: ...
    @property
    def discharge_us(self) -> NDArray[np.uint16]: ...
    @property
    def period_us(self) -> int: ...


@dataclass(frozen=True, eq=False)
class Spikes:
    """Spikes of one sequence."""

    fired: NDArray[np.bool_]  # (A, S) whether each afferent fired in each slot
    time_us: NDArray[np.int64]  # (S,) start of each slot, since the start of the first sequence

    @property
    def counts(self) -> NDArray[np.intp]:
        """Number of spikes of each afferent, (A,)."""
        return np.asarray(self.fired.sum(axis=1))


class SpikeModel:
    """Spiking model of a finger's afferents, with thresholds, noise and refractory periods.

    An afferent fires in a slot if the drive of one of its nodes reaches the threshold, unless the
    afferent fired within the refractory period. Drives depend on pulse width by Weiss's law.
    ``seed`` determines the noise: random changes of thresholds from pulse to pulse.
    """

    def __init__(self, finger: Finger, seed: int = 1) -> None:
        self.finger = finger
        anatomy = [one.anatomy for one in finger.populations.values()]
        classes = finger.classes
        self._chronaxie_us = np.array(
            [class_anatomy.chronaxie_us for class_anatomy in anatomy], np.float32
        )
        self._noise = np.array([class_anatomy.noise for class_anatomy in anatomy], np.float32)[
            classes
        ]
        self._refractory_us = np.array([class_anatomy.refractory_us for class_anatomy in anatomy])[
            classes
        ]
        self._seed = seed
        self._reference = strength(finger.profile.pulse.width_us, self._chronaxie_us)
        self._rows, self._starts = finger.rows
        self._known: dict[bytes, Floats] = {}
        self.reset()

    def reset(self) -> None:
        """Forget all spikes and restart the noise; keep cached drives."""
        self._random = np.random.default_rng(self._seed)
        self._last_us = np.full(len(self.finger.classes), -np.inf)
        self._now_us = 0

    def drive(self, current_ua: NDArray[Any], width_us: NDArray[Any]) -> Floats:
        """Return each afferent's largest drive, (A, S) float32; 1 is the threshold.

        Currents, (S, E) µA, are positive cathodic; widths are (S,) µs. Repeated slots are computed
        once.
        """
        slots = np.column_stack([current_ua, width_us]).astype(np.float32)
        keys = [slot.tobytes() for slot in slots]
        new = {key: slot for key, slot in zip(keys, slots, strict=True) if key not in self._known}
        known = self._known
        for begin in range(0, len(new), _AT_ONCE):
            part = dict(list(new.items())[begin : begin + _AT_ONCE])
            known = known | dict(zip(part, self._computed(np.stack([*part.values()])), strict=True))
        self._known = known if len(known) <= _KNOWN else {}
        drives = [known[key] for key in keys]
        return np.stack(drives, axis=1) if drives else self._computed(slots).T

    def _computed(self, slots: Floats) -> Floats:
        """Return drives, (S, A). Each slot, (E + 1,), has the currents, µA, and the width, µs."""
        nodes = slots[:, :-1] / np.float32(1000) @ self._rows.T
        by_class = strength(slots[:, -1:], self._chronaxie_us) / self._reference
        starts = self._starts
        highest = np.maximum.reduceat(nodes, starts, axis=1) if len(starts) else nodes
        return np.asarray(highest * by_class.astype(np.float32)[:, self.finger.classes])

    def fire(self, slots: SlotCurrents, above: Floats | None = None) -> Spikes:
        """Return the spikes of a sequence that begins when the sequence of the previous call ends.
        ``above`` is the result of `drive` for the slots. If it is None, `drive` is called."""
        lasts = slots.width_us.astype(np.int64) + slots.discharge_us
        time_us = self._now_us + np.cumsum(lasts) - lasts
        if above is None:
            above = self.drive(slots.current_ua, slots.width_us)
        # Skip afferents far below threshold: noise fires such an afferent once in 10⁹ pulses.
        near = np.flatnonzero((above >= 1 - _FARTHEST * self._noise[:, None]).any(axis=1))
        spread = self._noise[near, None] * self._random.standard_normal(
            (len(near), above.shape[1]), np.float32
        )
        chosen = above[near] >= 1 + spread
        last_us, rest_us = self._last_us[near], self._refractory_us[near]
        for slot, begin_us in enumerate(time_us):
            chosen[:, slot] &= begin_us - last_us >= rest_us
            last_us[chosen[:, slot]] = begin_us
        self._last_us[near] = last_us
        fired = np.zeros(above.shape, np.bool_)
        fired[near] = chosen
        self._now_us += slots.period_us
        return Spikes(fired, time_us)


@dataclass(frozen=True)
class ResponseQuality:
    """Quality of a finger's response to a pattern. An electrode is active if it was requested to
    stimulate."""

    spikes: int  # of all classes
    afferents: dict[Afferent, int]  # number of afferents that fired, by class
    # share of active electrodes with no spikes of a wanted class within half a pitch
    silent_points: float
    wrong_class: float  # share of all spikes that belong to unwanted classes; NaN without spikes
    # share of spikes more than a pitch away from all active electrodes; NaN without spikes
    misplaced: float


def response_quality(
    finger: Finger,
    counts: NDArray[np.intp],
    active: NDArray[np.bool_],
    wanted: Collection[Afferent],
) -> ResponseQuality:
    """Return the quality of spike counts, (A,). ``active``, (E,), marks the electrodes that should
    stimulate. ``wanted`` are the requested classes."""
    electrodes = finger.profile.electrodes
    fired = np.flatnonzero(counts)
    spikes, classes = counts[fired], finger.classes[fired]
    right = np.isin(np.arange(len(Afferent)), [int(afferent) for afferent in wanted])[classes]
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
    """Apply a mean or median to the values that are not NaN; return NaN if there are none."""
    numbers = [value for value in values if not isnan(value)]
    return how(numbers) if numbers else nan


def middle_90(values: Iterable[float]) -> tuple[float, float, float]:
    """Return the median and the bounds of the middle 90 % of values. NaN values are ignored; if
    there are no other values, return NaN."""
    known = [value for value in values if not isnan(value)]
    middle, low, high = np.quantile(known, (0.5, 0.05, 0.95)) if known else (nan, nan, nan)
    return float(middle), float(low), float(high)


def response_map(
    finger: Finger,
    counts: NDArray[np.intp],
    places_mm: NDArray[np.float64],
    blur_mm: float = 1.0,
) -> NDArray[np.float32]:
    """Return the density of spikes of each class, (3, P), at places, (P, 2) mm. Each spike
    is blurred by a Gaussian with the standard deviation ``blur_mm`` (our choice)."""
    fired = counts > 0
    away = places_mm[None] - finger.receptor_mm[fired, None]
    weight = np.exp(-(away**2).sum(axis=2) / (2 * blur_mm**2)) * counts[fired, None]
    classes = finger.classes[fired]
    return np.stack([weight[classes == afferent].sum(axis=0) for afferent in Afferent]).astype(
        np.float32
    )


def in_color(spikes: NDArray[Any], most: float) -> NDArray[np.float32]:
    """Return colors, (..., 3), for spike counts, (3, ...): white at 0, full color at ``most``."""
    image = np.ones((*spikes.shape[1:], 3), np.float32)
    for afferent, color in CLASS_COLORS.items():
        ink = 1 - np.array([int(color[at : at + 2], 16) for at in (1, 3, 5)]) / 255
        image -= spikes[afferent][..., None] / max(most, 1e-9) * ink.astype(np.float32)
    return np.clip(image, 0, 1)


@dataclass(frozen=True, eq=False)
class Feeling:
    """Response of a finger to consecutive scan sequences."""

    finger: Finger
    spikes: tuple[Spikes, ...]  # one for each sequence
    active: NDArray[np.bool_]  # (E,) electrodes that were requested to stimulate
    # requested classes; all classes if the input is or contains a ScanSequence
    wanted: tuple[Afferent, ...]

    @cached_property
    def counts(self) -> NDArray[np.intp]:
        """Number of spikes of each afferent, (A,)."""
        counts = np.zeros(len(self.finger.classes), np.intp)
        for spikes in self.spikes:
            counts += spikes.counts
        return counts

    @cached_property
    def quality(self) -> ResponseQuality:
        """Quality of the response to all sequences together."""
        return response_quality(self.finger, self.counts, self.active, self.wanted)


def feel(finger: Finger, given: Any, seed: int = 1) -> Feeling:
    """Return a finger's response to a Step, StepResult or ScanSequence, or to several in order."""
    parts = list(given) if isinstance(given, Iterable) else [given]
    steps = [getattr(part, "step", part) for part in parts]
    sequences: list[SlotCurrents] = [getattr(step, "sequence", step) for step in steps]
    active = np.zeros(len(finger.profile.electrodes), np.bool_)
    wanted: set[Afferent] = set()
    for step in steps:
        if hasattr(step, "tactile"):
            active |= step.tactile.activation.any(axis=0)
            wanted.update(step.mode.afferents)
        else:
            active[getattr(step, "site", [])] = True
            wanted.update(Afferent)
    model = SpikeModel(finger, seed)
    return Feeling(finger, tuple(fire_all(model, sequences)), active, tuple(sorted(wanted)))


def fire_all(model: SpikeModel, sequences: Sequence[SlotCurrents]) -> Iterator[Spikes]:
    """Yield the spikes of consecutive sequences; equal slots are computed once."""
    if not sequences:
        return
    current_ua = np.concatenate([sequence.current_ua for sequence in sequences])
    width_us = np.concatenate([sequence.width_us for sequence in sequences])
    above = model.drive(current_ua, width_us)
    begin = 0
    for sequence in sequences:
        end = begin + len(sequence.width_us)
        yield model.fire(sequence, above[:, begin:end])
        begin = end


Counts = dict[int, NDArray[np.intp]]  # spikes of each afferent, (A,), by sequence number

FIELD_MM = 1.0  # standard deviation of a receptive field (our choice)
MOST_SLOTS = 10_000  # value of ``most_slots`` for pictures of a run


@dataclass(frozen=True, eq=False)
class DeliveredSlots:
    """Slots of one delivered sequence, as input of `SpikeModel`."""

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
    """Return the spike counts of afferents, (A,), by sequence number. ``numbers`` has the sequence
    number of each slot. The slots of a sequence are consecutive. Sequences that are missing in
    ``period_us`` are left out. If there are more than ``most_slots`` slots, only every n-th
    sequence is used. ``model`` is reset first."""
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
    sampled = dict(list(sequences.items())[::every])
    model = SpikeModel(finger) if model is None else model
    model.reset()
    spikes = fire_all(model, list(sampled.values()))
    return {number: fired.counts for number, fired in zip(sampled, spikes, strict=True)}
