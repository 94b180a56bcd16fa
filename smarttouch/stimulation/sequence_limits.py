"""Integer checks of limits: for each scan sequence, for any second, and for the session."""

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass
from math import ceil, floor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.clock import LATE_NS
from smarttouch.base.errors import SafetyError
from smarttouch.profile.project_ceilings import (
    BURST_S,
    CEILING_MEAN_MA,
    CEILING_NET_MA,
    CEILING_PULSES_HZ,
    LEAST_DISCHARGE_US,
)
from smarttouch.stimulation.safety_limits import PPB, SafetyLimits, decimal, refusal
from smarttouch.stimulation.scan_sequence import ScanSequence

STRENGTH = 4
"""Strength is at most this factor times relative charge. The relative charge of a sequence is the
largest charge of a pulse, divided by the charge of a full pulse. With the shipped kernels, the
faintest gray needs a factor below 3."""
LONGEST_PERIOD_US = 60_000_000
LARGEST_TIME_NS = 2**62
MOST_RECHARGE_US = 20_000  # longest recharge phase: one period at 50 Hz (our choice)
MOST_RECHARGE_PC = 2_000_000  # largest recharge of an electrode: 4 pulses of 0.5 µC (our choice)
BURST_US = round(1e6 * BURST_S)
PER_PULSE = 1_000_000
PER_PC = round(1000 * CEILING_PULSES_HZ / (1e6 * CEILING_MEAN_MA))
"""The number of perceptible pulses is multiplied by `PER_PULSE`, and charge in pC by `PER_PC`. Both
products then have the same limit: `MOST_PER_US` per microsecond."""
MOST_PER_US = round(CEILING_PULSES_HZ)
NET_PC = round(1e9 * CEILING_NET_MA)  # largest net charge of an electrode in a second
PLANNED = 0.9  # share of a limit that schedulers use; the rest is a margin for jitter

WINDOW_NS = 1_000_000_000
_LAST_NS = WINDOW_NS - 1

Charge = NDArray[np.float64]  # (E,) signed pC: integers below 2^53
Sums = NDArray[np.float64]
"""Sums for each electrode, (3, E). Row 0: number of perceptible pulses × `PER_PULSE`. Row 1:
charge, pC, × `PER_PC`. Row 2: net charge, pC, positive cathodic. The sums are integers far below
2^53, so double precision is exact."""


def add_up(
    current_ua: NDArray[np.int16], width_us: NDArray[np.uint16], felt_ua: NDArray[np.float32]
) -> tuple[Sums, NDArray[np.float64], NDArray[np.float64]]:
    """Return the `Sums` of all slots, the currents as float64, (S, E), and their magnitudes.
    At least one slot is required. Pulses of ``felt_ua``, (E,), or more count as perceptible."""
    currents, widths = current_ua.astype(np.float64), width_us.astype(np.float64)
    magnitudes = np.abs(currents)
    felt = PER_PULSE * np.add.reduce(magnitudes >= felt_ua, axis=0)
    sums = np.array([felt, PER_PC * (widths @ magnitudes), widths @ currents])
    return sums, currents, magnitudes


