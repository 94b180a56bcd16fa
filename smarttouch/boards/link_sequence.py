"""The payloads of ``link`` that carry scans: SEQUENCE and VOLTAGES (see `protocol`)."""

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.link_protocol import Output
from smarttouch.errors import BoardError
from smarttouch.wire.framing import LARGEST_PACKET

_SEQUENCE = struct.Struct("<IHHBBH")
_MEASURE, _RECHARGE = 1, 2
_VOLT = 100
_U16_MAX = 0xFFFF


@dataclass(frozen=True, eq=False)
class WireSequence:
    """Sequence received by a board.

    ``current_ua`` is (S, E) int16 for weighted boards; for switched ones
    ``state`` is (S, E) int8 (1 cathode, −1 anode, 0 insulated, 2 not a state)
    and ``source_ua`` (S,) uint16. Positive is cathodic. ``recharge_ua`` is (E,) int16,
    None without a recharge phase.
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


def encode_sequence(
    output: Output,
    period_us: int,
    width_us: NDArray[np.uint16],
    discharge_us: NDArray[np.uint16],
    site: NDArray[np.uint16],
    current_ua: NDArray[np.int16],
    times: int = 1,
    measure: bool = False,
    recharge_ua: NDArray[np.int16] | None = None,
    recharge_us: int = 0,
) -> bytes:
    """Return the payload of a SEQUENCE; the columns are those of a scan sequence.

    Raises
    ------
    BoardError
        If it is larger than a packet, needs a stronger source than the wire can say, or asks a
        switched board for a recharge phase.
    """
    slots, electrodes = current_ua.shape
    if slots > _U16_MAX:
        raise BoardError(
            f"{slots} slots are above the limit of {_U16_MAX}: scan fewer points",
            about="slots",
            problem="too many",
            value=slots,
            allowed=_U16_MAX,
        )
    switched = output != "weighted"
    if switched and recharge_ua is not None:
        raise BoardError(
            f"a recharge phase needs a source for each electrode, and this board is {output}: "
            "leave it out",
            about="recharge_ua",
            problem="impossible",
        )
    flags = _MEASURE * measure | _RECHARGE * (recharge_ua is not None)
    parts = [
        _SEQUENCE.pack(period_us, slots, electrodes, switched, flags, times),
        width_us.astype("<u2", copy=False).tobytes(),
        discharge_us.astype("<u2", copy=False).tobytes(),
        site.astype("<u2", copy=False).tobytes(),
    ]
    if switched:
        parts += [source_of(current_ua).tobytes(), pack_states(np.sign(current_ua))]
    else:
        parts.append(current_ua.astype("<i2", copy=False).tobytes())
    if recharge_ua is not None:
        parts += [_u16(np.array([recharge_us])), recharge_ua.astype("<i2", copy=False).tobytes()]
    payload = b"".join(parts)
    if len(payload) > LARGEST_PACKET:
        raise BoardError(
            f"a packet of {len(payload)} bytes is above the limit of {LARGEST_PACKET}: "
            "scan fewer points at once",
            about="packet",
            problem="too large",
            value=len(payload),
            allowed=LARGEST_PACKET,
        )
    return payload


def decode_sequence(payload: bytes) -> WireSequence:
    """Return the sequence in a payload.

    Raises
    ------
    ValueError
        If the payload is not exactly one sequence.
    """
    if len(payload) < _SEQUENCE.size:
        raise ValueError(f"{len(payload)} bytes are no sequence")
    period_us, slots, electrodes, kind, flags, times = _SEQUENCE.unpack_from(payload)
    packed = -(-electrodes // 4)
    row = 6 + (2 * electrodes if kind == 0 else 2 + packed)
    recharges = bool(flags & _RECHARGE)
    if not times or flags > (_MEASURE | _RECHARGE) or kind > 1 or (kind == 1 and recharges):
        raise ValueError(f"{times} times, flags {flags}, kind {kind} are no sequence")
    end = _SEQUENCE.size + slots * row
    if len(payload) != end + recharges * 2 * (1 + electrodes):
        raise ValueError(
            f"{len(payload)} bytes are not {slots} slots of {electrodes} electrodes, kind {kind}"
        )
    columns = np.frombuffer(payload, "<u2", (4 if kind else 3) * slots, _SEQUENCE.size)
    rest = payload[_SEQUENCE.size + columns.nbytes : end]
    width, discharge, site = columns[: 3 * slots].reshape(3, slots)
    current = source = state = None
    if kind == 0:
        current = np.frombuffer(rest, "<i2").reshape(slots, electrodes)
    else:
        source = columns[3 * slots :]
        state = unpack_states(np.frombuffer(rest, np.uint8).reshape(slots, packed), electrodes)
    recharge_us, recharge = 0, None
    if recharges:
        recharge_us = int.from_bytes(payload[end : end + 2], "little")
        recharge = np.frombuffer(payload, "<i2", electrodes, end + 2)
    return WireSequence(
        period_us, times, bool(flags & _MEASURE), electrodes, width, discharge, site, current,
        source, state, recharge, recharge_us,
    )  # fmt: skip


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
    """Return the current of a switched board's one source in each slot, (S,) µA.

    Raises
    ------
    BoardError
        If it is more than the wire can say.
    """
    source = np.maximum(current_ua, 0).sum(axis=1, dtype=np.int64)
    strongest = int(source.max(initial=0))
    if strongest > _U16_MAX:
        raise BoardError(
            f"a slot asks {strongest / 1000:.1f} mA of one source, the wire carries at most "
            f"{_U16_MAX / 1000:.1f} mA: lower the currents",
            about="source_ua",
            problem="too large",
            value=strongest,
            allowed=_U16_MAX,
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
