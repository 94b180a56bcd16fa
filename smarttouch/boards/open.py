"""Boards by URL: their drivers, the one that keeps sequences in memory, and what is plugged in."""

import contextlib
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from serial.tools import list_ports

from smarttouch.base.errors import BoardError
from smarttouch.base.registry import find_opener, refuse_rest, require_kind
from smarttouch.base.url_options import read_options
from smarttouch.boards.board import Board
from smarttouch.boards.seal import is_foreign, seal_error, seal_fault
from smarttouch.profile import DEFAULT_PROFILE
from smarttouch.profile.device import Output
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence


def make_board(
    url: str, limits: SafetyLimits, output: Output | None = None, **options: Any
) -> Board:
    """Return the driver for a board's URL, not opened yet; its options may stand in the URL, as in
    ``emulator:?books=FOLDER``."""
    opener, rest = _driver(url)
    rest, from_url = read_options(opener, rest, BoardError, but=("output",))
    given = replace(limits)
    board: Board = opener(rest, limits, output, **{**from_url, **options})
    require_kind(board, Board, url, BoardError)
    require_gate(board, limits, given)
    return board


def _of_one_source(found: SafetyLimits, given: SafetyLimits, output: Output | None) -> bool:
    """Return whether limits are those that were given, made narrower for one source."""
    narrower = given.on(output)
    return narrower is not given and found == narrower


def require_gate(board: Board, limits: SafetyLimits, given: SafetyLimits) -> None:
    """Raise BoardError unless a board keeps the limits that its driver was given, unchanged since
    ``given`` was copied, all final methods, and, if a finger may be on it, the machine's clock."""
    fault = seal_fault(board)
    if fault is not None:
        raise fault
    found = board._gate.limits
    # By value too: a driver can change what it was given.
    unchanged = found is limits and found == given
    if not unchanged and not _of_one_source(found, given, board._output):
        raise seal_error(board, "limits", "hand those that it is given to super().__init__")
    # Only without a finger may time be what sequences state.
    if is_foreign(board) and board.on_a_finger and type(board)._time is not Board._time:
        raise seal_error(board, "clock", "leave _time and _clock as they are")


def may_touch_a_finger(url: str) -> bool:
    """Return whether there may be a finger on the board of a URL."""
    return bool(getattr(_driver(url)[0], "on_a_finger", True))


def default_profile(url: str) -> str:
    """Return the name of the shipped profile that goes with a board's URL."""
    return str(getattr(_driver(url)[0], "default_profile", DEFAULT_PROFILE))


def _driver(url: str) -> tuple[Callable[..., Any], str]:
    return find_opener("smarttouch.boards", url, BoardError)


class MemoryBoard(Board):
    """Board without process, line or current, which keeps all ``sequences`` since it was opened:
    ``memory:``."""

    on_a_finger = False

    def __init__(
        self, rest: str, limits: SafetyLimits, output: Output | None = None, **_: Any
    ) -> None:
        super().__init__(
            limits, output, max_current_ma=limits.current_ma, max_slots=0xFFFF, time_to_zero_ms=0.0,
            firmware="memory", recharges=output is None or output.kind == "weighted",
        )  # fmt: skip
        refuse_rest("memory:", rest, BoardError)
        self.sequences: list[ScanSequence] = []

    def _time(self) -> None:
        """Return None: time is what sequences state, as no finger is on this board."""

    def _open(self) -> None:
        self.sequences.clear()

    def _send(self, sequence: ScanSequence, times: int) -> int:
        self.sequences.append(sequence)
        self.acknowledged += 1
        return len(self.sequences)

    def _stop(self) -> None: ...


ETACTILEKIT_PORT = 8888  # UDP port on which eTactileKits answer ``ETK?``


@dataclass(frozen=True)
class SerialPort:
    """A serial port of this machine; it is not opened, so the device behind it is unknown."""

    device: str
    description: str


@dataclass(frozen=True)
class NetworkBoard:
    """An eTactileKit that has answered on the network."""

    url: str
    name: str
    busy: bool


def serial_ports() -> list[SerialPort]:
    """Return the serial ports of the system; none is opened."""
    found = list_ports.comports()
    # Built-in ports without hardware have no description.
    return [
        SerialPort(each.device, each.description)
        for each in sorted(found, key=lambda each: each.device)
        if each.description != "n/a"
    ]


def network_boards(
    wait_s: float = 0.5, address: str = "255.255.255.255", port: int = ETACTILEKIT_PORT
) -> list[NetworkBoard]:
    """Return the eTactileKits that answer a broadcast."""
    found: dict[str, NetworkBoard] = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        # Without a network there is nothing to find.
        with contextlib.suppress(OSError):
            line.sendto(b"ETK?", (address, port))
            deadline = time.monotonic() + wait_s
            while (left := deadline - time.monotonic()) > 0:
                line.settimeout(left)
                board = parse_answer(line.recvfrom(1024)[0])
                if board is not None:
                    found[board.url] = board
    return sorted(found.values(), key=lambda each: each.url)


def parse_answer(data: bytes) -> NetworkBoard | None:
    """Return the board described by an answer, or None if the answer is invalid."""
    fields = data.decode("utf-8", "replace").strip().split(";")
    if fields[0] != "ETK!":
        return None
    answer = dict(each.split("=", 1) for each in fields[1:] if "=" in each)
    port = answer.get("port", "")
    if not answer.get("ip") or not port.isdecimal():
        return None
    # A name from the network must not control the terminal.
    name = "".join(
        each for each in answer.get("name") or answer.get("id", "") if each.isprintable()
    )
    address = "".join(each for each in answer["ip"] if each.isalnum() or each in ".:-")
    return NetworkBoard(
        f"etactilekit:tcp://{address}:{int(port)}", name[:40], answer.get("busy") == "1"
    )
