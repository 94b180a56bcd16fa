"""Serial lines and TCP connections by name, with errors a user can act on."""

import contextlib
import os
import select
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import serial
from serial import SerialBase as Port
from serial.tools import list_ports

from smarttouch.base.errors import BoardError, OtherDeviceError, SmartTouchError
from smarttouch.base.posix import HAS_POSIX, fcntl, termios, write_now

__all__ = [
    "LINE_ERRORS", "Port", "UsbIdentity", "identity_of", "open_port", "read_some", "reason",
    "reopen_port", "write_before",
]  # fmt: skip

_MOST_AT_ONCE = 65_536
_PSEUDO = ("/dev/pts/", "/dev/ttys")  # names of pseudo-terminals on Linux and macOS

LINE_ERRORS = (
    OSError, serial.SerialException, termios.error if termios else OSError, TypeError
)  # fmt: skip
"""Exceptions of pyserial when a port vanishes, or is closed by another thread."""


def open_port(
    name: str,
    baudrate: int = 921600,
    timeout_s: float = 0.05,
    error: type[SmartTouchError] = BoardError,
) -> Port:
    """Open a device, ``tcp://HOST:PORT``, or any URL that pyserial knows.

    Both modem lines are held inactive: on many boards they are wired to reset.

    Raises
    ------
    SmartTouchError
        Of the class ``error``, saying what to do about it.
    """
    tcp = name.startswith("tcp://")
    url = name.replace("tcp://", "socket://", 1) if tcp else name
    try:
        if tcp and urlsplit(name).port is None:
            raise ValueError("it names no port, give tcp://HOST:PORT (an eTactileKit's is 8080)")
        port: Port = serial.serial_for_url(url, do_not_open=True, baudrate=baudrate)
        port.timeout, port.write_timeout, port.exclusive = timeout_s, 0.5, True
        port.dtr = port.rts = False
        port.open()
        if HAS_POSIX and _is_device(port):
            # Keeps out programs that ask for no lock, though not those of root.
            fcntl.ioctl(port.fileno(), termios.TIOCEXCL)
        if url.startswith("socket://"):
            # Short commands must not wait for earlier ones to be acknowledged.
            port._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    except (*LINE_ERRORS, ValueError, AttributeError) as failure:
        raise error(f"cannot open {name}: {_advice(failure)}") from None
    return port


def _is_device(port: Port) -> bool:
    """Return whether a port is a device; a pseudo-terminal would stay exclusive when closed."""
    try:
        return not os.ttyname(port.fileno()).startswith(_PSEUDO)
    except (OSError, AttributeError):
        return False


@dataclass(frozen=True)
class UsbIdentity:
    """USB identity of one device, and its port."""

    vendor: int
    product: int
    serial_number: str
    interface: str


def identity_of(port: Port) -> UsbIdentity | None:
    """Return the USB identity of an open port; None for another line, or no serial number."""
    if not isinstance(port, serial.Serial):
        return None
    try:
        return _usb_identity(os.ttyname(port.fileno()) if HAS_POSIX else port.name)
    except LINE_ERRORS:
        return None


def device_of(name: str) -> str:
    """Return the identity of the device at a port: its USB serial number, else the port's name."""
    with contextlib.suppress(*LINE_ERRORS):
        if usb := _usb_identity(name):
            return f"USB {usb.vendor:04x}:{usb.product:04x} {usb.serial_number}"
    return os.path.realpath(name) if Path(name).exists() else name


def _usb_identity(name: str) -> UsbIdentity | None:
    device = os.path.realpath(name)
    for port in list_ports.comports():
        if port.device in (name, device) and port.vid is not None and port.serial_number:
            _, _, interface = (port.location or "").partition(":")
            return UsbIdentity(port.vid, port.pid, port.serial_number, interface)
    return None


def reopen_port(
    name: str,
    within_s: float,
    identity: UsbIdentity | None,
    pause: Callable[[float], None] = time.sleep,
    baudrate: int = 921600,
) -> Port:
    """Reopen a lost port as soon as it is back with the same identity, and write nothing; raise
    OtherDeviceError if only another device came back. ``pause`` waits a number of seconds; what it
    raises ends the waiting."""
    deadline = time.monotonic() + within_s
    while True:
        try:
            # By name first, as opening another device may reset it; then by the open port.
            if Path(name).exists() and _usb_identity(name) != identity:
                raise _other(name)
            port = open_port(name, baudrate)
            if identity_of(port) == identity:
                return port
            port.close()
            raise _other(name)
        except BoardError:
            if time.monotonic() > deadline:
                raise
            pause(0.02)


def _descriptor(port: Port) -> int | None:
    """Return the descriptor of a port; None on Windows, and for a line of pyserial's own."""
    try:
        return int(port.fileno()) if HAS_POSIX else None
    except (AttributeError, OSError):
        return None


def read_some(port: Port) -> bytes | None:
    """Return what has come, after a wait for the first byte for the port's timeout; None if another
    program has taken it."""
    if (number := _descriptor(port)) is None:
        return bytes(port.read(port.in_waiting or 1))
    if not select.select([number], [], [], port.timeout)[0]:
        return b""
    with contextlib.suppress(BlockingIOError):
        if data := os.read(number, _MOST_AT_ONCE):
            return data
        if not isinstance(port, serial.Serial) or _is_hung_up(number):
            raise serial.SerialException("it is gone")
    return None


def _is_hung_up(number: int) -> bool:
    poll = select.poll()
    poll.register(number, 0)  # for what is told without asking
    return bool(poll.poll(0))


def write_before(
    port: Port, data: bytes, latest_ns: int, now_ns: Callable[[], int], within_s: float = 0.5
) -> bool:
    """Write bytes unless it is too late for the first of them; return whether they were written.
    Nothing runs between the last look at the clock and the system's write, so only a process that
    is suspended just there writes late. A line that accepts nothing fails after ``within_s``."""
    number, sent = _descriptor(port), 0
    if number is not None and os.get_blocking(number):
        os.set_blocking(number, False)
    while not sent:
        if now_ns() > latest_ns:
            return False
        if number is None:
            break
        try:
            sent = write_now(number, data)
        except (BlockingIOError, InterruptedError):
            if not select.select([], [number], [], within_s)[1]:
                raise serial.SerialTimeoutException("it takes no bytes") from None
    if sent < len(data):
        port.write(data[sent:])
    return True


def _other(name: str) -> OtherDeviceError:
    return OtherDeviceError(f"by its USB numbers another device is at {name} now: nothing was sent")


def reason(error: Exception) -> str:
    """Return the system's text of an error on a line."""
    if "multiple access" in str(error):
        return "it is gone, or another program reads from it: close that"
    number = getattr(error, "errno", None)
    return os.strerror(number) if number else (str(error) or type(error).__name__)


def _advice(error: Exception) -> str:
    text = str(error)
    if "lock" in text or "busy" in text.lower():
        return "it is in use by another program: close that first"
    if "ioctl" in text:
        return "it is no serial port: check the name"
    if "refused" in text:
        return "nobody listens there: check that it is on, its address and port"
    if "No such file" in text or getattr(error, "errno", None) == 2:
        return (
            "there is no such port: check the cable and the name. BRLTTY may have claimed a board "
            "with a CH340, CP210x or FTDI chip: let it leave this one (docs/install.md)"
        )
    if "ermission" in text:
        return "permission denied: add yourself to the group of the port (often dialout)"
    return text
