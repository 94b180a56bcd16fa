"""Scan sequences (all pulses of one frame), and timing constraints of boards.

The currents of slots can be sums of quantized kernels, each times an amplitude. Weights are int16,
scaled to a peak of 32,767 in each kernel; amplitudes are in quarters of a µA. `KernelLists` defines
the resulting currents exactly.
"""

import math
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ScheduleError
from smarttouch.base.tactile_image import one_line
from smarttouch.profile import Profile


class SlotPolicy(NamedTuple):
    """Afferent classes whose points share slots."""

    afferents: tuple[Afferent, ...] = ()


NO_SHARING = SlotPolicy()


def unsupported_reason(profile: Profile) -> str | None:
    """Return why points cannot share slots, naming the profile key; None if they can."""
    if (kind := profile.output.kind) != "weighted":
        return f"output.kind is {kind}, with one source for all electrodes"
    if not profile.shares:
        return "frames.share is off, or limits.total_ma, the limit of shared slots, is not set"
    return None


PER_UA = 4  # amplitudes are in quarters of a µA
PEAK = 32_767  # largest magnitude of a kernel's weights
SHIFT = 17  # weight times amplitude, divided by 2^17, is the current in µA
_HEAD = struct.Struct("<HH")
_SHORTEST_GAP = 3  # this many zeros, or more, end a run; fewer zeros are stored in the run
_OFFSET = 1 << 30  # larger than the total current of any slot, µA; a multiple of 2^16

Shared = Mapping[Afferent, tuple[NDArray[np.float64], NDArray[np.intp]]]


@dataclass(frozen=True, eq=False)
class KernelTable:
    """Quantized kernels of a run."""

    # (K, E) positive cathodic, peak `PEAK`, sum zero; rows of masked sites are zero
    weights: NDArray[np.int16]
    site: NDArray[np.uint16]  # (K,) site of each kernel
    points: dict[Afferent, int]  # index of each class's first kernel for single points
    shared: dict[Afferent, int]  # index of each class's first kernel for shared slots

    def __post_init__(self) -> None:
        # Arrays backed by bytes are read-only.
        weights = np.frombuffer(np.asarray(self.weights, np.int16).tobytes(), np.int16)
        object.__setattr__(self, "weights", weights.reshape(np.shape(self.weights)))
        site = np.frombuffer(np.asarray(self.site, np.uint16).tobytes(), np.uint16)
        object.__setattr__(self, "site", site)

    @classmethod
    def of(cls, weights: Mapping[Afferent, NDArray[np.float64]], shared: Shared) -> "KernelTable":
        """Quantize the kernels of a bank, (E, E) for each class. ``shared`` holds the kernels for
        shared slots, (A, E), and their sites, (A,)."""
        every = {
            afferent_class: (class_weights, np.arange(len(class_weights)))
            for afferent_class, class_weights in weights.items()
        }
        parts: list[NDArray[np.int16]] = []
        sites: list[NDArray[np.intp]] = []
        points: dict[Afferent, int] = {}
        sharing: dict[Afferent, int] = {}
        # Kernels for shared slots come first, as a board may not have space for all kernels.
        for first, kernels in ((sharing, shared), (points, every)):
            for afferent in sorted(kernels):
                first[afferent] = sum(map(len, parts))
                parts.append(quantized(np.asarray(kernels[afferent][0], np.float64)))
                sites.append(kernels[afferent][1])
        site = np.concatenate(sites).astype(np.uint16)
        return cls(np.concatenate(parts), site, points, sharing)

    @cached_property
    def so_far_ua(self) -> NDArray[np.float64]:
        """Running sums of each kernel's currents over electrodes, (K, E) µA, at amplitude 1."""
        # Scaling by a power of two is exact.
        return np.cumsum(self.weights, axis=1, dtype=np.float64) * 2.0**-SHIFT


@dataclass(frozen=True, eq=False)
class KernelLists:
    """Slots as lists of kernels with amplitudes, and the resulting currents.

    For each electrode of a slot, weight times amplitude is added up over kernels. Cumulative sums
    over electrodes are then rounded to µA, halves upward. The current of an electrode is its
    rounded sum minus the rounded sum of the electrode before it.
    """

    table: KernelTable
    # (S + 1,) start of each slot's list, and end of the last list; no list is empty
    first: NDArray[np.intp]
    kernel: NDArray[np.uint16]  # (N,) row in the table
    amplitude: NDArray[np.uint16]  # (N,) in quarters of a µA; at most 65,535 in total per slot
    # (S, E) µA, positive cathodic, sum zero in each slot
    current_ua: NDArray[np.int16] = field(init=False)
    site: NDArray[np.uint16] = field(init=False)  # (S,) site of each slot's first kernel

    def __post_init__(self) -> None:
        # Copy to read-only bytes, so that the sent lists cannot differ from the computed currents.
        first = np.frombuffer(self.first.tobytes(), self.first.dtype)
        kernel = np.frombuffer(self.kernel.tobytes(), self.kernel.dtype)
        amplitude = np.frombuffer(self.amplitude.tobytes(), self.amplitude.dtype)
        # Double precision is exact: sums are multiples of 2^-17 and below 2^36, so 53 bits suffice.
        scaled = self.table.so_far_ua.take(kernel, axis=0)
        scaled *= amplitude.astype(np.float64)[:, None]
        if len(scaled) > len(first) - 1:
            scaled = np.add.reduceat(scaled, first[:-1], axis=0)
        # The offset makes all sums positive, so that the conversion to int64 rounds down. The
        # conversion to int16 removes the offset, a multiple of 2^16.
        scaled += _OFFSET + 0.5
        rounded = scaled.astype(np.int64).astype(np.int16)
        current_ua = rounded.copy()
        current_ua[:, 1:] -= rounded[:, :-1]
        vars(self).update(
            first=first, kernel=kernel, amplitude=amplitude,
            site=self.table.site.take(kernel.take(first[:-1])),
            current_ua=np.frombuffer(current_ua.tobytes(), np.int16).reshape(current_ua.shape),
        )  # fmt: skip


