"""Serial ports and TCP connections by name, with error messages that say what to do."""

import contextlib
import ctypes
import errno
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

from smarttouch.base import posix
from smarttouch.base.errors import BoardError, OtherDeviceError, SmartTouchError
from smarttouch.base.posix import HAS_POSIX, fcntl, termios

__all__ = [
    "LINE_ERRORS", "Port", "UsbIdentity", "identity_of", "open_port", "read_some", "reason",
    "reopen_port", "write_before",
]  # fmt: skip

_MOST_AT_ONCE = 65_536
_PSEUDO = ("/dev/pts/", "/dev/ttys")  # names of pseudo-terminals on Linux and macOS

LINE_ERRORS = (
    OSError, serial.SerialException, termios.error if termios else OSError, TypeError
)  # fmt: skip
"""Exceptions that pyserial raises when a port disappears or another thread closes it."""


def open_port(
    name: str,
    baudrate: int = 921600,
    timeout_s: float = 0.05,
    error: type[SmartTouchError] = BoardError,
) -> Port:
    """Open a device, ``tcp://HOST:PORT``, or a URL of pyserial.

    RTS and DTR stay inactive: on many boards they cause a reset.

    Raises
    ------
    SmartTouchError
        If the port cannot be opened. The error has the class ``error`` and says what to do.
    """
    tcp = name.startswith("tcp://")
    url = name.replace("tcp://", "socket://", 1) if tcp else name
    try:
        if tcp and urlsplit(name).port is None:
            raise ValueError("the port is missing, give tcp://HOST:PORT (8080 for an eTactileKit)")
        port: Port = serial.serial_for_url(url, do_not_open=True, baudrate=baudrate)
        port.timeout, port.write_timeout, port.exclusive = timeout_s, 0.5, True
        port.dtr = port.rts = False
        port.open()
        if HAS_POSIX and _is_device(port):
            # Also keep out programs that ignore pyserial's lock. Root's programs can still open it.
            fcntl.ioctl(port.fileno(), termios.TIOCEXCL)
        if url.startswith("socket://"):
            # Without TCP_NODELAY, short commands wait until the peer acknowledges earlier ones.
            port._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    except (*LINE_ERRORS, ValueError, AttributeError) as failure:
        raise error(f"cannot open {name}: {_advice(failure)}") from None
    return port


def _is_device(port: Port) -> bool:
    """Return False for a pseudo-terminal: it would remain locked after the port is closed."""
    try:
        return not os.ttyname(port.fileno()).startswith(_PSEUDO)
    except (OSError, AttributeError):
        return False


@dataclass(frozen=True)
class UsbIdentity:
    """USB identity of the device at a port, and the USB interface of the port."""

    vendor: int
    product: int
    serial_number: str
    interface: str


def identity_of(port: Port) -> UsbIdentity | None:
    """Return the USB identity of an open port; None if it has no USB serial number."""
    if not isinstance(port, serial.Serial):
        return None
    try:
        return _usb_identity(os.ttyname(port.fileno()) if HAS_POSIX else port.name)
    except LINE_ERRORS:
        return None


def device_of(name: str) -> str:
    """Return USB IDs and serial number of the device at a port; without USB, the port's name."""
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
    """Wait up to ``within_s`` until a lost port is back with the same USB identity, and open it
    without writing. Raises OtherDeviceError if another device has the port. ``pause`` sleeps
    between tries; an exception that it raises ends the wait."""
    deadline = time.monotonic() + within_s
    while True:
        try:
            # Opening could reset another device, so first check which device has this name. Another
            # device may take the port between check and opening, so check the open port as well.
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
    """Return the file descriptor of a port; None on Windows, and for URLs of pyserial."""
    try:
        return int(port.fileno()) if HAS_POSIX else None
    except (AttributeError, OSError):
        return None


def read_some(port: Port) -> bytes | None:
    """Return the received bytes. Wait for the first byte, but not longer than the port's timeout.
    Return None if another program has read the bytes."""
    if (number := _descriptor(port)) is None:
        return bytes(port.read(port.in_waiting or 1))
    if not select.select([number], [], [], port.timeout)[0]:
        return b""
    with contextlib.suppress(BlockingIOError):
        if data := os.read(number, _MOST_AT_ONCE):
            return data
        if not isinstance(port, serial.Serial) or _is_hung_up(number):
            raise serial.SerialException("it was disconnected")
    return None


def _is_hung_up(number: int) -> bool:
    poll = select.poll()
    poll.register(number, 0)  # hang-ups are always reported
    return bool(poll.poll(0))


def write_before(
    port: Port, data: bytes, latest_ns: int, now_ns: Callable[[], int], within_s: float = 0.5
) -> bool:
    """Write bytes if the time is at most ``latest_ns``; return whether they were written. Nothing
    else happens between the check of the time and the write. Raises an error if the port accepts no
    bytes for ``within_s``."""
    number, sent = _descriptor(port), 0
    if number is not None and os.get_blocking(number):
        os.set_blocking(number, False)
    while not sent:
        if now_ns() > latest_ns:
            return False
        if number is None:
            break
        if sent := max(0, posix.write_now(number, data, len(data))):
            continue
        if (failure := ctypes.get_errno()) not in (errno.EAGAIN, errno.EINTR):
            raise OSError(failure, os.strerror(failure))
        if not select.select([], [number], [], within_s)[1]:
            raise serial.SerialTimeoutException("the device accepts no bytes")
    if sent < len(data):
        port.write(data[sent:])
    return True


def _other(name: str) -> OtherDeviceError:
    return OtherDeviceError(f"{name} is another USB device now: connect the device of this run")


def reason(error: Exception) -> str:
    """Return the cause of a port's error, as text."""
    if "multiple access" in str(error):
        return "it is disconnected, or another program reads from it: close that program"
    number = getattr(error, "errno", None)
    return os.strerror(number) if number else (str(error) or type(error).__name__)


def _advice(error: Exception) -> str:
    text = str(error)
    if "lock" in text or "busy" in text.lower():
        return "another program uses it: close that program first"
    if "ioctl" in text:
        return "it is not a serial port: check the name"
    if "refused" in text:
        return "nothing listens at this address: check address and port, and switch the device on"
    if "No such file" in text or getattr(error, "errno", None) == 2:
        return (
            "there is no such port: check the cable and the name. BRLTTY may have claimed a board "
            "with a CH340, CP210x or FTDI chip: make BRLTTY ignore it (docs/install.md)"
        )
    if "ermission" in text:
        return "permission denied: join the group of the port (often dialout), then log in again"
    return text
