"""Exposure of each electrode: felt pulses and charge in a sequence, a second, and a session."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import SafetyError
from smarttouch.profile.ceilings import BURST_S, CEILING_MEAN_MA, CEILING_PULSES_HZ
from smarttouch.stimulation.limits import SafetyLimits

WINDOW_NS = 1_000_000_000
BURST_US = round(1e6 * BURST_S)
PER_PULSE = 1_000_000
PER_PC = round(1000 * CEILING_PULSES_HZ / (1e6 * CEILING_MEAN_MA))
"""Weights that give felt pulses and charge one limit, in whole numbers: 3 of it for 1 pC, a
million for a pulse, and `MOST_PER_US` of either for each microsecond."""
MOST_PER_US = round(CEILING_PULSES_HZ)
PLANNED = 0.9
"""Part of the limit used by schedules, so that jittered steps keep the window of a second."""

Load = NDArray[np.float64]
"""Felt pulses × `PER_PULSE` and charge in pC × `PER_PC` of each electrode, (2, E): whole numbers,
all far below 2^53, where doubles are exact."""


def shortest_period_us(load: Load) -> int:
    """Return the shortest period that a schedule plans for a load, µs.

    Above `BURST_US` it is more than any period allows.
    """
    return int(np.ceil(load.max(initial=0) / (PLANNED * MOST_PER_US)))


@dataclass(frozen=True)
class Dose:
    """Dose of current in a session.

    Attributes
    ----------
    seconds : float
        Of scans with current.
    charge_mc : tuple of float, (E,) mC
        Through each electrode, magnitudes added.
    """

    seconds: float
    charge_mc: tuple[float, ...]

    @property
    def most_mc(self) -> float:
        return max(self.charge_mc, default=0.0)


@dataclass
class _Sent:
    """Sequence that was let through, with the number of its repetitions begun."""

    start_ns: int
    period_ns: int
    times: int
    flows: bool
    load: Load
    most: float
    begun: int = 1
    left: int = 0


@dataclass
class Exposure:
    """Running sums over the last second and over the session, on the display's clock.

    Parameters
    ----------
    limits : SafetyLimits
    """

    limits: SafetyLimits
    _last: _Sent | None = None
    _window: deque[tuple[int, Load, float]] = field(default_factory=deque)
    """Start, load and largest load of each sequence in the last second."""
    _second_at_most: float = 0.0
    """Upper bound of the load of the last second at any electrode, which saves most sums."""
    _session: Load = field(init=False)
    _session_at_most: float = 0.0
    _session_ns: int = 0

    def __post_init__(self) -> None:
        self._session = np.zeros((2, self.limits.electrodes))
        self._most_of_session = self.limits.session_mc * 1e9 * PER_PC

    @property
    def dose(self) -> Dose:
        """Dose of the session so far, with requested repetitions."""
        charge_mc = self._session[1] / (PER_PC * 1e9)
        return Dose(self._session_ns / 1e9, tuple(charge_mc.tolist()))

    def begin_session(self) -> None:
        """Reset the session's dose, but not the last second."""
        self._last = None
        self._session_ns, self._session_at_most = 0, 0.0
        self._session[:] = 0

    def forget_second(self) -> None:
        """Reset the last second, where time starts anew; the session continues."""
        self._last = None
        self._window.clear()
        self._second_at_most = 0.0

    def enter(self, now_ns: int, period_us: int, times: int, load: Load, *, flows: bool) -> None:
        """Enter a sequence that may begin now; it ends the repetitions of the one before.

        Parameters
        ----------
        now_ns : int
            The display's time; never before that of the last call.
        period_us, times : int
            Length of one pass, and how many of them.
        load : ndarray, (2, E)
            Of one pass, see `SlotAdder`.
        flows : bool
            Whether it has slots: its time then counts to the session.

        Raises
        ------
        SafetyError
            Naming the limit and the electrode.
        """
        burst_us, most = min(period_us, BURST_US), float(load.max())
        if most > MOST_PER_US * burst_us:
            raise _too_much(load, burst_us, f"in {period_us} µs: lower the rate")
        window, last = self._window, self._last
        if last is not None and last.left:
            self._begin_repetitions(last, now_ns)
        while window and window[0][0] <= now_ns - WINDOW_NS:
            self._second_at_most -= window.popleft()[2]
        if self._second_at_most + most > MOST_PER_US * 1_000_000:
            second = np.add.reduce([load, *(each for _, each, _ in window)])
            if second.max() > MOST_PER_US * 1_000_000:
                raise _too_much(second, 1_000_000, "within a second: send less often")
        flowing_ns = 1000 * period_us * times * flows
        seconds = (self._session_ns + flowing_ns) / 1e9
        if (
            seconds > self.limits.session_s
            or self._session_at_most + times * most > self._most_of_session
        ):
            self._check_session(seconds, times * load[1])
        if last is not None and last.left:
            self._session_ns -= last.left * last.period_ns * last.flows
            self._session -= last.left * last.load
            self._session_at_most -= last.left * last.most
        self._last = _Sent(now_ns, 1000 * period_us, times, flows, load, most, left=times - 1)
        window.append((now_ns, load, most))
        self._second_at_most += most
        self._session_ns += flowing_ns
        self._session += load if times == 1 else times * load
        self._session_at_most += times * most

    def _check_session(self, seconds: float, charge: NDArray[np.float64]) -> None:
        """Raise if the session becomes too long with a sequence, or its charge, (E,), too much."""
        limits, allowed = self.limits, self._most_of_session
        session = self._session[1] + charge
        # Repetitions that this sequence cuts short were counted, and are not delivered.
        if (last := self._last) is not None:
            seconds -= last.left * last.period_ns * last.flows / 1e9
            session -= last.left * last.load[1]
        remedy = "take the finger off, look at the skin, and begin anew later"
        if seconds > limits.session_s:
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

    def _begin_repetitions(self, last: _Sent, now_ns: int) -> None:
        """Enter the repetitions that have begun since."""
        begun = min(last.times, (now_ns - last.start_ns) // last.period_ns + 1)
        # Those from more than a second ago would be dropped at once.
        first = max(last.begun, begun - WINDOW_NS // last.period_ns - 1)
        for index in range(first, begun):
            self._window.append((last.start_ns + index * last.period_ns, last.load, last.most))
            self._second_at_most += last.most
        last.begun, last.left = begun, last.times - begun


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
