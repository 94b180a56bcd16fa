"""Scheduler, which converts a tactile image to the slots of one sequence and its period.

The period follows from the pulse rates of classes, finger force, the board's scan timing, and the
limits of pulses and charge.
"""

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ScheduleError
from smarttouch.base.tactile_image import TactileImage
from smarttouch.kernels.bank import KernelBank
from smarttouch.profile import ForceLaw, Profile
from smarttouch.stimulation.impedance_control import ImpedanceControl
from smarttouch.stimulation.safety_gate import FIRST_NS, MOST_STEP_NS
from smarttouch.stimulation.safety_limits import PPB, SafetyLimits, parts_per_billion
from smarttouch.stimulation.scan_sequence import (
    NO_SHARING,
    KernelTable,
    ScanSequence,
    ScanTiming,
    SlotPolicy,
    peak_pc,
)
from smarttouch.stimulation.sequence_limits import (
    BURST_US,
    MOST_PER_US,
    NET_PC,
    PLANNED,
    add_up,
    strength_ppb,
)
from smarttouch.stimulation.slots import FrameSlots, PointSlots, Slots, constant_us, joined

WINDOW_US = 1_100_000
"""Length, µs, of the window in which the scheduler limits net charge. The limit is for 1 s, but a
board that counts time in tenths of a second can include the charge of up to 1.1 s."""
GUARD_PC = 0.95 * NET_PC  # periods keep the net charge of the last n passes in a window below this
_MEAN_PC = PLANNED * NET_PC
_FREE_PC = NET_PC / 2
_MOST_PC = 0.99 * NET_PC

Array = NDArray[np.float64]

SLOWEST = 0.2
"""Share of the full pulse rate at the lightest touch of a hard object. It reduces 50 Hz to 10 Hz,
the lowest rate in the paper's experiments (Section III-B.2)."""
_ON_TIME = 0.25  # a pulse delayed by more than this share of its interval restarts the time grid
_SLOWEST_HZ = 0.1


def force_gate(force_n: float, law: ForceLaw) -> float:
    """Return the intensity at a finger force, in [0, 1].

    Intensity is 0 below the contact force and 1 above the full force. In between it is a linear or
    logarithmic function of force (paper, Section IV-B). A force of NaN means no contact.
    """
    if not force_n > law.contact_n:
        return 0.0
    if force_n >= law.full_n:
        return 1.0
    if law.law == "linear":
        return (force_n - law.contact_n) / (law.full_n - law.contact_n)
    return math.log(force_n / law.contact_n) / math.log(law.full_n / law.contact_n)


def rate_share(pressure: float, softness: float) -> float:
    """Return the SAI pulse rate at a pressure in [0, 1], as a share of the full rate.

    The firing rate of SAI afferents rises strongly with pressure on a hard object, and little on a
    soft one. In the paper, a constant rate under a moving finger felt soft (Section III-B.2). With
    softness 1 the rate is constant, with softness 0 it follows pressure.
    """
    return softness + (1 - softness) * max(SLOWEST, pressure)


def rates_of(
    profile: Profile, afferents: tuple[Afferent, ...], rate_hz: float | None, timing: ScanTiming
) -> dict[Afferent, float]:
    """Return the pulse rate of each class, Hz. A single class gets `rate_hz` or, by default, the
    profile's rate. If RA and SAI are stimulated together, each gets its own rate from the profile.
    In mode color, the stimuli set the times of pulses, and the result is empty."""
    pulse, limits = profile.pulse, profile.limits
    rates_hz = {afferents[0]: pulse.rate_hz if rate_hz is None else rate_hz}
    if Afferent.PC in afferents and len(afferents) > 1:
        rates_hz = {}
    elif len(afferents) > 1:
        rates_hz = {Afferent.RA: pulse.ra_rate_hz, Afferent.SAI: pulse.sai_rate_hz}
        if rate_hz is not None:
            raise ScheduleError(
                f"rate_hz={rate_hz:g} is for a single class: for several classes set "
                "pulse.ra_rate_hz and pulse.sai_rate_hz of the profile"
            )
        if timing.whole_hz or timing.every_electrode or timing.in_index_order:
            raise ScheduleError(
                "natural mode needs two pulse rates, and this board scans all electrodes at one "
                "rate: choose mode RA or SAI"
            )
    for each_hz in rates_hz.values():
        if not _SLOWEST_HZ <= each_hz <= limits.rate_hz:
            raise ScheduleError(
                f"a rate of {each_hz:g} Hz is not possible: it must be at least "
                f"{_SLOWEST_HZ:g} Hz and at most the profile's limit of {limits.rate_hz:g} Hz"
            )
    return rates_hz


