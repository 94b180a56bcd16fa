"""Charge balance: reversal of polarity, and a long weak recharge pulse in each scan.

Its current stays at or below a tenth of each electrode's threshold, so that nothing is felt of
it. A long pulse needs less current than a short one, and neighbors add up: by Weiss's law and the
shipped profiles the phase of a letter reaches at most 0.27 of what an afferent needs on the
electric mouse, and 0.44 on the denser Optacon.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from smarttouch.profile import Profile
from smarttouch.profile.ceilings import CEILING_DUTY, CEILING_MEAN_MA
from smarttouch.stimulation.safety_limits import recharge_most_ua
from smarttouch.stimulation.scan_sequence import ScanSequence, ScanTiming
from smarttouch.stimulation.sequence_limits import (
    BURST_US,
    MOST_RECHARGE_PC,
    MOST_RECHARGE_US,
    PLANNED,
)

_LOWEST = np.iinfo(np.int16).min


class ChargeBalance:
    """Sum of the charge of all sequences, electrode by electrode.

    It counts current times width of all that sources drive, recharge phases included; the current
    that flows back through the short circuit after a pulse is unknown and not counted. `charge_pc`,
    (E,) int64 positive cathodic, is exact.
    """

    def __init__(self, electrodes: int) -> None:
        self.charge_pc: NDArray[np.int64] = np.zeros(electrodes, np.int64)

    @property
    def charge_uc(self) -> NDArray[np.float64]:
        """Net charge that has passed each electrode, (E,) µC, positive cathodic."""
        return np.asarray(self.charge_pc * 1e-6)

    @property
    def worst_uc(self) -> float:
        """Largest net charge of any electrode, µC (magnitude)."""
        return float(np.abs(self.charge_uc).max(initial=0.0))

    def add(self, sequence: ScanSequence, times: int = 1) -> None:
        """Add a sequence that is delivered a number of times."""
        self.charge_pc += times * net_charge_pc(sequence)

    def balancing(self, sequence: ScanSequence) -> ScanSequence:
        """Return a sequence or its reversed twin, whichever balances the charge better.

        For boards that cannot recharge (`add_recharge`). The one that leaves the smaller sum of
        squares is taken. The twin has the same sites and the opposite currents, so it keeps all
        limits that the sequence keeps. **It drives the other class**: what reaches RA reaches SAI
        when reversed, and vice versa (Fig. 10). It needs a board of both polarities, and has no
        proof of selectivity. The sum stays as it is.
        """
        if self.charge_uc @ (net_charge_pc(sequence) * 1e-6) <= 0:
            return sequence
        if sequence.current_ua.min() == _LOWEST:
            # It has no positive twin in 16 bits; no profile allows 32 mA anyway.
            return sequence
        return replace(sequence, current_ua=-sequence.current_ua, proof=None)


def net_charge_pc(sequence: ScanSequence) -> NDArray[np.int64]:
    """Return the charge of one scan through each electrode, (E,) pC, positive cathodic."""
    # Whole numbers far below 2**53: this product is exact, and faster than one of integers.
    widths = sequence.width_us.astype(np.float64)
    net = (widths @ sequence.current_ua.astype(np.float64)).astype(np.int64)
    if sequence.recharge_ua is not None:
        net += sequence.recharge_ua.astype(np.int64) * sequence.recharge_us
    return np.asarray(net)


_PLANNED_UA = round(1000 * PLANNED * CEILING_MEAN_MA)
"""Mean current up to which a recharge is planned."""


@dataclass(frozen=True, eq=False)
class RechargeRules:
    """Limits within which recharge phases are planned."""

    most_ua: NDArray[np.int64]  # (E,) largest current of each electrode
    total_ua: int  # largest current of all cathodes together
    timing: ScanTiming
    duty: float = CEILING_DUTY  # largest fraction of the time in which current flows

    @classmethod
    def of(cls, profile: Profile, timing: ScanTiming) -> Self:
        total_ua, most_ua = int(1000 * profile.total_ma), recharge_most_ua(profile.threshold_ma)
        most_ua[list(profile.output.masked)] = 0
        return cls(most_ua, total_ua, timing, profile.limits.duty)


def add_recharge(
    sequence: ScanSequence, carried_pc: NDArray[np.int64], rules: RechargeRules
) -> ScanSequence:
    """Return a sequence with the recharge phase that brings net charge (E,) pC back to zero.

    No electrode gets more than it returns: whole µA leave a rest of up to a µA times its width on
    each electrode, their sum on the strongest, and the excess over the limits is left too. The
    phase is as short as its limits allow, and the period grows where it does not fit. Slots stay as
    they are; without slots so does the sequence.
    """
    wanted_pc = -(carried_pc + net_charge_pc(sequence))
    asked_pc = np.abs(wanted_pc)
    most_ua = rules.most_ua
    if not sequence.slots or not (asked_pc * most_ua).any():
        return sequence
    # As long as the slowest electrode needs, or as it may have at all.
    able = most_ua > 0
    needed_us = -(-asked_pc[able] // most_ua[able])
    allowed_us = np.minimum(MOST_RECHARGE_PC // most_ua[able], MOST_RECHARGE_US)
    width_us = int(np.minimum(needed_us, allowed_us).max())
    most_ua = np.minimum(most_ua, MOST_RECHARGE_PC // width_us)
    # Exact in 53 bits, as the net charge.
    widths = sequence.width_us.astype(np.float64)
    passed_pc = (widths @ np.abs(sequence.current_ua.astype(np.float64))).astype(np.int64)
    most_pc = passed_pc + np.minimum(asked_pc, most_ua * width_us)
    period_us = max(
        sequence.period_us,
        _fitting_us(sequence, width_us, rules),
        # At which no electrode's mean current exceeds the planned one.
        rules.timing.shortest_period_us(min(BURST_US, -(-int(most_pc.max()) // _PLANNED_UA))),
    )
    room_pc = np.maximum(_PLANNED_UA * min(period_us, BURST_US) - passed_pc, 0)
    most_ua = np.minimum(most_ua, room_pc // width_us)
    current_ua = _whole_ua(wanted_pc, most_ua, width_us, rules.total_ua)
    if not current_ua.any():
        return sequence
    return replace(sequence, recharge_ua=current_ua, recharge_us=width_us, period_us=period_us)


def _whole_ua(
    wanted_pc: NDArray[np.int64], most_ua: NDArray[np.int64], width_us: int, total_ua: int
) -> NDArray[np.int16]:
    """Return currents in whole µA that sum to zero, none above its limit or what is wanted."""
    within_ua = np.sign(wanted_pc) * np.minimum(np.abs(wanted_pc) // width_us, most_ua)
    surplus = int(within_ua.sum())
    larger = np.flatnonzero(within_ua * surplus > 0)
    if surplus and abs(surplus) <= len(larger):
        # What rounding down has left over is a µA of those that it took the least of.
        rest_pc = np.abs(wanted_pc - within_ua * width_us)[larger]
        within_ua[larger[np.argsort(rest_pc, kind="stable")[: abs(surplus)]]] -= np.sign(surplus)
    poles_ua = np.cumsum([np.maximum(within_ua, 0), np.maximum(-within_ua, 0)], axis=1)
    shared_ua = min(int(poles_ua[0, -1]), int(poles_ua[1, -1]), total_ua)
    # Sums from electrode to electrode are scaled and rounded down, so that the last is exact and
    # no electrode gets more than its own.
    cathodic, anodic = (pole * shared_ua // max(1, int(pole[-1])) for pole in poles_ua)
    return np.asarray(np.diff(cathodic - anodic, prepend=0), np.int16)


def _fitting_us(sequence: ScanSequence, width_us: int, rules: RechargeRules) -> int:
    """Return the shortest period with room for a recharge phase and a short circuit after it."""
    timing = rules.timing
    slots_us = timing.shortest_period_us(
        0,
        sequence.slots,
        sequence.electrodes,
        float(sequence.width_us.mean()),
        float(sequence.discharge_us.mean()),
    )
    rest_us = int(sequence.discharge_us.max())
    pulses_us = int(sequence.width_us.sum(dtype=np.int64))
    all_us = pulses_us + int(sequence.discharge_us.sum(dtype=np.int64))
    busy_us = max(slots_us, all_us) + width_us + rest_us
    flowing_us = pulses_us + width_us
    # A hair more: the duty is compared in whole numbers.
    return timing.shortest_period_us(max(busy_us, (flowing_us + 1e-6) / rules.duty))