def round_charge_balanced(current_ua: NDArray[np.float64]) -> NDArray[np.int16]:
    """Round currents, (S, E), to integer µA that sum to zero in each slot. The rounding error is
    carried to the next electrode, so that each error is below 1 µA."""
    carried = np.cumsum(current_ua, axis=1)
    np.rint(carried, out=carried)
    rounded = np.empty(carried.shape, np.int16)
    rounded[:, :1] = carried[:, :1]
    np.subtract(carried[:, 1:], carried[:, :-1], out=rounded[:, 1:], casting="unsafe")
    return rounded


def quantized(kernels: NDArray[np.float64]) -> NDArray[np.int16]:
    """Quantize kernels, (K, E), so that each row sums to zero; rows of zeros stay zero."""
    peak = np.abs(kernels).max(axis=1, keepdims=True, initial=0)
    carried = np.cumsum(kernels * (PEAK / np.where(peak > 0, peak, 1)), axis=1)
    carried[:, -1:] = 0
    # Round halves upward. Rounding to even would turn the cumulative sums ±16,383.5 of the kernel
    # (-0.5, 1, -0.5) into ±16,384. Its peak would be 32,768, which int16 cannot hold. Rounding to
    # six decimals comes first: it removes errors of double precision.
    rounded = np.floor(carried.round(6) + 0.5)
    return np.diff(rounded, axis=1, prepend=0).astype(np.int16)


def kept_kernels(
    weights: NDArray[np.int16], sites: NDArray[np.uint16], room: float, most: int
) -> tuple[bytes, int]:
    """Encode kernels, (K, E), and their sites, (K,), for storage on a board. The last kernels are
    left out if the board has room for only ``most`` kernels or ``room`` bytes. Return the bytes
    and the number of encoded kernels."""
    parts, size = [b""], _HEAD.size
    for record in _records(weights[:most], sites):
        if size + len(record) > room:
            break
        parts.append(record)
        size += len(record)
    parts[0] = _HEAD.pack(weights.shape[1], len(parts) - 1)
    return b"".join(parts), len(parts) - 1


def _records(weights: NDArray[np.int16], sites: NDArray[np.uint16]) -> Iterator[bytes]:
    """Yield each kernel as bytes: its site, then its weights without long gaps of zeros."""
    for kernel, site in zip(weights, sites.tolist(), strict=False):
        active = np.flatnonzero(kernel)
        if not len(active):
            yield _HEAD.pack(site, 0)
            continue
        breaks = np.flatnonzero(np.diff(active) > _SHORTEST_GAP)
        starts = active[np.concatenate([[0], breaks + 1])].tolist()
        ends = (active[np.concatenate([breaks, [len(active) - 1]])] + 1).tolist()
        parts = [_HEAD.pack(site, len(starts))]
        for start, end in zip(starts, ends, strict=True):
            parts += [_HEAD.pack(start, end - start), kernel[start:end].astype("<i2").tobytes()]
        yield b"".join(parts)


def largest_amplitude(
    weights: NDArray[np.int16], most_ua: NDArray[np.float64]
) -> NDArray[np.uint16]:
    """Return the largest amplitude of each kernel, (K, E), that keeps the limits, (E,) µA."""
    limit = np.floor(most_ua) * 2.0**SHIFT
    room = [(limit / np.maximum(np.abs(kernel.astype(np.float64)), 1)).min() for kernel in weights]
    return np.minimum(np.floor(room), 0xFFFF).astype(np.uint16)


@dataclass(frozen=True, eq=False)
class SelectivityReport:
    """Selectivity of each slot.

    For shared slots, values are proved bounds that include rounding. For slots with one point, they
    are the values of its kernel. All values are relative to the full activation (level 1) of the
    slot's weakest target.

    Attributes
    ----------
    points : ndarray, (S,) uint16
        Number of points in each slot; 0 for slots without proof.
    off_target : ndarray, (S,) float32
        Largest activation of any other class; NaN without proof.
    spill : ndarray, (S,) float32
        Largest activation of the same class more than a pitch from every target.
    """

    points: NDArray[np.uint16]
    off_target: NDArray[np.float32]
    spill: NDArray[np.float32]

    @classmethod
    def of_nothing(cls, slots: int) -> "SelectivityReport":
        unknown = np.full(slots, np.nan, np.float32)
        return cls(np.zeros(slots, np.uint16), unknown, unknown)