class PulseRates:
    """Timetable of pulses, with a regular time grid for each class.

    `merge_us` is the shortest period of a sequence. Pulses of several classes that are less than
    `merge_us` apart go into one sequence. `rates_hz` are rates at full pressure. The SAI rate falls
    at lower pressure, depending on `softness` (see `rate_share`).
    """

    def __init__(
        self,
        rates_hz: Mapping[Afferent, float],
        merge_us: int,
        softness: float = 1.0,
        timing: ScanTiming | None = None,
    ) -> None:
        self._rates_hz = dict(rates_hz)
        self._merge_us, self._softness = merge_us, softness
        self._timing = timing or ScanTiming()
        self._last_ns: dict[Afferent, float] = {}

    def due(self, time_ns: int, pressure: float = 1.0) -> tuple[tuple[Afferent, ...], int]:
        """Return the classes that pulse now, and the time to the next pulses, µs. The pressure is
        in [0, 1]."""
        now, merge_ns = [], 1000 * self._merge_us
        next_ns = []
        for afferent, rate_hz in self._rates_hz.items():
            if afferent is Afferent.SAI and self._softness < 1:
                rate_hz *= rate_share(pressure, self._softness)
            if len(self._rates_hz) == 1:
                return (afferent,), self._timing.shortest_period_us(1e6 / rate_hz)
            interval_ns = 1e9 / rate_hz
            due_ns = self._last_ns.get(afferent, -float("inf")) + interval_ns
            if due_ns - time_ns < merge_ns:
                now.append(afferent)
                if time_ns - due_ns > _ON_TIME * interval_ns:
                    due_ns = time_ns
                self._last_ns[afferent] = due_ns
                due_ns += interval_ns
            next_ns.append(due_ns)
        if not next_ns:
            raise ScheduleError(
                "mode color needs a stimulus period, and this source has no period: choose mode RA"
            )
        return tuple(now), max(self._merge_us, round((min(next_ns) - time_ns) / 1000))

    def restart(self) -> None:
        """Restart the time grids, so that all classes are due now."""
        self._last_ns.clear()


class _Pass(NamedTuple):
    """Planned pass of a sequence."""

    end_us: float  # end of the slots
    most_pc: float  # largest magnitude in `net_pc`
    net_pc: Array  # net charge of each electrode, (E,)


