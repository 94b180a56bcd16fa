"""Discovery of ports and boards; nothing is sent to unknown devices."""

import contextlib
import socket
import time
from dataclasses import dataclass

from serial.tools import list_ports

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
        # Without a network there is nobody to find.
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
    # Whatever a stranger calls itself must not steer the terminal.
    name = "".join(
        each for each in answer.get("name") or answer.get("id", "") if each.isprintable()
    )
    address = "".join(each for each in answer["ip"] if each.isalnum() or each in ".:-")
    return NetworkBoard(
        f"etactilekit:tcp://{address}:{int(port)}", name[:40], answer.get("busy") == "1"
    )
