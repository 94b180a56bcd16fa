"""Parts of the payloads of ``link`` that carry scans: states, voltages, a sequence as it came."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import BoardError

_VOLT = 100
_U16_MAX = 0xFFFF


@dataclass(frozen=True, eq=False)
class WireSequence:
    """Sequence received by a board.

    ``current_ua`` is (S, E) int16 for weighted boards; for switched ones ``state`` is (S, E) int8
    (1 cathode, −1 anode, 0 insulated, 2 not a state) and ``source_ua`` (S,) uint16. Positive is
    cathodic. ``recharge_ua`` is (E,) int16, None without a recharge phase.
    """

    period_us: int
    times: int
    measure: bool
    electrodes: int
    width_us: NDArray[np.uint16]
    discharge_us: NDArray[np.uint16]
    site: NDArray[np.uint16]
    current_ua: NDArray[np.int16] | None
    source_ua: NDArray[np.uint16] | None
    state: NDArray[np.int8] | None
    recharge_ua: NDArray[np.int16] | None = None
    recharge_us: int = 0


def encode_volts(volts: NDArray[np.float64]) -> bytes:
    """Return the payload of VOLTAGES: the source's voltage in each slot, (S,) V."""
    return _u16(np.clip(np.rint(volts * _VOLT), 0, _U16_MAX))


def decode_volts(payload: bytes) -> NDArray[np.float32]:
    """Return the voltages in a payload of VOLTAGES, (S,) V; an odd byte is dropped."""
    whole = payload[: len(payload) // 2 * 2]
    return np.asarray(np.frombuffer(whole, "<u2") / np.float32(_VOLT), np.float32)


def _u16(values: NDArray[Any]) -> bytes:
    return values.astype("<u2", copy=False).tobytes()


def source_of(current_ua: NDArray[np.int16]) -> NDArray[np.uint16]:
    """Return the current of a switched board's one source in each slot, (S,) µA."""
    source = np.maximum(current_ua, 0).sum(axis=1, dtype=np.int64)
    strongest = int(source.max(initial=0))
    if strongest > _U16_MAX:
        raise BoardError(
            f"a slot asks {strongest / 1000:.1f} mA of one source, the wire carries at most "
            f"{_U16_MAX / 1000:.1f} mA: lower the currents",
            about="source_ua",
            slot=int(source.argmax()),
        )
    found: NDArray[np.uint16] = source.astype("<u2")
    return found


def pack_states(signs: NDArray[np.int16]) -> bytes:
    slots, electrodes = signs.shape
    row = -(-electrodes // 4)
    codes = np.zeros((slots, row * 4), np.uint8)
    codes[:, :electrodes] = np.where(signs < 0, 2, signs)
    four = codes.reshape(slots, row, 4)
    packed = four[..., 0] | four[..., 1] << 2 | four[..., 2] << 4 | four[..., 3] << 6
    return bytes(packed.tobytes())


def unpack_states(packed: NDArray[np.uint8], electrodes: int) -> NDArray[np.int8]:
    codes = (packed[..., None] >> np.array([0, 2, 4, 6], np.uint8)) & 3
    flat = codes.reshape(len(packed), packed.shape[1] * 4)[:, :electrodes]
    return np.asarray(np.array([0, 1, -1, 2], np.int8)[flat])