class NetPlan:
    """Planner of periods that keep the net charge of any second below its limit.

    If the requested rate would exceed the limit, periods become longer once half of the limit is
    used, so that all passes slow down evenly. After a change of the image, a pass may have to wait
    until earlier passes are older than `WINDOW_US`.
    """

    def __init__(self, electrodes: int) -> None:
        self._passes: deque[_Pass] = deque()
        self._sum_pc = np.zeros(electrodes)
        # Upper bounds of net charge: `_at_most_pc` is for all passes of the last `WINDOW_US`;
        # `_newest_at_most_pc` is for the last n passes, for every n.
        self._at_most_pc = self._newest_at_most_pc = 0.0

    def next_period_us(
        self, net_pc: Array, time_us: float, period_us: int, busy_us: int
    ) -> float | None:
        """Plan a pass that begins at `time_us`. Return its shortest period, at least `period_us`.
        The slots of the pass take `busy_us` and have the net charge `net_pc`, (E,). If the net
        charge within one second would exceed the limit, plan nothing and return None."""
        passes = self._passes
        while passes and passes[0].end_us <= time_us - WINDOW_US:
            _, gone_pc, gone_net_pc = passes.popleft()
            self._at_most_pc -= gone_pc
            self._sum_pc -= gone_net_pc
            self._newest_at_most_pc = min(self._newest_at_most_pc, self._at_most_pc)
        most_pc = float(np.maximum.reduce(np.abs(net_pc)))
        if self._newest_at_most_pc + most_pc > GUARD_PC:
            newest_pc = float(self._newest(net_pc).max())
            self._newest_at_most_pc = newest_pc + most_pc
            if newest_pc > _MOST_PC:
                return None
        passes.append(_Pass(time_us + busy_us, most_pc, net_pc))
        self._at_most_pc += most_pc
        self._newest_at_most_pc += most_pc
        self._sum_pc += net_pc
        count, needed_us = len(passes), float(period_us)
        carried_pc = float(np.maximum.reduce(np.abs(self._sum_pc)))
        span_us = min(time_us + period_us - passes[0].end_us, WINDOW_US)
        # Do not slow a pulse train that is short or has pauses.
        if carried_pc > _FREE_PC and carried_pc * WINDOW_US > _MEAN_PC * span_us:
            mean_pc = carried_pc / count
            if mean_pc < _MEAN_PC:
                # Count one more pass, because the window can also include parts of passes.
                needed_us = max(needed_us, WINDOW_US / 1.1 * mean_pc / (_MEAN_PC - mean_pc))
            if carried_pc + mean_pc < GUARD_PC:
                # Until the oldest pass leaves the window, spread the remaining charge evenly.
                left_us = WINDOW_US - span_us
                needed_us = max(needed_us, left_us * mean_pc / (GUARD_PC - carried_pc))
        if self._newest_at_most_pc + most_pc > GUARD_PC:
            # Wait until the limit allows another pass with the same charge.
            newest = self._newest(net_pc).max(axis=1)
            room = max(0, bisect_right(np.maximum.accumulate(newest).tolist(), GUARD_PC) - 1)
            if room < count:
                end_us = passes[count - room - 1].end_us
                needed_us = max(needed_us, end_us + WINDOW_US - time_us)
        return needed_us

    def _newest(self, net_pc: Array) -> Array:
        """Return |net charge|, (N + 1, E). Row n: ``net_pc`` + net charge of the last n passes."""
        passes = (earlier.net_pc for earlier in reversed(self._passes))
        return np.asarray(np.abs(np.cumsum([net_pc, *passes], axis=0)))


@dataclass
class SchedulerContext:
    """State that all schedulers of one run share."""

    sharing: SlotPolicy = NO_SHARING
    makers: dict[Afferent, PointSlots | FrameSlots] = field(default_factory=dict)
    """Slot makers, by class."""
    table: KernelTable | None = None  # quantized kernels, if slots are sums of them
    net: NetPlan | None = None  # limits net charge; None if scans have recharge phases


