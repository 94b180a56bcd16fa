"""Check of what a ``link`` board says that it can do."""

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
    """Return a board's outputs and capabilities; a wrong board has received no more than HELLO.

    Parameters
    ----------
    answer : Message
        Its CAPABILITIES, of any version.
    name : str
        Of its port, for messages.
    electrodes : int
        Number in the profile.
    wanted : Output, optional
        Output section of the profile.
    known : Capabilities, optional
        Those from before the line was lost.
    """
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
    if found.emergency_switch and answer.state & protocol.SWITCH_OPEN:
        raise EmergencyStopError(
            f"the emergency switch of the board at {name} is open: close it, then begin again",
            about="board",
        )
    if known not in (None, found):
        raise OtherDeviceError(
            f"the board at {name} now is another: only HELLO was sent to it", about="board"
        )
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
    return kind, found


def malformed(name: str) -> BoardError:
    """Return the error of a board that answers nonsense."""
    return BoardError(f"the board at {name} answers nonsense: check its firmware", about="board")
