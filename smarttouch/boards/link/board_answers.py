"""What a ``link`` board says of itself: capabilities, refusals, and when sequences began."""

from collections import deque
from typing import NamedTuple

from smarttouch.base.errors import BoardError
from smarttouch.boards.link import protocol as protocol
from smarttouch.boards.link.protocol import NOTHING, Feature, Message, Rule
from smarttouch.boards.link.sequence_encoding import ScanPart
from smarttouch.boards.reports import Capabilities
from smarttouch.stimulation.safety_gate import ProvedSequence


def capabilities_of(answer: Message, name: str) -> Capabilities:
    """Return the capabilities in a CAPABILITIES of any version."""
    if answer.version != protocol.VERSION:
        raise BoardError(
            f"the board at {name} speaks link version {answer.version}, this "
            f"program {protocol.VERSION}: bring both to the same"
        )
    head = protocol.CAPABILITIES.size
    if len(answer.payload) < head + protocol.KEEPING.size:
        raise malformed(name)
    outputs, output, features, current_ua, slots, zero_ms, volts = (
        protocol.CAPABILITIES.unpack_from(answer.payload)
    )
    if output >= len(protocol.OUTPUTS):
        raise BoardError(f"the board at {name} has outputs of unknown kind {output}")
    kind = protocol.OUTPUTS[output]
    room, packet, kernels = protocol.KEEPING.unpack_from(answer.payload, head)
    head += protocol.KEEPING.size
    if not features & Feature.KERNELS:
        room = kernels = 0
    return Capabilities(
        electrodes=outputs, output=kind, max_current_ma=current_ua / 1000, max_slots=slots,
        time_to_zero_ms=zero_ms, firmware=answer.payload[head:].decode("utf-8", "replace"),
        measures=bool(features & Feature.VOLTAGE), force=bool(features & Feature.FORCE),
        compliance_v=float(volts) or None, recharges=bool(features & Feature.RECHARGE),
        emergency_switch=bool(features & Feature.EMERGENCY), kernel_bytes=room,
        most_kernels=kernels, packet_bytes=packet,
    )  # fmt: skip


def malformed(name: str) -> BoardError:
    """Return the error of a board that gives invalid answers."""
    return BoardError(f"the board at {name} gives invalid answers: check its firmware")


def reason_of(refusal: Message) -> tuple[int, int, str]:
    """Return reason, rule and text of a NAK."""
    if len(refusal.payload) != protocol.NAK.size:
        return 0, Rule.NONE, ""
    reason, rule, slot, electrode, value, allowed = protocol.NAK.unpack(refusal.payload)
    name = next((each.name.lower() for each in Rule if each == rule), "unknown")
    words = f"rule {rule} ({name})" if rule else "malformed"
    words += f": {value}, allowed {allowed}" if value or allowed else ""
    words += f", slot {slot}" if slot != NOTHING else ""
    words += f", electrode {electrode}" if electrode != NOTHING else ""
    return reason, rule, words


class SentPart(NamedTuple):
    """Sequence on its way, or the part of one that a packet has room for."""

    number: int
    proved: ProvedSequence
    part: ScanPart
    sent_ns: int


class BoardClock:
    """Reads a board's clock as the host's, by the answer that came fastest of the last few."""

    def __init__(self) -> None:
        self._ahead_ns: deque[int] = deque(maxlen=16)

    def note(self, board_us: int, sent_ns: int, now_ns: int) -> int:
        """Return the host's time of the start of a sequence that was sent at a time, and its answer
        now."""
        if self._ahead_ns and 1000 * board_us + min(self._ahead_ns) < sent_ns:
            # No sequence begins before it is sent: the board's clock has stood still.
            self._ahead_ns.clear()
        self._ahead_ns.append(now_ns - 1000 * board_us)
        return 1000 * board_us + min(self._ahead_ns)