class ScanScheduler:
    """Converter of tactile images to scan sequences (paper, Section IV-A, Fig. 19). Each active
    point of a class takes at most one slot.

    `rate_hz` is the pulse rate if only one class is stimulated (see `rates_of`). `softness`, from
    0 to 1, reduces the effect of force on the SAI rate. If `vibrated`, mechanical vibrators
    stimulate PC, and this class gets no current. `asked_us` is the last requested period. To limit
    net charge, a sequence can get a longer period (counted by `net_slowed`) or lose all slots
    (counted by `net_emptied`).
    Raises ScheduleError if the rate or the pulses are impossible, or if the bank drives a masked
    electrode.
    """

    def __init__(
        self,
        profile: Profile,
        bank: KernelBank,
        afferents: tuple[Afferent, ...],
        rate_hz: float | None = None,
        timing: ScanTiming | None = None,
        softness: float = 1.0,
        vibrated: bool = False,
        common: SchedulerContext | None = None,
    ) -> None:
        common = SchedulerContext() if common is None else common
        self._timing = timing = ScanTiming() if timing is None else timing
        timing.check(profile)
        pulse, rates_hz = profile.pulse, rates_of(profile, afferents, rate_hz, timing)
        self._vibrated = vibrated
        self._makers: dict[Afferent, PointSlots | FrameSlots] = {}
        for afferent in afferents:
            if vibrated and afferent is Afferent.PC:
                continue
            if afferent not in common.makers:
                common.makers[afferent] = (
                    FrameSlots(profile, bank, afferent)
                    if afferent in common.sharing.afferents
                    else PointSlots(profile, bank, afferent, common.table, timing.in_index_order)
                )
            self._makers[afferent] = common.makers[afferent]
        self._first = next(iter(self._makers))
        self._least_us = math.ceil(1e6 / profile.limits.rate_hz)
        self._rates = PulseRates(rates_hz, self._least_us, softness, timing)
        self._electrodes, self._duty = len(profile.electrodes), profile.limits.duty
        # There is at most one slot for each point and class.
        self._discharges_us = constant_us(self._electrodes * len(afferents), pulse.discharge_us)
        self._limits = SafetyLimits.of(profile)
        steps_ns = 0, 2 * FIRST_NS, MOST_STEP_NS
        self._steps = [step_ns / self._limits.ramp_ns for step_ns in steps_ns]
        # Raise ScheduleError now if the longest scan is impossible.
        all_us, count = self._electrodes * pulse.width_us, self._electrodes
        timing.shortest_period_us(
            all_us / self._duty, count, count, pulse.width_us, pulse.discharge_us
        )
        self.asked_us: int = 0
        self.net_slowed: int = 0
        self.net_emptied: int = 0
        self._net = common.net
        if not set(self._makers) <= set(bank.discs):
            self._require_exposure_of_all()

    def restart(self) -> None:
        """Restart the time grids, so that all classes are due now."""
        self._rates.restart()

    def schedule(
        self,
        image: TactileImage,
        intensity: float,
        pressure: float = 1.0,
        allowed: float = 1.0,
        impedance: ImpedanceControl | None = None,
    ) -> ScanSequence:
        """Return the sequence for a tactile image at an intensity and a pressure in [0, 1].

        The requested period is extended if the slots do not fit. Zero intensity gives no slots.
        Intensity is lowered until strength (`strength_ppb`) is at most ``allowed``, in [0, 1]. If
        all currents then round to zero and ``allowed`` is not zero, larger strengths are tried, up
        to the strength that the ramp reaches from zero in `MOST_STEP_NS`. The SAI rate follows
        pressure. If the image has a period, each active class pulses once per period. Raises
        ScheduleError if the limits do not allow the sequence, or a class cannot be stimulated.
        """
        if image.period_us is None:
            due, self.asked_us = self._rates.due(image.time_ns, pressure)
        else:
            due, self.asked_us = self._active(image.activation, image.period_us), image.period_us
        parts = self._slots(due, image.activation, intensity, impedance)
        if intensity > allowed:
            parts, intensity = self._within_ramp(parts, due, image, intensity, allowed, impedance)
        slots, pulses_us = len(parts.site), sum(parts.width_us.tolist())
        least_us, mean_us = max(self.asked_us, pulses_us / self._duty), 0.0
        if slots:
            sums = add_up(parts.current_ua, parts.width_us, self._limits.felt_ua)[0]
            # the shortest period allowed by the limits of pulses and charge
            exposed_us = math.ceil(sums[:2].max() / (PLANNED * MOST_PER_US))
            if exposed_us > BURST_US:
                raise _overexposed(exposed_us)
            least_us, mean_us = max(least_us, exposed_us), pulses_us / slots
        timing, rest_us = self._timing, int(self._discharges_us[0])
        period_us = timing.shortest_period_us(least_us, slots, self._electrodes, mean_us, rest_us)
        if slots and self._net is not None:
            time_us, busy_us = image.time_ns / 1000, pulses_us + slots * rest_us
            needed_us = self._net.next_period_us(sums[2], time_us, period_us, busy_us)
            if needed_us is None:
                self.net_emptied += 1
                parts, slots = Slots(parts.site[:0], parts.current_ua[:0], parts.width_us[:0]), 0
            elif needed_us > period_us:
                self.net_slowed += 1
                period_us = timing.shortest_period_us(needed_us)
        vibration = None
        if self._vibrated:
            vibration = image.activation[Afferent.PC] * np.float32(intensity)
        return ScanSequence(
            parts.current_ua, parts.width_us, self._discharges_us[:slots], parts.site, period_us,
            float(intensity), image.time_ns, vibration, parts.proof, sums=parts.sums,
        )  # fmt: skip

    def _slots(
        self,
        due: tuple[Afferent, ...],
        activation: NDArray[np.float32],
        intensity: float,
        impedance: ImpedanceControl | None,
    ) -> Slots:
        """Return the slots of all due classes; if no class is due, there are no slots."""
        parts = []
        for afferent in due or (self._first,):
            maker = self._makers[afferent]
            parts.append(maker.slots(activation[afferent], intensity if due else 0.0))
        slots = parts[0] if len(parts) == 1 else joined(parts)
        return slots if impedance is None or not len(slots.site) else impedance.apply(slots)

    def _within_ramp(
        self,
        slots: Slots,
        due: tuple[Afferent, ...],
        image: TactileImage,
        wanted: float,
        allowed: float,
        impedance: ImpedanceControl | None,
    ) -> tuple[Slots, float]:
        """Return slots weakened to the allowed strength, and their intensity."""
        ppb, charge_pc = parts_per_billion(wanted), peak_pc(slots.current_ua, slots.width_us)
        # Rounding to µA may increase the strength slightly.
        planned_ppb = min(ppb, strength_ppb(self._limits, ppb, charge_pc))
        intensity = wanted if planned_ppb else allowed
        # If all currents round to zero, try larger first steps of the ramp.
        for least in self._steps if allowed else self._steps[:1]:
            strongest = max(allowed, least)
            if planned_ppb <= strongest * PPB:
                break
            intensity = wanted * strongest * PPB / planned_ppb
            slots = self._slots(due, image.activation, intensity, impedance)
            if slots.current_ua.any():
                break
        return slots, intensity

    def _active(self, activation: NDArray[np.float32], period_us: int) -> tuple[Afferent, ...]:
        """Return the classes that are active in an image whose period is ``period_us``."""
        if period_us < self._least_us:
            raise ScheduleError(
                f"pulses {period_us} µs apart are not possible: the profile's limit of "
                f"{1e6 / self._least_us:g} Hz requires {self._least_us} µs or more"
            )
        active = list(map(Afferent, np.flatnonzero(activation.any(axis=1)).tolist()))
        if self._vibrated and Afferent.PC in active:
            active.remove(Afferent.PC)
        if missing := [afferent for afferent in active if afferent not in self._makers]:
            raise ScheduleError(
                f"class {missing[0].name} cannot be stimulated in this run: choose one of "
                f"{', '.join(afferent.name for afferent in self._makers)}"
            )
        return tuple(active)

    def _require_exposure_of_all(self) -> None:
        """Raise ScheduleError if a frame exceeds the limits of pulses and charge when all points
        are active in separate slots."""
        sums = np.zeros((3, self._electrodes))
        for maker in self._makers.values():
            if isinstance(maker, PointSlots):
                points = maker.slots(np.ones(self._electrodes, np.float32), 1.0)
                if len(points.site):
                    sums += add_up(points.current_ua, points.width_us, self._limits.felt_ua)[0]
        exposed_us = math.ceil(float(sums[:2].max()) / (PLANNED * MOST_PER_US))
        if exposed_us > BURST_US:
            raise _overexposed(exposed_us)


def _overexposed(needed_us: int) -> ScheduleError:
    return ScheduleError(
        f"the limits of pulses and charge require {needed_us / 1000:.0f} ms for one frame, and at "
        f"most {BURST_US / 1000:.0f} ms are allowed: lower perception.comfort_ratio or "
        "pulse.width_us, or choose another mode"
    )
