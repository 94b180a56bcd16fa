"""Handshake with a ``link`` board: its offer checked, its limits and kernels set."""

from collections.abc import Callable
from typing import Any, Protocol

from smarttouch.base.errors import (
    BoardError,
    EmergencyStopError,
    KernelTableError,
    LineLostError,
    OtherDeviceError,
)
from smarttouch.boards.link import protocol as protocol
from smarttouch.boards.link.protocol import (
    NOTHING,
    Feature,
    HostSession,
    Message,
    MessageKind,
    Rule,
)
from smarttouch.boards.link.sequence_encoding import KernelImage, encode_limits
from smarttouch.boards.reports import Capabilities
from smarttouch.profile.device import Output
from smarttouch.stimulation.safety_limits import SafetyLimits


def accepted(
    answer: Message, name: str, electrodes: int, wanted: Output | None, known: Capabilities | None
) -> Capabilities:
    """Return a board's capabilities, checked against the profile and, if known, those
    from before the line was lost. A wrong board has received no more than HELLO."""
    found = _offered(answer, name)
    _require_ready(answer, name, found, known)
    _require_fit(name, found, electrodes, wanted)
    return found


def _offered(answer: Message, name: str) -> Capabilities:
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
        emergency_switch=bool(features & Feature.EMERGENCY), protocol=f"link {protocol.VERSION}",
        kernel_bytes=room, most_kernels=kernels, packet_bytes=packet,
    )  # fmt: skip


def _require_ready(
    answer: Message, name: str, found: Capabilities, known: Capabilities | None
) -> None:
    """Raise if the emergency switch is open, or this is another board than before."""
    if found.emergency_switch and answer.state & protocol.SWITCH_OPEN:
        raise EmergencyStopError(
            f"the emergency switch of the board at {name} is open: close it, then begin again"
        )
    if known not in (None, found):
        raise OtherDeviceError(f"the board at {name} now is another: only HELLO was sent to it")


def _require_fit(name: str, found: Capabilities, electrodes: int, wanted: Output | None) -> None:
    """Raise if a board does not have the electrodes and outputs of the profile."""
    outputs, kind = found.electrodes, found.output
    if outputs != electrodes:
        raise BoardError(
            f"the board at {name} has {outputs} electrodes, the profile "
            f"{electrodes}: use the profile of this board"
        )
    if wanted is not None and wanted.kind != kind:
        raise BoardError(
            f"the board at {name} is {kind}, the profile needs "
            f"{wanted.kind}: use the profile of this board"
        )


def malformed(name: str) -> BoardError:
    """Return the error of a board that gives invalid answers."""
    return BoardError(f"the board at {name} gives invalid answers: check its firmware")


OVERHEAD = protocol.WHOLE_HEAD_BYTES + 4  # bytes of a packet beside its payload
_PIECE = 1024  # bytes of kernels at once: nothing else can pass while they do
_IDLE = 3  # times that nothing new may have been kept


class Packets(Protocol):
    """Packets to and from a board, which answers queries."""

    session: HostSession

    @property
    def name(self) -> str: ...

    def ask(self, question: MessageKind, payload: bytes = b"") -> Message:
        """Return the answer; raise BoardError if there is none."""
        ...


def give_limits(line: Packets, limits: SafetyLimits) -> None:
    if line.ask(MessageKind.LIMITS, encode_limits(limits)).payload != b"\1":
        raise malformed(line.name)


def give_kernels(
    line: Packets, image: KernelImage, most_bytes: int, go_on: Callable[[], None]
) -> None:
    """Give a board its kernels, in packets of at most ``most_bytes``; what it keeps already is not
    sent again. ``go_on`` raises if the board is to be stopped; one that keeps nothing is lost."""
    piece = min(_PIECE, most_bytes - OVERHEAD - protocol.KERNELS.size)
    at, most, data, idle = 0, 0, b"", 0
    while idle < _IDLE:
        go_on()
        head = protocol.KERNELS.pack(image.identity, len(image.data), at)
        answer = line.ask(MessageKind.KERNELS, head + data).payload
        if len(answer) != protocol.KEPT.size:
            raise malformed(line.name)
        identity, kept, whole, proof = protocol.KEPT.unpack(answer)
        if identity == image.identity and whole:
            if proof == image.proof(line.session.number):
                return
            raise KernelTableError(f"the board at {line.name} holds other kernels than those sent")
        # The first query carries no kernels: its answer shows where to begin.
        kept = kept if identity == image.identity and kept < len(image.data) else 0
        idle = 0 if kept > most else idle + 1
        most = max(most, kept)
        at, data = kept, image.data[kept : kept + piece]
    # Its session may have ended, as after 100 ms in which the host was held up.
    raise LineLostError(
        f"the board at {line.name} does not keep the kernels that it is sent: check its firmware"
    )


def account_of(answer: Message, name: str) -> tuple[Any, ...]:
    """Return a REPORT: counts, mA and µC, in the order of `protocol.REPORT`."""
    if len(answer.payload) != protocol.REPORT.size:
        raise malformed(name)
    fields = protocol.REPORT.unpack(answer.payload)
    strongest_ua, charge_pc, net_pc = fields[4:7]
    return (*fields[:4], strongest_ua / 1e3, charge_pc / 1e6, net_pc / 1e6, *fields[7:])


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
