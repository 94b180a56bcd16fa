"""Tactile image times kernels times intensity: the slots of one frame."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ScheduleError
from smarttouch.base.tactile_image import TactileImage
from smarttouch.kernels.bank import KernelBank
from smarttouch.profile import Profile
from smarttouch.stimulation.adaptation import Adaptation
from smarttouch.stimulation.frame_slots import FrameSlots
from smarttouch.stimulation.net_plan import NetPlan
from smarttouch.stimulation.point_slots import PointSlots, Slots, constant_us, joined
from smarttouch.stimulation.pulse_rates import PulseRates, ScanTiming, rate_share, rates_of
from smarttouch.stimulation.ramp import FIRST_NS, MOST_STEP_NS, PPB
from smarttouch.stimulation.safety_limits import SafetyLimits, parts_per_billion
from smarttouch.stimulation.scan_sequence import (
    NO_SHARING,
    KernelTable,
    ScanSequence,
    SlotPolicy,
    peak_pc,
)
from smarttouch.stimulation.slot_sums import (
    BURST_US,
    MOST_PER_US,
    PER_PC,
    PER_PULSE,
    PLANNED,
    Load,
    SlotAdder,
    shortest_period_us,
)

_PULSE_US = PER_PULSE / (PLANNED * MOST_PER_US)  # period planned for each pulse of an electrode
_Maker = tuple[PointSlots | FrameSlots, Afferent]
"""Maker of slots, and its class."""


@dataclass
class SchedulerContext:
    """What the schedulers of one run have in common."""

    sharing: SlotPolicy = NO_SHARING
    frames: dict[Afferent, FrameSlots] = field(default_factory=dict)
    """Slots that points of a class share, of all schedulers."""
    points: dict[Afferent, PointSlots] = field(default_factory=dict)
    """Slots of points of the other classes, of all schedulers."""
    table: KernelTable | None = None  # kernels whose sums slots are, in whole numbers, if given
    net: NetPlan | None = None  # bound of periods by net charge, unless recharge phases return it


class ScanScheduler:
    """Scheduler of one slot for each active point (paper, Section IV-A, Fig. 19), or fewer.

    Each of several classes has its own pulse rate; `rate_hz` is that of a single one. Softness, in
    [0, 1], reduces the effect of force on the rate of SAI pulses. If `vibrated`, mechanical
    vibrators stimulate PC, without current. `net_slowed` and `net_emptied` count sequences made
    longer or left without slots for net charge; `asked_us` is the period of the last one if its
    slots fit. An impossible rate, pulses that the board does not have, and a bank that drives a
    masked electrode raise a ScheduleError.
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
        timing = ScanTiming() if timing is None else timing
        timing.check(profile)
        pulse, limits = profile.pulse, profile.limits
        rates_hz = rates_of(profile, afferents, rate_hz, timing)
        self._vibrated = vibrated
        self._driven = driven = tuple(e for e in afferents if not vibrated or e is not Afferent.PC)
        points, shared = common.points, common.sharing.afferents
        for each in set(driven) - {*shared, *points}:
            points[each] = PointSlots(profile, bank, each, timing, common.table)
        self._points = {each: points[each] for each in driven if each not in shared}
        self._frames = _shared_slots(profile, bank, driven, common)
        self.asked_us: int = 0
        self._first = driven[0]
        self._softness = softness
        self._least_us = math.ceil(1e6 / limits.rate_hz)
        self._has_rates = bool(rates_hz)
        self._rates = PulseRates(rates_hz, self._least_us)
        self._one_rate_hz = rates_hz[afferents[0]] if len(afferents) == 1 else None
        self._always: tuple[tuple[Afferent, ...], int] | None = None
        """Classes that are due and their period, where neither ever changes."""
        if self._one_rate_hz and (self._first is not Afferent.SAI or softness == 1):
            self._always = (self._first,), timing.possible_period_us(1e6 / self._one_rate_hz)
        self._makers: dict[tuple[Afferent, ...], list[_Maker]] = {}
        self._discharge_us = pulse.discharge_us
        # At most one slot for each point of each class.
        most = len(profile.electrodes) * len(afferents)
        self._discharges_us = constant_us(most, pulse.discharge_us)
        self._duty = limits.duty
        self._timing = timing
        self._electrodes = len(profile.electrodes)
        self._limits = SafetyLimits.of(profile)
        self._adder = SlotAdder(self._limits.felt_ua)
        first = FIRST_NS / self._limits.ramp_ns
        self._first_steps = (2 * first, MOST_STEP_NS / self._limits.ramp_ns)
        # Before anything is sent: the longest scan must be possible too.
        self._shortest_us(self._electrodes, self._electrodes * pulse.width_us)
        by_height = pulse.carrier != "width" or set(driven) <= set(bank.discs)
        self._one_width_us = pulse.width_us if by_height else None
        self._shortest: dict[int, int] = {}
        """Shortest period by the number of slots, where all have one width."""
        self.net_slowed: int = 0
        self.net_emptied: int = 0
        self._net = common.net
        self._felt_us, self._charge_us, self._net_at_most_pc = (math.inf,) * 3
        if not set(driven) <= set(bank.discs):
            self._bound_exposure(pulse.width_us)

    def restart(self) -> None:
        """Restart: all classes are due."""
        self._rates.restart()

    def schedule(
        self,
        image: TactileImage,
        intensity: float,
        pressure: float = 1.0,
        allowed: float = 1.0,
        adaptation: Adaptation | None = None,
    ) -> ScanSequence:
        """Return the sequence of one tactile image at an intensity and a pressure in [0, 1].

        Where the slots do not fit the period asked for, the period grows. At intensity 0 there are
        none. The rate of SAI pulses follows pressure. Intensity is lowered until strength
        (`SafetyLimits.strength_ppb`) is at most ``allowed``, in [0, 1]. If the image has a period,
        every active class pulses now, and not again before it has passed. One that the profile's
        limits forbid, or a class that cannot be driven, raises a ScheduleError.
        """
        if image.period_us is not None:
            due, asked_us = self._active(image.activation, image.period_us), image.period_us
        else:
            due, asked_us = self._always or self._due(image.time_ns, pressure)
        self.asked_us = asked_us
        # None is due where the rate has fallen since this time was set.
        classes, scale = (due, intensity) if due else ((self._first,), 0.0)
        makers = self._makers.get(classes) or self._makers_of(classes)
        made = _slots_of(makers, image.activation, scale, adaptation)
        if intensity > allowed:
            charge_pc, ppb = peak_pc(made.current_ua, made.width_us), parts_per_billion(intensity)
            # Whole µA may be a little stronger than asked for.
            strength_ppb = min(ppb, self._limits.strength_ppb(ppb, charge_pc))
            wanted, intensity = intensity, intensity if strength_ppb else allowed
            # The first step may be too weak for any pulse.
            for least in (0, *self._first_steps) if allowed else (0,):
                most = max(allowed, least)
                if strength_ppb <= most * PPB:
                    break
                intensity = wanted * most * PPB / strength_ppb
                made = _slots_of(makers, image.activation, intensity, adaptation)
                if made.current_ua.any():
                    break
        site, current_ua, width_us, proof, sums = made
        slots = len(site)
        shortest_us = None if adaptation is not None else self._shortest.get(slots)
        if shortest_us is None:
            shortest_us = self._shortest_us(slots, int(width_us.sum(dtype=np.int64)))
            if self._one_width_us is not None and adaptation is None:
                self._shortest[slots] = shortest_us
        if self._timing.whole_hz:
            asked_us = self._timing.possible_period_us(asked_us)
        period_us = max(asked_us, shortest_us)
        # No electrode gets more pulses than there are slots.
        felt_us = min(self._felt_us, _PULSE_US * slots)
        if max(self._charge_us, felt_us) > min(period_us, BURST_US):
            needed_us = self._checked_us(self._load(current_ua, width_us))
            period_us = max(period_us, self._timing.possible_period_us(needed_us))
        if self._net is not None and slots:
            period_us, admitted = self._within_net(
                self._net, current_ua, width_us, period_us, image
            )
            if not admitted:
                slots, site, current_ua, width_us = 0, site[:0], current_ua[:0], width_us[:0]
                proof = sums = None
        return ScanSequence(
            current_ua=current_ua,
            width_us=width_us,
            discharge_us=self._discharges_us[:slots],
            site=site,
            period_us=period_us,
            intensity=float(intensity),
            time_ns=image.time_ns,
            vibration=image.activation[Afferent.PC] * np.float32(intensity)
            if self._vibrated
            else None,
            proof=proof,
            sums=sums,
        )

    def _makers_of(self, classes: tuple[Afferent, ...]) -> list[_Maker]:
        """Return the makers of slots of each class; cached."""
        made = self._frames | self._points
        makers = self._makers[classes] = [(made[each], each) for each in classes]
        return makers

    def _active(self, activation: NDArray[np.float32], period_us: int) -> tuple[Afferent, ...]:
        """Return the classes that an image with its own period lets pulse."""
        if period_us < self._least_us:
            raise ScheduleError(
                f"pulses {period_us} µs apart are not possible: the profile's limit of "
                f"{1e6 / self._least_us:g} Hz asks for {self._least_us} µs or more"
            )
        driven = []
        for each in np.flatnonzero(activation.any(axis=1)).tolist():
            if each in self._driven:
                driven.append(Afferent(each))
            elif not (self._vibrated and each == Afferent.PC):
                offered = ", ".join(afferent.name for afferent in self._driven) or "none"
                raise ScheduleError(
                    f"{Afferent(each).name} was requested and cannot be driven here: choose one "
                    f"of {offered}"
                )
        return tuple(driven)

    def _due(self, time_ns: int, pressure: float) -> tuple[tuple[Afferent, ...], int]:
        """Return the classes that pulse now, and the time until the next is due, µs."""
        share = rate_share(pressure, self._softness)
        if not self._has_rates:
            raise ScheduleError(
                "mode color is for stimuli with periods of their own, and this source gives none: "
                "choose RA"
            )
        if self._one_rate_hz is None:
            return self._rates.due(time_ns, {Afferent.RA: 1.0, Afferent.SAI: share})
        slowed_hz = self._one_rate_hz * (share if self._first is Afferent.SAI else 1.0)
        return (self._first,), self._timing.possible_period_us(1e6 / slowed_hz)

    def _bound_exposure(self, width_us: int) -> None:
        """Find periods that keep the exposure of any image; infinite where points share slots."""
        load = np.zeros((2, self._electrodes))
        everywhere = np.ones(self._electrodes, np.float32)
        for points in self._points.values():
            all_points = points.slots(everywhere, 1.0)
            load += self._load(all_points.current_ua, all_points.width_us)
        self._checked_us(load)
        for frames in self._frames.values():
            load[0] = math.inf
            load[1] += frames.most_ua * width_us * PER_PC
        most_felt, most_charge = load.max(axis=1).tolist()
        self._felt_us = most_felt / (PLANNED * MOST_PER_US)
        self._charge_us = most_charge / (PLANNED * MOST_PER_US)
        # In whole pC: what is added up is taken away again without a rest.
        self._net_at_most_pc = float(np.ceil(most_charge / PER_PC))

    def _within_net(
        self,
        net: NetPlan,
        current_ua: NDArray[np.int16],
        width_us: NDArray[np.uint16],
        period_us: int,
        image: TactileImage,
    ) -> tuple[int, bool]:
        """Return a period that keeps the limit of net current, and whether slots keep it now."""
        time_us = image.time_ns / 1000
        if net.spares(self._net_at_most_pc, time_us, period_us):
            return period_us, True
        net_pc = (width_us.astype(np.float32) @ current_ua.astype(np.float32)).astype(np.float64)
        if not net.admits(net_pc, time_us):
            self.net_emptied += 1
            return period_us, False
        busy_us = int(width_us.sum(dtype=np.int64)) + len(width_us) * self._discharge_us
        needed_us = net.period_us(net_pc, time_us, period_us, busy_us)
        if needed_us <= period_us:
            return period_us, True
        self.net_slowed += 1
        return self._timing.possible_period_us(needed_us), True

    def _load(self, current_ua: NDArray[np.int16], width_us: NDArray[np.uint16]) -> Load:
        if not len(width_us):
            return np.zeros((2, self._electrodes))
        return self._adder.add_up(current_ua, width_us).sums[:2]

    def _checked_us(self, load: Load) -> int:
        needed_us = shortest_period_us(load)
        if needed_us > BURST_US:
            raise ScheduleError(
                f"the points of one frame expose an electrode as much as {needed_us / 1000:.0f} ms "
                f"allow, and one sequence may bring at most {BURST_US / 1000:.0f} ms of it: lower "
                "perception.comfort_ratio or pulse.width_us, or choose another mode"
            )
        return needed_us

    def _shortest_us(self, slots: int, pulses_us: int) -> int:
        """Return the shortest period of slots whose pulses take so long together, µs."""
        timing = self._timing
        mean_us = pulses_us / slots if slots else 0.0
        shortest = timing.shortest_period_us(slots, self._electrodes, mean_us, self._discharge_us)
        return max(shortest, timing.possible_period_us(pulses_us / self._duty))


def _slots_of(
    makers: list[_Maker],
    activation: NDArray[np.float32],
    intensity: float,
    adaptation: Adaptation | None,
) -> Slots:
    """Return the slots of all classes that are due."""
    (maker, of), *others = makers
    made = maker.slots(activation[of], intensity)
    if others:
        made = joined([made, *(one.slots(activation[each], intensity) for one, each in others)])
    return made if adaptation is None or not len(made.site) else adaptation.apply(made)


def _shared_slots(
    profile: Profile, bank: KernelBank, afferents: Sequence[Afferent], common: SchedulerContext
) -> dict[Afferent, FrameSlots]:
    """Return the shared slots of classes, from those in common or added."""
    shared = [each for each in afferents if each in common.sharing.afferents]
    for each in shared:
        if each not in common.frames:
            common.frames[each] = FrameSlots(profile, bank, each)
    return {each: common.frames[each] for each in shared}
