"""Spikes of a finger's afferents.

In any slot few afferents are near firing. So the drives of 16 successive nodes are bounded
together, and computed only where the bound reaches what fires.
"""

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

_BLOCK = 16  # nodes that are bounded together
_AT_ONCE = 2**20  # bounds that are computed together: more leave the processor's cache
_ROUNDING = 1e-4  # more than a bound loses in float32


class NodeDrives:
    """Largest drive of each afferent under any currents.

    Rows (N, E), 1/mA, are drives of nodes; `starts`, (A,), is the first node of each afferent.
    """

    def __init__(self, rows: Floats, starts: NDArray[np.intp]) -> None:
        self._afferents = np.split(rows, starts[1:]) if len(starts) else []
        blocks = -(-np.diff(starts, append=len(rows)) // _BLOCK)
        self._owner = np.repeat(np.arange(len(starts)), blocks)
        within = np.arange(len(self._owner)) - np.repeat(np.cumsum(blocks) - blocks, blocks)
        begins = starts[self._owner] + _BLOCK * within
        self._blocks = np.split(rows, begins[1:]) if len(begins) else []

    @cached_property
    def _bounds(self) -> Floats:
        """Largest and smallest drives of each block, (B, 2 E) 1/mA; letters do without."""
        return np.array([np.r_[block.max(axis=0), block.min(axis=0)] for block in self._blocks])

    def highest(self, current_ma: Floats) -> Floats:
        """Return the largest drive of each afferent, (A, S), for currents (S, E) in mA."""
        highest_drive = np.empty((len(self._afferents), len(current_ma)), np.float32)
        for drive, rows in zip(highest_drive, self._afferents, strict=True):
            (rows @ current_ma.T).max(axis=0, out=drive)
        return highest_drive

    def highest_from(self, least: float, current_ma: Floats) -> Floats:
        """Return `highest` where it is at least so much; smaller drives may be minus infinity."""
        highest_drive = np.full((len(self._afferents), len(current_ma)), -np.inf, np.float32)
        either = np.vstack([np.maximum(current_ma.T, 0), np.minimum(current_ma.T, 0)])
        size = max(1, _AT_ONCE // max(1, len(current_ma)))
        for first in range(0, len(self._blocks), size):
            may = self._bounds[first : first + size] @ either >= least - _ROUNDING
            for block in np.flatnonzero(may.any(axis=1)):
                owner, slots = self._owner[first + block], np.flatnonzero(may[block])
                drive = (self._blocks[first + block] @ current_ma[slots].T).max(axis=0)
                highest_drive[owner, slots] = np.maximum(highest_drive[owner, slots], drive)
        return highest_drive


_KNOWN = 1024  # slots whose drives are kept
_FEW = 64  # slots of which all drives are computed sooner than bounds
_FARTHEST = 6.0
"""Standard deviations of its noise below threshold from which an afferent is not tried."""


class SlotCurrents(Protocol):
    """Currents in time: a scan sequence, or anything that has the same fields."""

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
    time_us: NDArray[np.int64]  # (S,) start of each slot, from the first sequence on

    @property
    def counts(self) -> NDArray[np.intp]:
        """Number of spikes of each afferent, (A,)."""
        return np.asarray(self.fired.sum(axis=1))


class SpikeModel:
    """Afferents of a finger that fire, with their thresholds, noise and refractoriness.

    An afferent fires in a slot where the drive of any of its nodes reaches its threshold, unless it
    fired a refractory time ago or less. A pulse counts by its width, by Weiss's law. The seed is
    that of the noise from pulse to pulse.
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
        self._drives = NodeDrives(*finger.rows)
        self._known: dict[tuple[bool, bytes], Floats] = {}
        self.reset()

    def reset(self) -> None:
        """Reset all spikes and the noise; computed drives are kept."""
        self._random = np.random.default_rng(self._seed)
        self._last_us = np.full(len(self.finger.classes), -np.inf)
        self._now_us = 0

    def drive(
        self, current_ua: NDArray[Any], width_us: NDArray[Any], firing: bool = False
    ) -> Floats:
        """Return each afferent's largest drive by currents (S, E) µA, (A, S) float32.

        1 is its threshold; currents are positive cathodic, pulse widths (S,). If they
        are only to be fired, afferents that stay silent may have minus infinity: less to compute.
        Slots that come again are computed once.
        """
        slots = np.column_stack([current_ua, width_us]).astype(np.float32)
        keys = [(firing, slot.tobytes()) for slot in slots]
        new = {key: slot for key, slot in zip(keys, slots, strict=True) if key not in self._known}
        known = self._known
        if new:
            new_drives = self._computed(np.stack(list(new.values())), firing)
            known = known | dict(zip(new, new_drives.T, strict=True))
            self._known = known if len(known) <= _KNOWN else {}
        drives = [known[key] for key in keys]
        return np.stack(drives, axis=1) if drives else self._computed(slots, firing)

    def _computed(self, slots: Floats, firing: bool) -> Floats:
        """Return drives by slots, (S, E + 1): currents in µA, and widths."""
        current_ma = slots[:, :-1] / np.float32(1000)
        by_class = strength(slots[:, -1:], self._chronaxie_us) / self._reference
        if firing and len(slots) > _FEW:
            least = (1 - _FARTHEST * self._noise.max(initial=0)) / by_class.max(initial=1e-9)
            highest = self._drives.highest_from(least, current_ma)
        else:
            highest = self._drives.highest(current_ma)
        highest *= by_class.astype(np.float32).T[self.finger.classes]
        return highest

    def fire(self, slots: SlotCurrents, above: Floats | None = None) -> Spikes:
        """Return the spikes of one sequence, by its `drive` if given; the next one follows it."""
        lasts = slots.width_us.astype(np.int64) + slots.discharge_us
        time_us = self._now_us + np.cumsum(lasts) - lasts
        if above is None:
            above = self.drive(slots.current_ua, slots.width_us, firing=True)
        # The others stay silent: so large a noise comes once in a thousand million pulses.
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
    """Return a mean or median of the values that are numbers; NaN if none is."""
    numbers = [value for value in values if not isnan(value)]
    return how(numbers) if numbers else nan


def middle_90(values: Iterable[float]) -> tuple[float, float, float]:
    """Return the median of the values that are numbers, and the bounds of their middle 90 %; NaN if
    none is."""
    known = [value for value in values if not isnan(value)]
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
    return np.stack([weight[classes == afferent].sum(axis=0) for afferent in Afferent]).astype(
        np.float32
    )


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
        for spikes in self.spikes:
            counts += spikes.counts
        return counts

    @cached_property
    def quality(self) -> ResponseQuality:
        """Afferents that fired, silent points, and spikes of other classes and elsewhere."""
        return response_quality(self.finger, self.counts, self.active, self.wanted)


def feel(finger: Finger, given: Any, seed: int = 1) -> Feeling:
    """Return a finger's spikes under a Step, StepResult or ScanSequence, or several in order."""
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
    """Yield the spikes of sequences that follow each other; equal slots are computed once."""
    if not sequences:
        return
    current_ua = np.concatenate([sequence.current_ua for sequence in sequences])
    width_us = np.concatenate([sequence.width_us for sequence in sequences])
    above = model.drive(current_ua, width_us, firing=True)
    begin = 0
    for sequence in sequences:
        end = begin + len(sequence.width_us)
        yield model.fire(sequence, above[:, begin:end])
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
    sampled = dict(list(sequences.items())[::every])
    model = SpikeModel(finger) if model is None else model
    model.reset()
    spikes = fire_all(model, list(sampled.values()))
    return {number: fired.counts for number, fired in zip(sampled, spikes, strict=True)}
