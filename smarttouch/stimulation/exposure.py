"""Exposure of each electrode: felt pulses and charge in a sequence, a second, and a session."""

import math
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.clock import LATE_NS
from smarttouch.base.errors import SafetyError
from smarttouch.stimulation.safety_limits import SafetyLimits, decimal
from smarttouch.stimulation.slot_sums import (
    BURST_US,
    MOST_PER_US,
    NET_PC,
    PER_PC,
    PER_PULSE,
    WINDOW_NS,
    Charge,
    Load,
    PassLoad,
    Sums,
)

_LAST_NS = WINDOW_NS - 1


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

    def later(self, by_ns: int) -> "_Pass":
        """Return the same pass at a later time."""
        return self._replace(start_ns=self.start_ns + by_ns, end_ns=self.end_ns + by_ns)


@dataclass(slots=True)
class _Sent:
    """Sequence that was let through, with the number of its repetitions begun."""

    first: _Pass
    period_ns: int
    times: int
    flows: bool
    begun: int = 1

    @property
    def left(self) -> int:
        """Repetitions that have not begun."""
        return self.times - self.begun

    def begun_by(self, now_ns: int) -> int:
        """Return the number of passes begun by a time: one at least, which waits for its turn."""
        return max(1, min(self.times, (now_ns - self.first.start_ns) // self.period_ns + 1))


@dataclass
class Exposure:
    """Running sums over the last second and over the session, on the display's clock.

    A board finishes a pass before the next begins: passes count at the times that this gives.

    Parameters
    ----------
    limits : SafetyLimits
    """

    limits: SafetyLimits
    _last: _Sent | None = None
    _window: deque[_Pass] = field(default_factory=deque)
    """Passes of which any part lies in the last second, or is still to come."""
    _second_at_most: float = 0.0
    """Upper bound of the load of the last second at any electrode, which saves most sums."""
    _net_at_most: float = 0.0
    """Upper bound of the net charge (× `PER_PC`) of the newest passes, however many."""
    _session: Sums = field(init=False)
    _session_at_most: float = 0.0
    _session_ns: int = 0

    def __post_init__(self) -> None:
        self._session = np.zeros((3, self.limits.electrodes))
        self._most_of_session = self.limits.session_mc * 1e9 * PER_PC
        self._most_session_ns = math.floor(decimal(self.limits.session_s) * 10**9)
        # From a second ago to what may be sent ahead by sequences that come late.
        rate_hz = decimal(self.limits.rate_hz)
        self._most_passes = math.ceil(rate_hz * (WINDOW_NS + LATE_NS) / WINDOW_NS) + 1

    @property
    def dose(self) -> Dose:
        """Dose of the session so far, with requested repetitions."""
        charge_mc = self._session[1] / (PER_PC * 1e9)
        net_uc = self._session[2] / 1e6
        return Dose(self._session_ns / 1e9, tuple(charge_mc.tolist()), tuple(net_uc.tolist()))

    @property
    def net_pc(self) -> NDArray[np.int64]:
        """Net charge of each electrode in the session, (E,) pC, positive cathodic."""
        net_pc: Charge = self._session[2]
        return net_pc.astype(np.int64)

    def begin_session(self, now_ns: int | None) -> None:
        """Reset the session's dose; the last second still counts, with what repeated until now."""
        if self._last is not None and now_ns is not None:
            self._enter_repetitions(self._last, self._last.begun_by(now_ns))
        self._last = None
        self._session_ns, self._session_at_most = 0, 0.0
        self._session[:] = 0

    def forget_second(self) -> None:
        """Reset the last second, where time restarts; the session continues."""
        self._last = None
        self._window.clear()
        self._second_at_most = self._net_at_most = 0.0

    def net_rest_ns(self, now_ns: int) -> int:
        """Return the time until half of the net charge of a second is free for a new session.

        With less than that, what is planned without knowledge of an earlier session could be
        refused.
        """
        kept = [each for each in reversed(self._window) if each.end_ns > now_ns - WINDOW_NS]
        if not kept or self._second_at_most <= PER_PC * NET_PC / 2:
            return 0
        newest = np.abs(np.cumsum([each.sums[2] for each in kept], axis=0)).max(axis=1)
        over = np.flatnonzero(newest > NET_PC / 2)
        return kept[over[0]].end_ns + WINDOW_NS - now_ns if len(over) else 0

    def enter(self, now_ns: int, period_us: int, times: int, made: PassLoad, flows: bool) -> None:
        """Enter a sequence that may begin now; it ends the repetitions of the one before.

        Parameters
        ----------
        now_ns : int
            The display's time; never before that of the last call.
        period_us, times : int
            Length of one pass, and how many of them.
        made : PassLoad
            Of one pass.
        flows : bool
            Whether it has slots: its time then counts to the session.

        Raises
        ------
        SafetyError
            Naming the limit and the electrode.
        """
        sums, recharge_pc = made.sums, made.recharge_pc
        load = sums[:2]
        burst_us, most = min(period_us, BURST_US), float(np.maximum.reduce(load, axis=None))
        if most > MOST_PER_US * burst_us:
            raise _too_much(load, burst_us, f"in {period_us} µs: lower the rate")
        last, window, start_ns, period_ns = self._last, self._window, now_ns, 1000 * period_us
        begun = 1
        if last is not None:
            begun = 1 if last.times == 1 else last.begun_by(now_ns)
            free_ns = last.first.start_ns + begun * last.period_ns
            start_ns = free_ns if free_ns > now_ns else now_ns
        if recharge_pc is not None:
            carried_pc = self._session[2] + (sums[2] - recharge_pc)
            if last is not None and begun < last.times:
                carried_pc -= (last.times - begun) * last.first.sums[2]
            _check_recharge(carried_pc, recharge_pc, sums[2], times)
        first = _Pass(start_ns, start_ns + 1000 * made.busy_us, sums, most)
        entered = [] if last is None or begun == last.begun else self._repetitions(last, begun)
        # Until the first of its passes has left the second, each adds to what is in it.
        own = 1 if times == 1 else min(times, 1 + (first.end_ns - start_ns + _LAST_NS) // period_ns)
        net_at_most = self._check_second(now_ns, first, own, period_ns, entered)
        flowing_ns = period_ns * times * flows
        session_ns = self._session_ns + flowing_ns
        if (
            session_ns > self._most_session_ns
            or self._session_at_most + times * most > self._most_of_session
        ):
            self._check_session(session_ns, times * load[1], begun)
        # From here on nothing is refused.
        self._net_at_most = net_at_most
        if last is not None:
            for each in entered:
                self._add(each)
            last.begun = begun
            if left := last.left:
                self._session_ns -= left * last.period_ns * last.flows
                self._session -= left * last.first.sums
                self._session_at_most -= left * last.first.most
        while window and window[0].end_ns <= now_ns - WINDOW_NS:
            self._second_at_most -= window.popleft().most
        self._last = _Sent(first, period_ns, times, flows)
        self._add(first)
        self._session_ns += flowing_ns
        self._session += sums if times == 1 else times * sums
        self._session_at_most += times * most

    def _add(self, each: _Pass) -> None:
        self._window.append(each)
        self._second_at_most += each.most
        self._net_at_most += each.most

    def _repetitions(self, last: _Sent, begun: int) -> list[_Pass]:
        """Return the repetitions that have begun since, but for those of long ago."""
        first = max(last.begun, begun - WINDOW_NS // last.period_ns - 2)
        return [last.first.later(index * last.period_ns) for index in range(first, begun)]

    def _enter_repetitions(self, last: _Sent, begun: int) -> None:
        if begun > last.begun:
            for each in self._repetitions(last, begun):
                self._add(each)
            last.begun = begun

    def _check_second(
        self, now_ns: int, first: _Pass, own: int, period_ns: int, entered: list[_Pass]
    ) -> float:
        """Raise if any second would hold too many passes, or too much of what they bring.

        Returns the largest net charge (× `PER_PC`) of the newest passes before it, or a bound.

        Parameters
        ----------
        now_ns : int
        first : _Pass
            The first pass of the new sequence.
        own, period_ns : int
            Number of its passes to judge, one period apart.
        entered : list of _Pass
            Repetitions of the sequence before that are not in the window yet.
        """
        window, most = self._window, own * first.most
        for each in entered:
            most += each.most
        net_at_most = min(self._net_at_most, self._second_at_most)
        if (
            len(window) + len(entered) < self._most_passes
            and self._second_at_most + most <= MOST_PER_US * 1_000_000
            and net_at_most + most <= PER_PC * NET_PC
        ):
            return net_at_most
        kept = [each for each in (*window, *entered) if each.end_ns > now_ns - WINDOW_NS]
        passes = sum(each.start_ns > now_ns - WINDOW_NS for each in kept) + 1
        if passes > self._most_passes:
            raise SafetyError(
                f"{passes} sequences within a second or waiting are above the "
                f"{self.limits.rate_hz:g} a second of limits.rate_hz: send less often",
                limit="rate_hz",
                value=passes,
                allowed=self._most_passes,
            )
        ends_ns = [each.end_ns for each in kept]
        # Of the newest passes, from each of them on.
        nothing = np.zeros_like(first.sums)
        sums = np.cumsum([nothing, *(each.sums for each in reversed(kept))], axis=0)
        nets = sums[:, 2]
        highest, lowest = np.maximum.accumulate(nets), np.minimum.accumulate(nets)
        for index in range(own):
            time_ns = first.start_ns + index * period_ns if index else now_ns
            count = len(kept) - bisect_right(ends_ns, time_ns - WINDOW_NS)
            second = (sums[count] + (index + 1) * first.sums)[:2]
            if second.max() > MOST_PER_US * 1_000_000:
                raise _too_much(second, 1_000_000, "within a second: send less often")
            own_pc = (index + 1) * first.sums[2]
            net_pc = np.maximum(highest[count] + own_pc, -lowest[count] - own_pc)
            if net_pc.max() > NET_PC:
                raise _too_much_net(net_pc)
        return PER_PC * float(np.maximum(highest[-1], -lowest[-1]).max())

    def _check_session(self, session_ns: int, charge: NDArray[np.float64], begun: int) -> None:
        """Raise if the session becomes too long with a sequence, or its charge, (E,), too much."""
        limits, allowed = self.limits, self._most_of_session
        session = self._session[1] + charge
        # Repetitions that this sequence cuts short were counted, and are not delivered.
        if (last := self._last) is not None:
            session_ns -= (last.times - begun) * last.period_ns * last.flows
            session -= (last.times - begun) * last.first.sums[1]
        remedy = "take the finger off, look at the skin, and continue later"
        if session_ns > self._most_session_ns:
            seconds = session_ns / 1e9
            raise SafetyError(
                f"the session would have {seconds:.0f} s of current, limits.session_s is "
                f"{limits.session_s:g}: {remedy}",
                limit="session_s",
                value=seconds,
                allowed=limits.session_s,
            )
        if session.max() > allowed:
            electrode = int(session.argmax())
            charge_mc = session[electrode] / (PER_PC * 1e9)
            raise SafetyError(
                f"electrode {electrode}: the session would pass {charge_mc:.0f} mC, "
                f"limits.session_mc is {limits.session_mc:g}: {remedy}",
                limit="session_mc",
                value=charge_mc,
                allowed=limits.session_mc,
                electrode=electrode,
            )


def _check_recharge(before_pc: Charge, recharge_pc: Charge, net_pc: Charge, times: int) -> None:
    """Raise unless a recharge phase takes back charge that its electrodes carry, in every pass.

    Parameters
    ----------
    before_pc : ndarray, (E,) pC
        What each electrode carries before the first phase.
    recharge_pc : ndarray, (E,) pC
    net_pc : ndarray, (E,) pC
        Net charge of one pass, by which the others begin with more.
    times : int
    """
    for carried_pc in (before_pc, before_pc + (times - 1) * net_pc)[: min(times, 2)]:
        # At most all of it, and of the other sign.
        over_pc = np.abs(carried_pc + recharge_pc) + np.abs(recharge_pc) - np.abs(carried_pc)
        if over_pc.any():
            electrode = int(over_pc.argmax())
            raise SafetyError(
                f"electrode {electrode}: the recharge phase passes "
                f"{recharge_pc[electrode] / 1e6:g} µC where {carried_pc[electrode] / 1e6:g} µC "
                "were carried: it may take back that much and nothing else",
                limit="recharge_ua",
                value=float(recharge_pc[electrode]) / 1e6,
                allowed=-float(carried_pc[electrode]) / 1e6,
                electrode=electrode,
            )


def _too_much_net(net_pc: Charge) -> SafetyError:
    electrode = int(net_pc.argmax())
    value, allowed = float(net_pc[electrode]) / 1e6, NET_PC / 1e6
    return SafetyError(
        f"electrode {electrode}: {value:g} µC of one sign would be left within a second, more "
        f"than {allowed:g}: lower the rate, or recharge",
        limit="net_ma",
        value=value,
        allowed=allowed,
        electrode=electrode,
    )


def _too_much(load: Load, time_us: int, where: str) -> SafetyError:
    kind, electrode = divmod(int(load.argmax()), load.shape[1])
    value, allowed = float(load[kind, electrode]), MOST_PER_US * time_us
    if kind == 0:
        limit, unit, words = "pulses_hz", PER_PULSE, "felt pulses"
    else:
        limit, unit, words = "mean_ma", PER_PC * 1_000_000, "µC"
    return SafetyError(
        f"electrode {electrode}: {value / unit:g} {words} are above {allowed / unit:g} {where}",
        limit=limit,
        value=value / unit,
        allowed=allowed / unit,
        electrode=electrode,
    )
