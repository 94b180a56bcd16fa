"""The scan sequence: all pulses of one frame, as data for a board."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import SafetyError

_INT16, _UINT16, _FLOAT32 = (np.dtype(each) for each in (np.int16, np.uint16, np.float32))


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
    """

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

    @property
    def slots(self) -> int:
        return len(self.width_us)

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


def frozen(sequence: ScanSequence) -> ScanSequence:
    """Return an immutable copy: arrays backed by bytes, and plain whole numbers.

    Raises
    ------
    SafetyError
        If a field has another type or shape than it should.
    """
    current = _fixed("current_ua", sequence.current_ua, _INT16, 2)
    slots = len(current)
    vibration, recharge = sequence.vibration, sequence.recharge_ua
    return ScanSequence(
        current_ua=current,
        width_us=_fixed("width_us", sequence.width_us, _UINT16, 1, slots),
        discharge_us=_fixed("discharge_us", sequence.discharge_us, _UINT16, 1, slots),
        site=_fixed("site", sequence.site, _UINT16, 1, slots),
        period_us=_whole("period_us", sequence.period_us),
        intensity=_real("intensity", sequence.intensity),
        time_ns=_whole("time_ns", sequence.time_ns),
        vibration=None if vibration is None else _fixed("vibration", vibration, _FLOAT32, 1),
        proof=sequence.proof,
        recharge_ua=None if recharge is None else _fixed("recharge_ua", recharge, _INT16, 1),
        recharge_us=_whole("recharge_us", sequence.recharge_us),
    )


def _fixed(
    name: str, values: object, kind: np.dtype[Any], dimensions: int, length: int | None = None
) -> Any:
    """Return an array backed by bytes; raise a SafetyError if its type is wrong."""
    # As a plain array: a class of somebody else's may answer for another array than it is.
    plain = np.asarray(values) if isinstance(values, np.ndarray) else None
    if (
        plain is None
        or plain.dtype != kind
        or plain.ndim != dimensions
        or (length is not None and len(plain) != length)
    ):
        slots = "" if length is None else f" of {length} slots"
        found = type(values).__name__ if plain is None else f"{plain.dtype} of shape {plain.shape}"
        raise SafetyError(
            f"{name} is {found}, must be {kind} in {dimensions} "
            f"dimension{'s' * (dimensions > 1)}{slots}",
            limit=name,
        )
    flat = np.frombuffer(plain.tobytes(), kind)
    return flat if dimensions == 1 else flat.reshape(plain.shape)


def _whole(name: str, value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise SafetyError(f"{name} is {value!r}, must be a whole number", limit=name)
    return int(value)


def _real(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.floating):
        raise SafetyError(f"{name} is {value!r}, must be a number", limit=name)
    try:
        return float(value)
    except OverflowError:
        raise SafetyError(f"{name} is beyond all numbers, must be one", limit=name) from None


def round_charge_balanced(current_ua: NDArray[np.float64]) -> NDArray[np.int16]:
    """Return currents in whole µA that sum to zero in every slot, like the given ones.

    The rounding error is carried on from electrode to electrode, so that none is
    off by a whole µA. Given to one of them, it could raise that above its limit.

    Parameters
    ----------
    current_ua : ndarray, (S, E) µA
    """
    carried = np.cumsum(current_ua, axis=1)
    np.rint(carried, out=carried)
    whole = np.empty(carried.shape, np.int16)
    whole[:, :1] = carried[:, :1]
    np.subtract(carried[:, 1:], carried[:, :-1], out=whole[:, 1:], casting="unsafe")
    return whole
