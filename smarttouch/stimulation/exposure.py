"""Exposure of each electrode: felt pulses and charge in a sequence, a second, and a session."""

import math
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.clock import LATE_NS
from smarttouch.base.errors import SafetyError
from smarttouch.stimulation.safety_limits import SafetyLimits, decimal
from smarttouch.stimulation.sequence_limits import (
    BURST_US,
    MOST_PER_US,
    NET_PC,
    PER_PC,
    PER_PULSE,
    PassLoad,
    Sums,
    refusal,
)

WINDOW_NS = 1_000_000_000
_LAST_NS = WINDOW_NS - 1

Charge = NDArray[np.float64]  # (E,) pC with its sign: whole numbers below 2^53


@dataclass(frozen=True)
class Dose:
    """Dose of current in a session.

    Attributes
    ----------
    seconds : float
        Of scans with current.
    charge_mc : tuple of float, (E,) mC
        Through each electrode, magnitudes added.
    net_uc : tuple of float, (E,) µC
        Sum of the charge through each electrode with its sign, positive cathodic.
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
    most: float  # largest load: no electrode has more net charge (× `PER_PC`) than this


class _Sent(NamedTuple):
    """Sequence that was let through; its first pass is in the window."""

    first: _Pass
    period_ns: int
    times: int
    flows: bool

    def begun_by(self, now_ns: int) -> int:
        """Return the number of passes begun by a time: one at least, which waits for its turn."""
        return max(1, min(self.times, (now_ns - self.first.start_ns) // self.period_ns + 1))

    def repetitions(self, begun: int) -> list[_Pass]:
        """Return the passes that have begun since, but for those of long ago."""
        first, recent = self.first, max(1, begun - WINDOW_NS // self.period_ns - 2)
        delays_ns = (index * self.period_ns for index in range(recent, begun))
        return [
            first._replace(start_ns=first.start_ns + by_ns, end_ns=first.end_ns + by_ns)
            for by_ns in delays_ns
        ]


class Exposure:
    """Running sums over the last second and over the session, on the display's clock.

    A board finishes a pass before the next begins: passes count at the times that this gives.
    """

    def __init__(self, limits: SafetyLimits) -> None:
        self._limits = limits
        self._most_of_session = limits.session_mc * 1e9 * PER_PC
        self._most_session_ns = math.floor(decimal(limits.session_s) * 10**9)
        # From a second ago to what may be sent ahead by sequences that come late.
        rate_hz = decimal(limits.rate_hz)
        self._most_passes = math.ceil(rate_hz * (WINDOW_NS + LATE_NS) / WINDOW_NS) + 1
        # Passes of which any part lies in the last second, or is still to come.
        self._window: deque[_Pass] = deque()
        self.begin_session(None)
        self.forget_second()

    @property
    def dose(self) -> Dose:
        """Dose of the session so far, with requested repetitions."""
        charge_mc = self._session[1] / (PER_PC * 1e9)
        net_uc = self._session[2] / 1e6
        return Dose(self._session_ns / 1e9, tuple(charge_mc.tolist()), tuple(net_uc.tolist()))

    @property
    def net_pc(self) -> NDArray[np.int64]:
        """Net charge of each electrode in the session, (E,) pC, positive cathodic."""
        return np.asarray(self._session[2], np.int64)

    def begin_session(self, now_ns: int | None) -> None:
        """Reset the session's dose; the last second still counts, with what repeated until now."""
        if now_ns is not None and self._last is not None:
            self._add(self._last.repetitions(self._last.begun_by(now_ns)))
        self._last: _Sent | None = None
        self._session: Sums = np.zeros((3, self._limits.electrodes))
        self._session_ns = 0

    def forget_second(self) -> None:
        """Reset the last second, where time restarts; the session continues."""
        self._last = None
        self._window.clear()
        # Upper bounds of the load of the last second at any electrode, and of the net charge
        # (× `PER_PC`) of the newest passes, however many: they save most sums.
        self._second_at_most = self._net_at_most = 0.0

    def net_rest_ns(self, now_ns: int) -> int:
        """Return the time until half of the net charge of a second is free for a new session.

        With less than that, what is planned without knowledge of an earlier session could be
        refused.
        """
        recent = [scan for scan in reversed(self._window) if scan.end_ns > now_ns - WINDOW_NS]
        if not recent or self._second_at_most <= PER_PC * NET_PC / 2:
            return 0
        newest = np.abs(np.cumsum([scan.sums[2] for scan in recent], axis=0)).max(axis=1)
        over = np.flatnonzero(newest > NET_PC / 2)
        return recent[over[0]].end_ns + WINDOW_NS - now_ns if len(over) else 0

    def enter(self, now_ns: int, period_us: int, times: int, made: PassLoad, flows: bool) -> None:
        """Enter passes of a sequence that may begin now, which is never before the last call; it
        ends the repetitions of the one before. Their time counts to the session if it ``flows``.

        Raises
        ------
        SafetyError
            Naming the limit and the electrode.
        """
        sums, period_ns, last, window = made.sums, 1000 * period_us, self._last, self._window
        burst_us, most = min(period_us, BURST_US), float(np.maximum.reduce(sums[:2], axis=None))
        if most > MOST_PER_US * burst_us:
            raise _too_much(sums[:2], burst_us)
        start_ns, entered = now_ns, list[_Pass]()
        session, session_ns = self._session + times * sums, self._session_ns
        session_ns += period_ns * times * flows
        if last is not None:
            begun = 1 if last.times == 1 else last.begun_by(now_ns)
            start_ns = max(now_ns, last.first.start_ns + begun * last.period_ns)
            if begun > 1:
                entered = last.repetitions(begun)
            if left := last.times - begun:
                # Cut short by this sequence: they were counted, and are not delivered.
                session_ns -= left * last.period_ns * last.flows
                session -= left * last.first.sums
        if made.recharge_pc is not None:
            slots_pc = sums[2] - made.recharge_pc
            carried_pc = session[2] - times * sums[2] + slots_pc
            _check_recharge(carried_pc, made.recharge_pc, sums[2], times)
        first = _Pass(start_ns, start_ns + 1000 * made.busy_us, sums, most)
        # Until the first of its passes has left the second, each adds to what is in it.
        judged = (
            1 if times == 1 else min(times, 1 + (first.end_ns - start_ns + _LAST_NS) // period_ns)
        )
        net_at_most = self._check_second(now_ns, first, judged, period_ns, entered)
        if session_ns > self._most_session_ns:
            raise refusal("session_s", session_ns / 1e9, self._limits.session_s)
        if np.maximum.reduce(session[1]) > self._most_of_session:
            at = int(session[1].argmax())
            charge_mc = session[1, at] / (PER_PC * 1e9)
            raise refusal("session_mc", charge_mc, self._limits.session_mc, electrode=at)
        # From here on nothing is refused.
        self._net_at_most = net_at_most
        self._add([*entered, first])
        while window and window[0].end_ns <= now_ns - WINDOW_NS:
            self._second_at_most -= window.popleft().most
        self._last = _Sent(first, period_ns, times, flows)
        self._session, self._session_ns = session, session_ns

    def _add(self, passes: list[_Pass]) -> None:
        for scan in passes:
            self._window.append(scan)
            self._second_at_most += scan.most
            self._net_at_most += scan.most

    def _check_second(
        self, now_ns: int, first: _Pass, judged: int, period_ns: int, entered: list[_Pass]
    ) -> float:
        """Raise if any second would hold too many passes, or too much of what they bring: of
        ``judged`` passes a period apart, and of those of the sequence before that are not in the
        window yet. Returns a bound of the net charge (× `PER_PC`) of the newest passes before."""
        window, most = self._window, judged * first.most
        for scan in entered:
            most += scan.most
        net_at_most = min(self._net_at_most, self._second_at_most)
        if (
            len(window) + len(entered) < self._most_passes
            and self._second_at_most + most <= MOST_PER_US * 1_000_000
            and net_at_most + most <= PER_PC * NET_PC
        ):
            return net_at_most
        recent = [scan for scan in (*window, *entered) if scan.end_ns > now_ns - WINDOW_NS]
        passes = sum(scan.start_ns > now_ns - WINDOW_NS for scan in recent) + 1
        if passes > self._most_passes:
            raise refusal("passes", passes, self._most_passes)
        ends_ns = [scan.end_ns for scan in recent]
        # Of the newest passes, from each of them on.
        nothing = np.zeros_like(first.sums)
        sums = np.cumsum([nothing, *(scan.sums for scan in reversed(recent))], axis=0)
        nets = sums[:, 2]
        highest, lowest = np.maximum.accumulate(nets), np.minimum.accumulate(nets)
        for index in range(judged):
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
    """Raise unless a recharge phase takes back charge that its electrodes carry, before the first
    of its passes and, as each leaves net charge, before the last; all (E,) pC."""
    for carried_pc in (before_pc, before_pc + (times - 1) * net_pc)[: min(times, 2)]:
        # At most all of it, and of the other sign.
        over_pc = np.abs(carried_pc + recharge_pc) + np.abs(recharge_pc) - np.abs(carried_pc)
        if over_pc.any():
            at = int(over_pc.argmax())
            raise refusal("takes_back", recharge_pc[at] / 1e6, -carried_pc[at] / 1e6, electrode=at)


def _too_much(load: Sums, time_us: int) -> SafetyError:
    """Return the error of too many felt pulses, or too much charge, of either sign."""
    kind, at = divmod(int(load.argmax()), load.shape[1])
    limit, unit = ("mean_ma", PER_PC * 1_000_000) if kind else ("pulses_hz", PER_PULSE)
    return refusal(limit, load[kind, at] / unit, MOST_PER_US * time_us / unit, electrode=at)