@dataclass(frozen=True, eq=False)
class ScanSequence:
    """One pass over the active points of a tactile image.

    Slots follow each other without gaps. A slot is a pulse followed by a short circuit of all
    electrodes. After the last slot an optional recharge phase, a long imperceptible pulse, returns
    charge. Then electrodes are shorted until the end of the period.

    Attributes
    ----------
    current_ua : ndarray, (S, E) int16, µA
        Current of each electrode in each slot; **positive is cathodic**, negative is anodic, and an
        electrode at zero is insulated. A board with one source may divide the total differently.
    width_us : ndarray, (S,) uint16, µs
        Pulse width of each slot.
    discharge_us : ndarray, (S,) uint16, µs
        Duration of the short circuit after each pulse.
    site : ndarray, (S,) uint16
        Electrode above the point of each slot, or above the first point of a shared slot.
    period_us : int, µs
        Duration of the sequence.
    intensity : float, in [0, 1]
        Intensity by which currents were scaled.
    time_ns : int
        Time of the frame.
    vibration : ndarray, (E,) float32, in [0, 1], optional
        Amplitude of mechanical vibration at each site, for a `Vibrator`.
    proof : SelectivityReport, optional
        Selectivity of shared slots.
    recharge_ua : ndarray, (E,) int16, µA, optional
        Current of each electrode in the recharge phase, **positive cathodic**, with sum zero.
    recharge_us : int, µs
        Duration of the recharge phase; 0 without one.
    sums : KernelLists, optional
        Kernels that add up to the currents. The gate proves the currents, not these lists.
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
    def peak_pc(self) -> int:
        """Largest charge of any pulse at any electrode, pC."""
        return peak_pc(self.current_ua, self.width_us)

    @property
    def points(self) -> int:
        """Number of stimulated points."""
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
        """Total current of all cathodes in each slot, (S,) µA."""
        return np.asarray(np.abs(self.current_ua.astype(np.int32)).sum(axis=1) // 2)


def peak_pc(current_ua: NDArray[np.int16], width_us: NDArray[np.uint16]) -> int:
    """Return the largest charge of a pulse, pC, for currents, (S, E), and widths, (S,)."""
    if not current_ua.size:
        return 0
    longest_us = int(width_us.max())
    if longest_us == width_us.min():
        return max(int(current_ua.max()), -int(current_ua.min())) * longest_us
    high_ua, low_ua = current_ua.max(axis=1), current_ua.min(axis=1).astype(np.int64)
    return int((np.maximum(high_ua, -low_ua) * width_us).max())


@dataclass(frozen=True)
class ScanTiming:
    """Timing constraints of a board; by default there are none."""

    width_us: int | None = None  # the only pulse width, if fixed
    discharge_us: int | None = None  # the only discharge time, if fixed
    slot_extra_us: float = 0.0  # time of a slot in addition to pulse and discharge
    scan_us: float = 0.0  # time of a scan in addition to its slots
    every_electrode: bool = False  # whether electrodes without a point take a slot, too
    in_index_order: bool = False  # whether the board scans by electrode number
    own_widths: bool = True  # whether each slot may have its own pulse width
    whole_hz: bool = False  # whether the rate must be an integer, Hz
    load: float = 1.0  # largest share of the period that a scan may fill

    def shortest_period_us(
        self,
        least_us: float,
        slots: int | None = None,
        electrodes: int = 0,
        width_us: float = 0.0,
        discharge_us: float = 0.0,
    ) -> int:
        """Return the shortest period, at least ``least_us``, that the board can make.

        If ``slots`` is given, a scan of this number of slots must also fit into the period. In this
        case ``width_us`` and ``discharge_us`` are means over slots. For an integer rate of f Hz,
        the period is 1e6/f rounded up, so that ``round(1e6 / period)`` is f.
        """
        if slots is not None:
            taken = electrodes if self.every_electrode else slots
            busy_us = taken * (width_us + discharge_us + self.slot_extra_us) + self.scan_us
            least_us = max(least_us, busy_us / self.load)
        period = math.ceil(least_us)
        if not self.whole_hz or period <= 1:
            return period
        # the largest integer rate whose period, rounded up, is at least `period`
        rate_hz = 999_999 // (period - 1)
        if not rate_hz:
            raise ScheduleError(
                f"a scan takes {period / 1e6:.2f} s, and this board needs at least one scan a "
                "second: lower pulse.discharge_us or the number of electrodes"
            )
        return -(-1_000_000 // rate_hz)

    def check(self, profile: Profile) -> None:
        """Raise ScheduleError unless the board can make the profile's pulses."""
        for key, fixed in (("width_us", self.width_us), ("discharge_us", self.discharge_us)):
            asked = getattr(profile.pulse, key)
            if fixed is not None and asked != fixed:
                raise ScheduleError(
                    f"pulse.{key} of the profile is {asked} µs, but this board needs {fixed} µs: "
                    f"set pulse.{key} = {fixed}"
                )
