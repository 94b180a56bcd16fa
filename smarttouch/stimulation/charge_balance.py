"""Charge balance by reversed polarity, or by a long weak recharge phase in each scan.

The recharge current of an electrode is at most a tenth of its threshold for pulses. A long phase
has a lower threshold than a pulse, and currents of neighbors add up. The phase nevertheless cannot
be felt: by Weiss's law, it reaches at most 0.27 of an afferent's threshold while a letter is shown
on the electric mouse, and 0.44 on the denser electrodes of the Optacon.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from smarttouch.profile import Profile
from smarttouch.profile.project_ceilings import CEILING_DUTY, CEILING_MEAN_MA
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
    """Ledger of the net charge through each electrode.

    It adds up current times width of all pulses and recharge phases. The charge that flows back in
    the short circuit after a pulse is unknown and not counted. `charge_pc`, (E,) int64, positive
    cathodic, is the exact sum.
    """

    def __init__(self, electrodes: int) -> None:
        self.charge_pc: NDArray[np.int64] = np.zeros(electrodes, np.int64)

    @property
    def charge_uc(self) -> NDArray[np.float64]:
        """Net charge through each electrode, (E,) µC, positive cathodic."""
        return np.asarray(self.charge_pc * 1e-6)

    @property
    def worst_uc(self) -> float:
        """Largest net charge of any electrode, µC (magnitude)."""
        return float(np.abs(self.charge_uc).max(initial=0.0))

    def add(self, sequence: ScanSequence, times: int = 1) -> None:
        """Add the charge of a sequence; ``times`` is the number of its passes."""
        self.charge_pc += times * net_charge_pc(sequence)

    def balancing(self, sequence: ScanSequence) -> ScanSequence:
        """Return a sequence or its reversal, whichever leaves the smaller Σ (net charge)².

        Use this for boards of both polarities that cannot make recharge phases. If a board can make
        them, use `add_recharge`. The reversal has opposite currents at the same sites, and keeps
        the same limits. **The reversal stimulates another class**: reversed currents for RA
        stimulate SAI, and vice versa (paper, Fig. 10). The reversal has no proof of selectivity.
        `charge_pc` does not change.
        """
        if self.charge_uc @ (net_charge_pc(sequence) * 1e-6) <= 0:
            return sequence
        if sequence.current_ua.min() == _LOWEST:
            # -32,768 cannot be negated in 16 bits; no profile allows 32 mA anyway.
            return sequence
        return replace(sequence, current_ua=-sequence.current_ua, proof=None)


def net_charge_pc(sequence: ScanSequence) -> NDArray[np.int64]:
    """Return the charge of one scan through each electrode, (E,) pC, positive cathodic."""
    # With integers far below 2**53 a float64 product is exact; it is faster than an int64 one.
    widths = sequence.width_us.astype(np.float64)
    net = (widths @ sequence.current_ua.astype(np.float64)).astype(np.int64)
    if sequence.recharge_ua is not None:
        net += sequence.recharge_ua.astype(np.int64) * sequence.recharge_us
    return np.asarray(net)


_PLANNED_UA = round(1000 * PLANNED * CEILING_MEAN_MA)
"""Largest planned mean current of an electrode, µA."""


@dataclass(frozen=True, eq=False)
class RechargeRules:
    """Limits of planned recharge phases."""

    most_ua: NDArray[np.int64]  # (E,) largest current of each electrode
    total_ua: int  # largest total current of all cathodes
    timing: ScanTiming
    duty: float = CEILING_DUTY  # largest share of time in which current flows

    @classmethod
    def of(cls, profile: Profile, timing: ScanTiming) -> Self:
        total_ua, most_ua = int(1000 * profile.total_ma), recharge_most_ua(profile.threshold_ma)
        most_ua[list(profile.output.masked)] = 0
        return cls(most_ua, total_ua, timing, profile.limits.duty)


def add_recharge(
    sequence: ScanSequence, carried_pc: NDArray[np.int64], rules: RechargeRules
) -> ScanSequence:
    """Return a sequence with a recharge phase that brings the net charge of electrodes to zero.

    ``carried_pc``, (E,), is the net charge before the sequence. No electrode returns more than it
    carries. Limits and rounding to integer µA can leave a remainder. The phase is as short as its
    limits allow; the period becomes longer if necessary. Without slots, no phase is added.
    """
    wanted_pc = -(carried_pc + net_charge_pc(sequence))
    asked_pc = np.abs(wanted_pc)
    most_ua = rules.most_ua
    if not sequence.slots or not (asked_pc * most_ua).any():
        return sequence
    # The width of the phase is the longest time that any electrode needs, within its limit.
    able = most_ua > 0
    needed_us = -(-asked_pc[able] // most_ua[able])
    allowed_us = np.minimum(MOST_RECHARGE_PC // most_ua[able], MOST_RECHARGE_US)
    width_us = int(np.minimum(needed_us, allowed_us).max())
    most_ua = np.minimum(most_ua, MOST_RECHARGE_PC // width_us)
    widths = sequence.width_us.astype(np.float64)
    passed_pc = (widths @ np.abs(sequence.current_ua.astype(np.float64))).astype(np.int64)
    most_pc = passed_pc + np.minimum(asked_pc, most_ua * width_us)
    period_us = max(
        sequence.period_us,
        _fitting_us(sequence, width_us, rules),
        # the shortest period in which no electrode exceeds the planned mean current
        rules.timing.shortest_period_us(min(BURST_US, -(-int(most_pc.max()) // _PLANNED_UA))),
    )
    room_pc = np.maximum(_PLANNED_UA * min(period_us, BURST_US) - passed_pc, 0)
    most_ua = np.minimum(most_ua, room_pc // width_us)
    current_ua = _recharge_ua(wanted_pc, most_ua, width_us, rules.total_ua)
    if not current_ua.any():
        return sequence
    return replace(sequence, recharge_ua=current_ua, recharge_us=width_us, period_us=period_us)


def _recharge_ua(
    wanted_pc: NDArray[np.int64], most_ua: NDArray[np.int64], width_us: int, total_ua: int
) -> NDArray[np.int16]:
    """Return recharge currents, (E,), in integer µA that sum to zero. No current exceeds its limit,
    and no electrode gets more than its wanted charge."""
    within_ua = np.sign(wanted_pc) * np.minimum(np.abs(wanted_pc) // width_us, most_ua)
    surplus = int(within_ua.sum())
    larger = np.flatnonzero(within_ua * surplus > 0)
    if surplus and abs(surplus) <= len(larger):
        # Reduce the currents with the smallest rounding errors by 1 µA each.
        rest_pc = np.abs(wanted_pc - within_ua * width_us)[larger]
        within_ua[larger[np.argsort(rest_pc, kind="stable")[: abs(surplus)]]] -= np.sign(surplus)
    poles_ua = np.cumsum([np.maximum(within_ua, 0), np.maximum(-within_ua, 0)], axis=1)
    shared_ua = min(int(poles_ua[0, -1]), int(poles_ua[1, -1]), total_ua)
    # Scale the cumulative sums of both polarities to the same total, and round down. The
    # differences of these sums are the currents: they sum to zero, and none is larger than before.
    cathodic, anodic = (pole * shared_ua // max(1, int(pole[-1])) for pole in poles_ua)
    return np.asarray(np.diff(cathodic - anodic, prepend=0), np.int16)


def _fitting_us(sequence: ScanSequence, width_us: int, rules: RechargeRules) -> int:
    """Return the shortest period that fits the slots, a recharge phase and a short circuit."""
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
    # Add a small margin, because the gate compares the duty in integers.
    return timing.shortest_period_us(max(busy_us, (flowing_us + 1e-6) / rules.duty))
