"""The scan sequence: all pulses of one frame, as data for a board."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.one_line import one_line
from smarttouch.stimulation.kernel_table import KernelLists


@dataclass(frozen=True, eq=False)
class SelectivityReport:
    """Selectivity of each slot: side effects of its finished currents.

    Of several points computed from the currents as they are sent, after all rounding, or,
    of kernels that are proved for all frames, what no sum of them is above; of a single
    one that of its kernel. Activation is a ratio to that of the slot's
    weakest target, scaled to level 1.

    Attributes
    ----------
    points : ndarray, (S,) uint16
        Number of points of each slot; 0 for slots without proof.
    off_target : ndarray, (S,) float32
        Largest activation of any other class; NaN where nothing is proved.
    spill : ndarray, (S,) float32
        Largest activation of the own class more than a pitch from every target.
    """

    points: NDArray[np.uint16]
    off_target: NDArray[np.float32]
    spill: NDArray[np.float32]

    @property
    def shared(self) -> tuple[float, float] | None:
        """Worst other and worst spill of slots of several points; None if there are none."""
        several = self.points > 1
        if not several.any():
            return None
        return float(self.off_target[several].max()), float(self.spill[several].max())

    @classmethod
    def of_nothing(cls, slots: int) -> "SelectivityReport":
        unknown = np.full(slots, np.nan, np.float32)
        return cls(np.zeros(slots, np.uint16), unknown, unknown)


@dataclass(frozen=True, eq=False)
class ScanSequence:
    """One pass over the active points of a tactile image.

    Slots follow one another without a gap; each is a pulse followed by a
    short circuit of all electrodes. After the last slot comes the recharge phase, if
    there is one: a long weak pulse that brings charge back and that nobody feels.
    Then the electrodes stay shorted until ``period_us`` is over.

    Attributes
    ----------
    current_ua : ndarray, (S, E) int16, µA
        Current of every electrode in every slot; **positive is cathodic**,
        negative anodic, zero insulated. On a board with one source it is the
        nominal division of the source's current.
    width_us : ndarray, (S,) uint16, µs
        Pulse width of each slot.
    discharge_us : ndarray, (S,) uint16, µs
        Short circuit after each pulse.
    site : ndarray, (S,) uint16
        Electrode whose point each slot stimulates.
    period_us : int, µs
        Length of the whole sequence.
    intensity : float, in [0, 1]
        Pressure gate times soft start that the currents were scaled with.
    time_ns : int
        Time of the frame it came from.
    vibration : ndarray, (E,) float32, in [0, 1], optional
        Amplitude of mechanical vibration of the skin under each site for the whole
        period; none if not given.
    proof : SelectivityReport, optional
        Selectivity of shared slots.
    recharge_ua : ndarray, (E,) int16, µA, optional
        Current of every electrode in the recharge phase, **positive cathodic**, sum zero;
        none if not given.
    recharge_us : int, µs
        Length of the recharge phase; 0 without one.
    sums : KernelLists, optional
        Kernels that the currents are sums of. No more than a hint: the currents are what is
        proved and delivered.
    """

    __repr__ = one_line

    current_ua: NDArray[np.int16]
    width_us: NDArray[np.uint16]
    discharge_us: NDArray[np.uint16]
    site: NDArray[np.uint16]
    period_us: int
    intensity: float
    time_ns: int
    vibration: NDArray[np.float32] | None = None
    proof: SelectivityReport | None = None
    recharge_ua: NDArray[np.int16] | None = None
    recharge_us: int = 0
    sums: KernelLists | None = None

    @property
    def slots(self) -> int:
        return len(self.width_us)

    @property
    def drives(self) -> bool:
        """Whether any slot has current."""
        current_ua = self.current_ua
        if not current_ua.size:
            return False
        # The first slot's own electrode nearly always has.
        return bool(current_ua[0, self.site[0] % self.electrodes] or current_ua.any())

    @property
    def peak_pc(self) -> int:
        """Largest charge of one pulse of one electrode, pC."""
        return peak_pc(self.current_ua, self.width_us)

    @property
    def points(self) -> int:
        """Number of points that its slots stimulate."""
        if self.proof is None:
            return self.slots
        return int(np.maximum(self.proof.points, 1).sum(dtype=np.int64))

    @property
    def electrodes(self) -> int:
        return int(self.current_ua.shape[1])

    @property
    def rate_hz(self) -> float:
        return 1e6 / self.period_us

    @property
    def state(self) -> NDArray[np.int8]:
        """State of each electrode in each slot: 1 cathode, −1 anode, 0 insulated."""
        return np.sign(self.current_ua).astype(np.int8)

    @property
    def source_ua(self) -> NDArray[np.int32]:
        """Total current of all cathodes in each slot, (S,) µA: one source's current."""
        return np.asarray(np.abs(self.current_ua.astype(np.int32)).sum(axis=1) // 2)


def peak_pc(current_ua: NDArray[np.int16], width_us: NDArray[np.uint16]) -> int:
    """Return the largest charge of one electrode in slots of (S, E) µA and (S,) µs, pC."""
    if not current_ua.size:
        return 0
    longest_us = int(width_us.max())
    if longest_us == width_us.min():
        return max(int(current_ua.max()), -int(current_ua.min())) * longest_us
    high_ua, low_ua = current_ua.max(axis=1), current_ua.min(axis=1).astype(np.int64)
    return int((np.maximum(high_ua, -low_ua) * width_us).max())
