"""Check of the capabilities that a ``link`` board reports."""

from smarttouch.boards import link_protocol as protocol
from smarttouch.boards.capabilities import Capabilities
from smarttouch.boards.link_protocol import Feature
from smarttouch.boards.link_session import Message
from smarttouch.errors import BoardError, EmergencyStopError, OtherDeviceError
from smarttouch.profile.device import Output


def accepted(
    answer: Message,
    name: str,
    electrodes: int,
    wanted: Output | None,
    known: Capabilities | None,
) -> tuple[protocol.Output, Capabilities]:
    """Return a board's outputs and capabilities, checked against the profile and, if known, those
    from before the line was lost. A wrong board has received no more than HELLO."""
    kind, found = _offered(answer, name)
    _require_ready(answer, name, found, known)
    _require_fit(name, found, electrodes, wanted)
    return kind, found


def _offered(answer: Message, name: str) -> tuple[protocol.Output, Capabilities]:
    """Return the outputs and capabilities in a CAPABILITIES of any version."""
    if answer.version != protocol.VERSION:
        raise BoardError(
            f"the board at {name} speaks link version {answer.version}, this "
            f"program {protocol.VERSION}: bring both to the same",
            about="version",
        )
    head = protocol.CAPABILITIES.size
    if len(answer.payload) < head + protocol.KEEPING.size:
        raise malformed(name)
    outputs, output, features, current_ua, slots, zero_ms, volts = (
        protocol.CAPABILITIES.unpack_from(answer.payload)
    )
    if output >= len(protocol.OUTPUTS):
        raise BoardError(
            f"the board at {name} has outputs of unknown kind {output}", about="output.kind"
        )
    kind = protocol.OUTPUTS[output]
    room, packet, kernels = protocol.KEEPING.unpack_from(answer.payload, head)
    head += protocol.KEEPING.size
    if not features & Feature.KERNELS:
        room = kernels = 0
    found = Capabilities(
        electrodes=outputs,
        output=kind,
        max_current_ma=current_ua / 1000,
        max_slots=slots,
        time_to_zero_ms=zero_ms,
        firmware=answer.payload[head:].decode("utf-8", "replace"),
        measures=bool(features & Feature.VOLTAGE),
        force=bool(features & Feature.FORCE),
        compliance_v=float(volts) or None,
        recharges=bool(features & Feature.RECHARGE),
        emergency_switch=bool(features & Feature.EMERGENCY),
        protocol=f"link {protocol.VERSION}",
        kernel_bytes=room,
        most_kernels=kernels,
        packet_bytes=packet,
    )
    return kind, found


def _require_ready(
    answer: Message, name: str, found: Capabilities, known: Capabilities | None
) -> None:
    """Raise if the emergency switch is open, or this is another board than before."""
    if found.emergency_switch and answer.state & protocol.SWITCH_OPEN:
        raise EmergencyStopError(
            f"the emergency switch of the board at {name} is open: close it, then begin again",
            about="board",
        )
    if known not in (None, found):
        raise OtherDeviceError(
            f"the board at {name} now is another: only HELLO was sent to it", about="board"
        )


def _require_fit(name: str, found: Capabilities, electrodes: int, wanted: Output | None) -> None:
    """Raise if a board does not have the electrodes and outputs of the profile."""
    outputs, kind = found.electrodes, found.output
    if outputs != electrodes:
        raise BoardError(
            f"the board at {name} has {outputs} electrodes, the profile "
            f"{electrodes}: use the profile of this board",
            about="electrodes",
        )
    if wanted is not None and wanted.kind != kind:
        raise BoardError(
            f"the board at {name} is {kind}, the profile needs "
            f"{wanted.kind}: use the profile of this board",
            about="output.kind",
        )


def malformed(name: str) -> BoardError:
    """Return the error of a board that answers nonsense."""
    return BoardError(f"the board at {name} answers nonsense: check its firmware", about="board")
