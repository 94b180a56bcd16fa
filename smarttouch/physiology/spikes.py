"""Spikes of a finger's afferents, and margins of those that a display must not fire.

A point's slot is its kernel times an amplitude, so a pattern seen before, scaled, is looked up:
drives are linear in the currents. The lookup is exact where an afferent may fire. It keeps
every node that may then have the largest drive, and multiplies those with the actual currents.
Which nodes these are is found out when a pattern comes again, as most new ones never do.

Afferents that must not fire are SAII, and the free endings of Aδ and C fibers.

They are drawn as the others of a finger are, from the same anatomy and with seeds of their own.
Free endings are a sample: each stands for the same number of its class.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from smarttouch.physiology.anatomy import Anatomy, Bystander, load_anatomy
from smarttouch.physiology.finger_afferents import FingerAfferents, Population, strength
from smarttouch.profile import Profile

Floats = NDArray[np.float32]
Indices = NDArray[np.intp]

_TOLERANCE = 0.01
"""Largest effect on any drive of currents that are not in proportion: whole microamperes."""
_FEWEST, _MOST = 0.5, 1.02
"""Amplitudes, of that at which a pattern was seen first, at which it is looked up."""
_ALIKE = 2 * _TOLERANCE / _FEWEST  # nodes whose drives differ by less may change places
_PATTERNS = 256
_ROWS_AT_ONCE = 8192


@dataclass(frozen=True, eq=False)
class _Known:
    """Drives (A,) under a pattern, and the node rows (M, E) of the afferents that may fire.

    Rows of afferent ``fires[i]`` begin at ``starts[i]``.
    """

    drive: Floats
    fires: Indices
    starts: Indices
    rows: Floats


class DriveMemory:
    """Largest drive of each afferent under any currents.

    Rows (N, E), 1/mA, are drives of nodes; `starts`, (A,), is the first node of each afferent.
    Drives from `exact_from` on are exact but for float32; smaller ones may be off by 0.01.
    """

    def __init__(self, rows: Floats, starts: Indices, exact_from: float) -> None:
        self._rows, self._starts = rows, starts
        # A pattern is known from up to twice the amplitude, and from a fiftieth less.
        self._kept_from = exact_from / _MOST - _ALIKE
        self._owner = np.repeat(np.arange(len(starts)), np.diff(np.r_[starts, len(rows)]))
        cuts = np.searchsorted(starts, np.arange(0, len(rows), _ROWS_AT_ONCE))
        parts = pairwise(np.unique(np.r_[cuts, len(starts)]).tolist())
        ends = [*starts.tolist(), len(rows)]
        # Runs of afferents, with their nodes, and where each begins among these.
        self._parts = [(a, b, slice(ends[a], ends[b]), starts[a:b] - ends[a]) for a, b in parts]
        self._steepest = np.zeros((len(starts), rows.shape[1]), np.float32)
        for first, last, here, begins in self._parts:
            self._steepest[first:last] = np.maximum.reduceat(np.abs(rows[here]), begins)
        self._patterns = np.zeros((_PATTERNS, rows.shape[1]), np.float32)
        self._square = np.full(_PATTERNS, np.inf, np.float32)
        self._known: list[_Known | None] = [None] * _PATTERNS
        self._next = 0

    def drive(self, current_ma: Floats) -> Floats:
        """Return the largest drive of each afferent, (A, S), for currents (S, E) in mA."""
        highest = np.empty((len(self._starts), len(current_ma)), np.float32)
        which, scale = self._find(current_ma)
        again = np.unique(which[which >= 0])
        self._learn(np.array([each for each in again if self._known[each] is None], np.intp))
        for slot in np.flatnonzero(which >= 0):
            known = self._known[which[slot]]
            assert known is not None
            highest[:, slot] = scale[slot] * known.drive
            if len(known.fires):
                exact = np.maximum.reduceat(known.rows @ current_ma[slot], known.starts)
                highest[known.fires, slot] = exact
        new = np.flatnonzero(which < 0)
        if len(new):
            found = np.empty((len(self._starts), len(new)), np.float32)
            for first, last, _, _, most in self._drives(current_ma[new]):
                found[first:last] = most
            highest[:, new] = found
            self._remember(current_ma[new][-_PATTERNS:])
        return highest

    def _remember(self, current_ma: Floats) -> None:
        """Store new patterns in place of the oldest."""
        places = (self._next + np.arange(len(current_ma))) % _PATTERNS
        self._next = (self._next + len(current_ma)) % _PATTERNS
        self._patterns[places] = current_ma
        square = (current_ma * current_ma).sum(axis=1)
        self._square[places] = np.where(square > 0, square, np.inf)
        for each in places:
            self._known[each] = None

    def _find(self, current_ma: Floats) -> tuple[Indices, Floats]:
        """Return the known pattern of each slot, -1 if there is none, and its amplitude."""
        along = current_ma @ self._patterns.T
        scale = along / self._square
        close = np.where((scale >= _FEWEST) & (scale <= _MOST), along * scale, -1.0)
        which = np.asarray(close.argmax(axis=1), np.intp)
        slots = np.arange(len(which))
        scale = scale[slots, which]
        rest = np.abs(current_ma - scale[:, None] * self._patterns[which])
        off = (self._steepest @ rest.T).max(axis=0, initial=0)
        which[(close[slots, which] < 0) | (off > _TOLERANCE)] = -1
        return which, scale

    def _learn(self, places: Indices) -> None:
        """Compute the drives under patterns at all nodes."""
        if not len(places):
            return
        highest = np.empty((len(self._starts), len(places)), np.float32)
        nodes, slots = [np.zeros(0, np.intp)], [np.zeros(0, np.intp)]
        for first, last, begin, drive, most in self._drives(self._patterns[places]):
            highest[first:last] = most
            high = np.flatnonzero(drive >= self._kept_from)
            node, slot = np.divmod(high, len(places))
            alike = drive.ravel()[high] >= highest[self._owner[begin + node], slot] - _ALIKE
            nodes.append(begin + node[alike])
            slots.append(slot[alike])
        node, slot = np.concatenate(nodes), np.concatenate(slots)
        for each, place in enumerate(places):
            mine = node[slot == each]
            fires, starts = np.unique(self._owner[mine], return_index=True)
            drive = highest[:, each].copy()
            self._known[place] = _Known(drive, fires, starts, self._rows[mine])

    def _drives(self, current_ma: Floats) -> Iterator[tuple[int, int, int, Floats, Floats]]:
        """Yield runs of afferents, first and after the last, with the first of their nodes.

        With them come the drives of these nodes, (N, S), and each afferent's largest, (A, S).
        """
        columns = np.ascontiguousarray(current_ma.T)
        for first, last, here, begins in self._parts:
            drive = self._rows[here] @ columns
            yield first, last, here.start, drive, np.maximum.reduceat(drive, begins)


_EXACT_FROM = 0.9
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

    def __init__(self, finger: FingerAfferents, seed: int = 1) -> None:
        self.finger = finger
        anatomy = [one.anatomy for one in finger.populations.values()]
        classes = finger.classes
        self._chronaxie_us = np.array([each.chronaxie_us for each in anatomy], np.float32)
        self._noise = np.array([each.noise for each in anatomy], np.float32)[classes]
        self._refractory_us = np.array([each.refractory_us for each in anatomy])[classes]
        self._seed = seed
        self._reference = strength(finger.profile.pulse.width_us, self._chronaxie_us)
        longest = strength(finger.profile.limits.pulse_us, self._chronaxie_us) / self._reference
        self._drives = DriveMemory(*finger.rows, _EXACT_FROM / max(1.0, longest.max()))
        self.reset()

    def reset(self) -> None:
        """Reset all spikes and the noise; computed drives are kept."""
        self._random = np.random.default_rng(self._seed)
        self._last_us = np.full(len(self.finger.classes), -np.inf)
        self._now_us = 0

    def drive(self, current_ua: NDArray[Any], width_us: NDArray[Any]) -> Floats:
        """Return each afferent's largest drive by currents (S, E) µA, (A, S) float32.

        1 is its threshold; currents are positive cathodic, pulse widths (S,). Drives from 0.9 on
        are exact. A smaller one is at most 0.01 off where the slot's currents are those of an
        earlier slot, scaled.
        """
        highest = self._drives.drive(np.asarray(current_ua, np.float32) / np.float32(1000))
        width = np.asarray(width_us, np.float32)[:, None]
        by_class = (strength(width, self._chronaxie_us) / self._reference).astype(np.float32)
        highest *= by_class.T[self.finger.classes]
        return np.asarray(highest)

    def fire(self, slots: SlotCurrents, above: Floats | None = None) -> Spikes:
        """Return the spikes of one sequence, by its `drive` if given; the next one follows it."""
        lasts = slots.width_us.astype(np.int64) + slots.discharge_us
        time_us = self._now_us + np.cumsum(lasts) - lasts
        if above is None:
            above = self.drive(slots.current_ua, slots.width_us)
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


NOCICEPTORS = (Bystander.A_DELTA, Bystander.C)


class Bystanders(FingerAfferents):
    """Afferents of one finger that must not fire; see `FingerAfferents` for parameters."""

    def __init__(
        self, profile: Profile, seed: int = 1, anatomy: str | Path | Anatomy = "branched"
    ) -> None:
        self.profile: Profile = profile
        self.seed: int = seed
        self.anatomy: Anatomy = anatomy if isinstance(anatomy, Anatomy) else load_anatomy(anatomy)
        self.populations: dict[Any, Population] = {
            each: self._populate(each, anatomy) for each, anatomy in self.anatomy.bystanders.items()
        }

    @cached_property
    def model(self) -> SpikeModel:
        """Their drives."""
        return SpikeModel(self)


@dataclass(frozen=True)
class Margin:
    """Distance of a class from firing."""

    margin: float  # factor on all currents from which one of the sample fires; infinite if none can
    fired: float  # fraction of the sample that fires in any slot


def margins(others: Bystanders, shown: Sequence[SlotCurrents]) -> dict[Bystander, Margin]:
    """Return the margin of each class under all of some sequences, as they are delivered."""
    highest = np.zeros(len(others.classes), np.float32)
    for slots in shown:
        drive = others.model.drive(slots.current_ua, slots.width_us)
        highest = np.maximum(highest, drive.max(axis=1, initial=0.0))
    found = {}
    for index, each in enumerate(others.populations):
        mine = highest[others.classes == index]
        most = float(mine.max(initial=0.0))
        found[each] = Margin(
            1 / most if most else np.inf, float((mine >= 1).sum() / max(1, mine.size))
        )
    return found


def nociceptive_margin(found: dict[Bystander, Margin]) -> float:
    """Return the smaller margin of Aδ and C; infinite if there are none."""
    return min((found[each].margin for each in NOCICEPTORS if each in found), default=np.inf)