def strength_ppb(limits: SafetyLimits, ppb: int, peak_pc: int) -> int:
    """Return the strength of a sequence in parts per billion.

    Strength is the stated intensity, ``ppb``, clipped to a range. The lower bound is the largest
    charge of a pulse, ``peak_pc``, divided by the charge of a full pulse. The upper bound is
    `STRENGTH` times the lower bound.
    """
    full, parts = limits.full_ratio
    share = -(-peak_pc * PPB * parts // (full * limits.width_whole_us))
    return min(PPB, max(share, min(ppb, STRENGTH * share)))


class PassLoad(NamedTuple):
    """Pulses, charge, duration and strength of one pass of a sequence."""

    sums: Sums  # including the recharge phase
    recharge_pc: NDArray[np.float64] | None  # (E,) charge of the recharge phase, cathodic > 0
    busy_us: int  # duration of slots and recharge phase
    strength_ppb: int  # result of the function `strength_ppb`; 0 if no current flows
    peak_ua: int  # strongest current


def prove_sequence(sequence: ScanSequence, limits: SafetyLimits, ppb: int) -> PassLoad:
    """Check a frozen sequence of intensity ``ppb``, and return its `PassLoad`. Raises SafetyError
    with the limit, slot, electrode and values."""
    width_us, (busy_us, narrow_us, wide_us) = sequence.width_us, _prove_numbers(sequence, limits)
    if not busy_us:
        return PassLoad(np.zeros((3, limits.electrodes)), None, 0, 0, 0)
    sums, current_ua, magnitude_ua = add_up(sequence.current_ua, width_us, limits.felt_ua)
    net_ua, total_ua = np.add.reduce(current_ua, axis=1), np.add.reduce(magnitude_ua, axis=1)
    if net_ua.any():
        slot = int(np.abs(net_ua).argmax())
        raise refusal("balance", int(net_ua[slot]), 0, slot)
    highest_ua = np.maximum.reduce(magnitude_ua, axis=0)
    if (highest_ua > limits.current_ua).any():
        _prove_each("current_ma", magnitude_ua, limits.current_ua, 1000)
    # Currents sum to zero, so cathodes carry half of the sum of magnitudes.
    if np.maximum.reduce(total_ua) > 2 * limits.total_ua:
        slot = int(total_ua.argmax())
        raise refusal("total_ma", total_ua[slot] / 2000, limits.total_ma, slot)
    peak_ua = int(np.maximum.reduce(highest_ua))
    peak_pc = peak_ua * wide_us
    if (highest_ua * wide_us > limits.charge_pc).any() or narrow_us < wide_us:
        charge_pc = magnitude_ua * width_us.astype(np.float64)[:, None]
        _prove_each("charge_uc", charge_pc, limits.charge_pc, 1_000_000)
        peak_pc = int(charge_pc.max())
    # If all other electrodes lack contact, one electrode carries all charge of the source.
    if limits.one_source and (total_ua * width_us).max() > 2 * limits.source_pc:
        slot = int((total_ua * width_us).argmax())
        source_uc = total_ua[slot] * float(width_us[slot]) / 2e6
        raise refusal("source", source_uc, limits.charge_uc, slot)
    full, parts = limits.full_ratio
    room = (limits.electrodes + 2) * parts * PPB  # tolerance for rounding: E / 2 + 1 µA
    if peak_ua > (most_ua := (2 * full * ppb + room) // (2 * parts * PPB)):
        raise refusal("claimed_ma", peak_ua / 1000, most_ua / 1000)
    recharge_pc = None
    if sequence.recharge_ua is not None:
        recharge_pc = sequence.recharge_ua.astype(np.float64) * sequence.recharge_us
        sums[1] += PER_PC * np.abs(recharge_pc)
        sums[2] += recharge_pc
    return PassLoad(sums, recharge_pc, busy_us, strength_ppb(limits, ppb, peak_pc), peak_ua)


def _prove_numbers(sequence: ScanSequence, limits: SafetyLimits) -> tuple[int, int, int]:
    """Return the duration of slots and recharge phase, and the shortest and longest pulse, µs.
    Raises SafetyError unless numbers, times and lengths are within their ranges."""
    electrodes, period_us, recharge_us = limits.electrodes, sequence.period_us, sequence.recharge_us
    if sequence.recharge_ua is not None or recharge_us:
        _prove_recharge(sequence, limits)
    if sequence.vibration is not None:
        _prove_vibration(sequence.vibration, sequence.intensity, electrodes)
    widths_us, rests_us = sequence.width_us.tolist(), sequence.discharge_us.tolist()
    columns, least_rest_us = sequence.current_ua.shape[1], min(rests_us, default=LEAST_DISCHARGE_US)
    pulses_us, site = sum(widths_us), max(sequence.site.tolist(), default=0)
    narrow_us, wide_us = min(widths_us, default=1), max(widths_us, default=1)
    busy_us, flowing_us = pulses_us + sum(rests_us) + recharge_us, pulses_us + recharge_us
    needed_us = busy_us + LEAST_DISCHARGE_US * (recharge_us > 0)
    least_us, (part, duty_whole) = limits.period_us, limits.duty_ratio
    for fits, sentence, value, allowed in (
        (columns == electrodes, "electrodes", columns, electrodes),
        (0 <= sequence.intensity <= 1, "intensity", sequence.intensity, 1),
        (0 <= sequence.time_ns < LARGEST_TIME_NS, "time_ns", sequence.time_ns, LARGEST_TIME_NS),
        (site < electrodes, "site", site, electrodes - 1),
        (least_us <= period_us <= LONGEST_PERIOD_US, "rate_hz", period_us, least_us),
        (needed_us <= period_us, "period_us", needed_us, period_us),
        (narrow_us > 0, "pulse_us", narrow_us, limits.pulse_us),
        (wide_us <= limits.pulse_whole_us, "pulse_us", wide_us, limits.pulse_us),
    ):
        if not fits:
            raise refusal(sentence, value, allowed)
    if flowing_us * duty_whole > part * period_us:
        raise refusal("duty", flowing_us / period_us, limits.duty)
    if least_rest_us < LEAST_DISCHARGE_US:
        slot = rests_us.index(least_rest_us)
        raise refusal("discharge_us", least_rest_us, LEAST_DISCHARGE_US, slot)
    return busy_us, narrow_us, wide_us


def _prove_vibration(vibration: NDArray[np.float32], intensity: float, electrodes: int) -> None:
    """Raise SafetyError unless each electrode has a vibration between 0 and the intensity."""
    if vibration.shape != (electrodes,):
        raise refusal("vibration", len(vibration), electrodes)
    # Convert to double precision, the type of the intensity. NaN fails the comparison.
    wide = vibration.astype(np.float64)
    if not ((wide >= 0) & (wide <= intensity + 1e-6)).all():
        worst = wide[np.abs(wide - intensity / 2).argmax()]
        raise refusal("vibrates", worst, intensity)


def _prove_recharge(sequence: ScanSequence, limits: SafetyLimits) -> None:
    """Raise SafetyError if the recharge phase exceeds a limit. `Exposure` checks that the phase
    only returns charge."""
    current_ua, width_us, most_ua = sequence.recharge_ua, sequence.recharge_us, limits.faint_ua
    if current_ua is None or current_ua.shape != most_ua.shape or not sequence.slots:
        raise refusal("recharge", np.nan, limits.electrodes)
    if not 1 <= width_us <= MOST_RECHARGE_US:
        raise refusal("recharge_us", width_us, MOST_RECHARGE_US)
    wide_ua = current_ua.astype(np.int64)
    if left_ua := int(wide_ua.sum()):
        raise refusal("recharge_balance", left_ua, 0)
    strongest_ua = np.abs(wide_ua)
    allowed_ua = np.minimum(most_ua, MOST_RECHARGE_PC // width_us)
    if (strongest_ua > allowed_ua).any():
        at = int((strongest_ua - allowed_ua).argmax())
        raise refusal("recharge_ua", strongest_ua[at], allowed_ua[at], electrode=at)
    if (all_ua := int(strongest_ua.sum()) // 2) > limits.total_ua:
        raise refusal("recharge_ma", all_ua / 1000, limits.total_ua / 1000)


def _prove_each(
    limit: str, values: NDArray[np.float64], allowed: NDArray[np.float64], unit: int
) -> None:
    """Raise SafetyError if a value, (S, E), exceeds the limit of its electrode, (E,)."""
    if (values > allowed).any():
        slot, at = divmod(int((values - allowed).argmax()), values.shape[1])
        raise refusal(limit, values[slot, at] / unit, allowed[at] / unit, slot, at)


@dataclass(frozen=True)
class Dose:
    """Dose of current in a session.

    Attributes
    ----------
    seconds : float
        Total time of scans with current.
    charge_mc : tuple of float, (E,) mC
        Sum of the magnitudes of charge through each electrode.
    net_uc : tuple of float, (E,) µC
        Net charge through each electrode, positive cathodic.
    """

    seconds: float
    charge_mc: tuple[float, ...]
    net_uc: tuple[float, ...] = ()

    @property
    def most_mc(self) -> float:
        return max(self.charge_mc, default=0.0)

    @property
    def most_net_uc(self) -> float:
        """Largest net charge of any electrode, µC (magnitude)."""
        return max(map(abs, self.net_uc), default=0.0)


class _Pass(NamedTuple):
    """Pass of a sequence, from its start to the end of its slots and recharge phase."""

    start_ns: int
    end_ns: int
    sums: Sums
    most: float  # upper bound of `sums[:2]` and of |net charge| × `PER_PC`


class _Sent(NamedTuple):
    """Sequence that `Exposure` accepted. Its first pass is in `Exposure._window`."""

    first: _Pass
    period_ns: int
    times: int
    flows: bool

    def cut_short(self, now_ns: int) -> tuple[int, list[_Pass], int]:
        """Return three values for a new sequence sent at ``now_ns``: its start, the old sequence's
        recent passes except the first, and the number of the old sequence's dropped passes."""
        # The board delivers the first pass in any case, even if it begins after `now_ns`.
        first, period_ns = self.first, self.period_ns
        begun = max(1, min(self.times, (now_ns - first.start_ns) // period_ns + 1))
        delays_ns = [
            index * period_ns for index in range(max(1, begun - WINDOW_NS // period_ns - 2), begun)
        ]
        repeated = [
            first._replace(start_ns=first.start_ns + by_ns, end_ns=first.end_ns + by_ns)
            for by_ns in delays_ns
        ]
        over_ns = first.start_ns + begun * period_ns
        return max(now_ns, over_ns), repeated, self.times - begun


class Exposure:
    """Dose limits: running sums over the last second and over the session, by the display's clock.

    The time of each pass is computed, not measured. This is possible because a board finishes each
    pass before it begins the next one.
    """

    def __init__(self, limits: SafetyLimits) -> None:
        self._limits = limits
        self._most_of_session = limits.session_mc * 1e9 * PER_PC
        self._most_session_ns = floor(decimal(limits.session_s) * 10**9)
        # largest number of passes in a second, including late passes that catch up
        rate_hz = decimal(limits.rate_hz)
        self._most_passes = ceil(rate_hz * (WINDOW_NS + LATE_NS) / WINDOW_NS) + 1
        # passes with any part in the last second or in the future
        self._window: deque[_Pass] = deque()
        self.begin_session(None)
        self.forget_second()

    @property
    def dose(self) -> Dose:
        """Dose of the session. It counts all passes of the last sequence, even future passes."""
        charge_mc = self._session[1] / (PER_PC * 1e9)
        net_uc = self._session[2] / 1e6
        return Dose(self._session_ns / 1e9, tuple(charge_mc.tolist()), tuple(net_uc.tolist()))

    @property
    def net_pc(self) -> NDArray[np.int64]:
        """Net charge of each electrode in the session, (E,) pC, positive cathodic."""
        return np.asarray(self._session[2], np.int64)

    def begin_session(self, now_ns: int | None) -> None:
        """Reset the dose. Passes that have begun still count toward the limits per second."""
        if now_ns is not None and self._last is not None:
            for scan in self._last.cut_short(now_ns)[1]:
                self._window.append(scan)
                self._second_at_most += scan.most
                self._net_at_most += scan.most
        self._last: _Sent | None = None
        self._session: Sums = np.zeros((3, self._limits.electrodes))
        self._session_ns = 0

    def forget_second(self) -> None:
        """Forget the last second's passes, because times restart at 0. Keep the session's dose."""
        self._last = None
        self._window.clear()
        # `_second_at_most` is an upper bound of the sums of the last second. `_net_at_most` is an
        # upper bound of the net charge (× `PER_PC`) of the last n passes, for every n. Exact sums
        # are computed only if one of these bounds exceeds its limit.
        self._second_at_most = self._net_at_most = 0.0

    def net_rest_ns(self, now_ns: int) -> int:
        """Return how long, ns, earlier passes still use more than half of the net charge limit. The
        plan of a new session does not include the pulses of the old session. If those pulses used
        more than half of the limit, the gate could reject planned sequences."""
        recent = [scan for scan in reversed(self._window) if scan.end_ns > now_ns - WINDOW_NS]
        if not recent or self._second_at_most <= PER_PC * NET_PC / 2:
            return 0
        newest = np.abs(np.cumsum([scan.sums[2] for scan in recent], axis=0)).max(axis=1)
        over = np.flatnonzero(newest > NET_PC / 2)
        return recent[over[0]].end_ns + WINDOW_NS - now_ns if len(over) else 0

    def enter(self, now_ns: int, period_us: int, times: int, load: PassLoad, flows: bool) -> None:
        """Check the dose limits with a new sequence, and add its passes to the sums.

        The new sequence ends the repetitions of the previous sequence. ``flows`` is True if the new
        sequence has slots. Without slots, its duration does not count toward the limit of the
        session. ``now_ns`` must not go back. Raises SafetyError with the limit and the electrode.
        """
        sums, period_ns, last, window = load.sums, 1000 * period_us, self._last, self._window
        burst_us, largest = min(period_us, BURST_US), float(np.maximum.reduce(sums[:2], axis=None))
        if largest > MOST_PER_US * burst_us:
            raise _too_much(sums[:2], burst_us)
        start_ns, repeated = now_ns, list[_Pass]()
        session, session_ns = self._session + times * sums, self._session_ns
        session_ns += period_ns * times * flows
        if last is not None:
            start_ns = max(now_ns, last.first.start_ns + last.period_ns)
            if last.times > 1:
                start_ns, repeated, left = last.cut_short(now_ns)
                # Subtract the passes of the previous sequence that will not be delivered.
                session_ns -= left * last.period_ns * last.flows
                session -= left * last.first.sums
        if load.recharge_pc is not None:
            slots_pc = sums[2] - load.recharge_pc
            carried_pc = session[2] - times * sums[2] + slots_pc
            _check_recharge(carried_pc, load.recharge_pc, sums[2], times)
        first = _Pass(start_ns, start_ns + 1000 * load.busy_us, sums, largest)
        # Check the passes that begin less than one second after the end of the first pass.
        checked = min(times, 1 + (first.end_ns - start_ns + _LAST_NS) // period_ns)
        net_at_most = min(self._net_at_most, self._second_at_most)
        most = checked * largest + (len(repeated) * repeated[0].most if repeated else 0)
        if (
            len(window) + len(repeated) >= self._most_passes
            or self._second_at_most + most > MOST_PER_US * 1_000_000
            or net_at_most + most > PER_PC * NET_PC
        ):
            net_at_most = self._check_second(now_ns, first, checked, period_ns, repeated)
        if session_ns > self._most_session_ns:
            raise refusal("session_s", session_ns / 1e9, self._limits.session_s)
        if np.maximum.reduce(session[1]) > self._most_of_session:
            at = int(session[1].argmax())
            charge_mc = session[1, at] / (PER_PC * 1e9)
            raise refusal("session_mc", charge_mc, self._limits.session_mc, electrode=at)
        self._net_at_most = net_at_most
        for scan in (*repeated, first):
            window.append(scan)
            self._second_at_most += scan.most
            self._net_at_most += scan.most
        while window and window[0].end_ns <= now_ns - WINDOW_NS:
            self._second_at_most -= window.popleft().most
        self._last = _Sent(first, period_ns, times, flows)
        self._session, self._session_ns = session, session_ns

    def _check_second(
        self, now_ns: int, first: _Pass, checked: int, period_ns: int, repeated: list[_Pass]
    ) -> float:
        """Raise SafetyError if any second would exceed a limit.

        Count the passes in `_window`, the ``repeated`` passes of the previous sequence, and
        ``checked`` passes of the new sequence. Add up the net charge of the last n passes before
        the new sequence, for every n. Return the largest magnitude of these sums, × `PER_PC`.
        """
        recent = [scan for scan in (*self._window, *repeated) if scan.end_ns > now_ns - WINDOW_NS]
        passes = sum(scan.start_ns > now_ns - WINDOW_NS for scan in recent) + 1
        if passes > self._most_passes:
            raise refusal("passes", passes, self._most_passes)
        ends_ns = [scan.end_ns for scan in recent]
        # row n: sums of the latest n passes
        nothing = np.zeros_like(first.sums)
        sums = np.cumsum([nothing, *(scan.sums for scan in reversed(recent))], axis=0)
        nets = sums[:, 2]
        highest, lowest = np.maximum.accumulate(nets), np.minimum.accumulate(nets)
        for index in range(checked):
            time_ns = first.start_ns + index * period_ns if index else now_ns
            count = len(recent) - bisect_right(ends_ns, time_ns - WINDOW_NS)
            second = (sums[count] + (index + 1) * first.sums)[:2]
            if second.max() > MOST_PER_US * 1_000_000:
                raise _too_much(second, 1_000_000)
            own_pc = (index + 1) * first.sums[2]
            net_pc = np.maximum(highest[count] + own_pc, -lowest[count] - own_pc)
            if net_pc.max() > NET_PC:
                at = int(net_pc.argmax())
                raise refusal("net_ma", net_pc[at] / 1e6, NET_PC / 1e6, electrode=at)
        return PER_PC * float(np.maximum(highest[-1], -lowest[-1]).max())


def _check_recharge(before_pc: Charge, recharge_pc: Charge, net_pc: Charge, times: int) -> None:
    """Raise SafetyError if a recharge phase moves the net charge of an electrode away from zero, or
    past zero. Check the first and the last pass. All arrays are (E,) pC."""
    for carried_pc in (before_pc, before_pc + (times - 1) * net_pc)[: min(times, 2)]:
        over_pc = np.abs(carried_pc + recharge_pc) + np.abs(recharge_pc) - np.abs(carried_pc)
        if over_pc.any():
            at = int(over_pc.argmax())
            raise refusal("takes_back", recharge_pc[at] / 1e6, -carried_pc[at] / 1e6, electrode=at)


def _too_much(load: Sums, time_us: int) -> SafetyError:
    """Return the error for too many perceptible pulses, or too much charge, in ``time_us``."""
    kind, at = divmod(int(load.argmax()), load.shape[1])
    limit, unit = ("mean_ma", PER_PC * 1_000_000) if kind else ("pulses_hz", PER_PULSE)
    return refusal(limit, load[kind, at] / unit, MOST_PER_US * time_us / unit, electrode=at)
