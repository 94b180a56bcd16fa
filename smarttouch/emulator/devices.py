"""Functions that emulate the board or sensor that a URL names, as in ``smarttouch devices emulate
"link?electrodes=16"``, and the server that connects an emulated device to a port."""

import math
import signal
from abc import abstractmethod
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from types import FrameType

import numpy as np
from threadpoolctl import threadpool_limits

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import SmartTouchError, choice_of, require_within
from smarttouch.base.files import file_at
from smarttouch.base.stopping import SIGNALS
from smarttouch.base.urls import options_of, read_options
from smarttouch.boards.link import OUTPUTS
from smarttouch.emulator.device_lines import PtyLine, Replay, TcpLine
from smarttouch.emulator.etactilekit_firmware import FIRMWARES, ETactileKitFirmware
from smarttouch.emulator.firmware_base import DeliveryLog, DeviceClock, Firmware
from smarttouch.emulator.kajimoto61_firmware import Kajimoto61Firmware
from smarttouch.emulator.link_board import LinkFirmware
from smarttouch.emulator.link_board_limits import Room
from smarttouch.emulator.skin import EmulatedFinger

BOARDS = {"link": (64, 1, 4096), "kajimoto61": (61, 61, 61), "etactilekit": (32, 1, 255)}
"""Number of electrodes of each kind of board: default, minimum and maximum."""
SENSORS = {"serial-array": 200.0, "hx711": 80.0, "loadcell": 80.0}
"""Default number of measurements per second of each kind of sensor, Hz."""
COUNTS_PER_N, ZERO_COUNTS = 50_000.0, 80_000.0  # load cell: counts per newton, and reading at 0 N
_NOISE_COUNTS, _LARGEST_RAW = 60.0, 2**23 - 1
_LONGEST_WAIT_S = 0.02
_BEHIND_NS = 100_000_000  # a sensor that is late by more than this skips measurements
_BLOCK, _SIDE, _PATTERN_SIDE = 4, 64, 1024
_PATTERN_PIXELS_S = 40
_FIRST_HOST_S = 8.0  # wait for the first host, in addition to ``linger``
_WRITE_EVERY_NS = 50_000_000
_FULL_WAIT_S = 0.0005  # pause between attempts to write the rest of a message


def emulate(url: str, advise: bool = False) -> None:
    """Emulate the device that a URL names, or replay a recorded device from a file.

    Print the name of the port; with ``advise``, print instructions for an emulated device. Options
    in the URL are parameters of `emulate_board` or `emulate_sensor`."""
    if (recording := file_at(url)) is not None:
        with closing(Replay(recording)) as replay:
            print(replay.name, flush=True)
            replay.serve()
        return
    name = choice_of("emulator", url.partition("?")[0], (*BOARDS, *SENSORS))
    device = emulate_board if name in BOARDS else emulate_sensor
    address, options = read_options(device, url, SmartTouchError)
    if address.lower() != name:
        known = ", ".join(sorted(options_of(device)))
        raise SmartTouchError(f"{url!r} has an unknown option: the options of {name} are {known}")
    device(name, advise, **options)


def emulate_board(
    name: str,
    advise: bool,
    electrodes: int | None = None,
    output: str = "weighted",
    firmware: str | None = None,
    tcp: bool = False,
    ramp_ms: int = 500,
    event: Sequence[str] = (),
    books: Path | None = None,
    linger: float = math.inf,
) -> None:
    """Emulate a board on a model of the skin.

    End when no host has been connected for ``linger`` seconds; without ``linger``, after Ctrl-C.
    ``output`` and ``ramp_ms``, the shortest time from zero to full intensity, apply to link boards
    only; ``firmware`` applies to the eTactileKit only. With ``tcp``, the port is a TCP port. `skin`
    describes the text of an ``event``. ``books`` is an existing folder for the delivery log."""
    default, least, largest = BOARDS[name]
    electrodes = default if electrodes is None else electrodes
    require_within(SmartTouchError, "electrodes", electrodes, least, largest)
    require_within(SmartTouchError, "ramp_ms", ramp_ms, 0, 10_000)
    kind = choice_of("output", output, OUTPUTS)
    if firmware is not None and name != "etactilekit":
        message = f"firmware={firmware} is for etactilekit, not for {name}: leave the option out"
        raise SmartTouchError(message)
    firmware = choice_of("firmware", firmware or FIRMWARES[0], FIRMWARES)
    if books is not None and not books.is_dir():
        raise SmartTouchError(f"{books} is not a folder: create it first")
    log, finger = DeliveryLog(electrodes, books), EmulatedFinger(electrodes, event)
    if name == "kajimoto61":
        device: Firmware = Kajimoto61Firmware(log, finger)
    elif name == "etactilekit":
        device = ETactileKitFirmware(log, finger, firmware=firmware)
    else:
        # Provide space for one kernel per class and electrode.
        room = Room(kernels=max(Room.kernels, len(Afferent) * electrodes))
        device = LinkFirmware(kind, log, finger, ramp_ms=ramp_ms, room=room)
    _serve(name, device, linger, advise, TcpLine if tcp else PtyLine)


def emulate_sensor(
    name: str,
    advise: bool,
    rate: float | None = None,
    force: float = 0.5,
    linger: float = math.inf,
) -> None:
    """Emulate a sensor until no host has been connected for ``linger`` seconds, or until Ctrl-C.
    ``rate`` is in Hz; ``force``, N, acts on an emulated load cell."""
    rate_hz = SENSORS[name] if rate is None else rate
    require_within(SmartTouchError, "rate", rate_hz, 0.01, 2000.0)
    require_within(SmartTouchError, "force", force, -1e9, 1e9)
    device: Firmware = SensorArray(rate_hz)
    if name != "serial-array":
        device = EmulatedLoadCell(force, framed=name == "loadcell", rate_hz=rate_hz)
    _serve(name, device, linger, advise)


def _serve(
    name: str,
    device: Firmware,
    linger_s: float,
    advise: bool,
    line: type[PtyLine | TcpLine] = PtyLine,
) -> None:
    require_within(SmartTouchError, "linger", linger_s, 0, math.inf)
    # The arrays are small: more BLAS threads would save no time, and would slow down the host.
    with closing(line()) as opened, threadpool_limits(1):
        url = f"{name}:{opened.name}"
        use = f"live --board {url} --force fixed:0.9" if name in BOARDS else f"devices show {url}"
        instructions = f"In another terminal:\n\n  smarttouch {use}\n\nCtrl-C ends it."
        Server(device, opened).serve(linger_s, instructions if advise else "")


class Server:
    """Server that connects the firmware of a device to one host after another."""

    def __init__(self, firmware: Firmware, line: PtyLine | TcpLine) -> None:
        self._firmware, self._line = firmware, line
        self._hosted = False
        self._waiting = b""  # bytes that the line has not accepted yet

    def serve(self, linger_s: float, instructions: str = "") -> None:
        """Print ``instructions``, or the port's name if they are empty. Run until SIGTERM, or until
        no host has been connected for ``linger_s``.

        If ``linger_s`` is infinite, Ctrl-C ends the device. Otherwise Ctrl-C is for the host: the
        device ignores Ctrl-C while a host is connected. After SIGHUP, the device ends as soon as no
        host is connected."""
        ended, host_ns = False, _FIRST_HOST_S * 1e9

        def end(number: int, _frame: FrameType | None) -> None:
            nonlocal ended, linger_s, host_ns
            if number not in (signal.SIGTERM, signal.SIGINT):
                linger_s = host_ns = 0
            else:
                ended |= number == signal.SIGTERM or math.isinf(linger_s) or not self._hosted

        for number in SIGNALS if math.isfinite(linger_s) else (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, end)
        books = self._firmware.books
        books.write()
        # Print the port's name after setting the handlers: its reader may send a signal at once.
        print(instructions or self._line.name, flush=True)
        clock = DeviceClock(self._firmware.longest_step_ns)
        written_ns = 0
        while not ended:
            data = self._line.read(_FULL_WAIT_S if self._waiting else self._firmware.wait_s(clock))
            now_ns = clock.now_ns()
            books.stood_still_ms = clock.stood_still_ns / 1e6
            self.step(data, now_ns)
            if self._hosted:
                host_ns = now_ns
            elif now_ns > host_ns + linger_s * 1e9:
                break
            if now_ns - written_ns > _WRITE_EVERY_NS:
                books.write()
                written_ns = now_ns
        if ended:
            self._firmware.zero("signal", clock.now_ns())
        books.write()

    def step(self, data: bytes | None, now_ns: int) -> None:
        """Pass ``data``, the bytes from the host, to the firmware, and send the firmware's answers.
        ``data`` is None if no host is connected."""
        firmware, had_host = self._firmware, self._hosted
        self._hosted = data is not None
        if data is None:
            self._waiting = b""
            if had_host:
                firmware.hang_up(now_ns)
                firmware.books.write()
            firmware.idle(now_ns)
            return
        self._push()
        message = firmware.feed(data, now_ns) if data else firmware.advance(now_ns)
        # If too many bytes wait, drop the message as a whole, not a part of it.
        if len(self._waiting) < firmware.backlog:
            self._waiting += message
            self._push()

    def _push(self) -> None:
        if self._waiting:
            self._waiting = self._line.write(self._waiting)


class SensorFirmware(Firmware):
    """Base class of sensors, which send measurements at fixed times on their clock."""

    # Never stop the clock of a sensor, because hosts compare it with their own clock.
    longest_step_ns: int = 2**63
    backlog = 1

    def __init__(self, rate_hz: float) -> None:
        self.books = DeliveryLog(0)
        self._period_ns = 1e9 / rate_hz
        self._start_ns: int | None = None
        self._next_ns = 0.0
        self._number = 0

    def wait_s(self, clock: DeviceClock) -> float:
        left_s = (self._next_ns - clock.now_ns()) / 1e9
        return min(max(left_s, 0.0), _LONGEST_WAIT_S)

    def idle(self, now_ns: int) -> None:
        self._next_ns = now_ns + self._period_ns

    def advance(self, now_ns: int) -> bytes:
        if self._start_ns is None:
            self._start_ns = self._next_ns = now_ns
        if now_ns < self._next_ns:
            return b""
        if now_ns - self._next_ns > _BEHIND_NS:
            self._next_ns = now_ns
        self._next_ns += self._period_ns
        self._number += 1
        return self.packet(self._number - 1, (now_ns - self._start_ns) / 1e9)

    @abstractmethod
    def packet(self, number: int, time_s: float) -> bytes:
        """Return the message with measurement ``number``, taken ``time_s`` after the first one."""


class SensorArray(SensorFirmware):
    """Sensor array of 64 x 64 pixels that sees random blocks moving from right to left."""

    def __init__(self, rate_hz: float) -> None:
        from smarttouch.sources.serial_sensors import encode_frame

        super().__init__(rate_hz)
        self._encode = encode_frame
        coarse = np.random.default_rng(0).integers(0, 2, (_SIDE // _BLOCK, _PATTERN_SIDE // _BLOCK))
        blocks = np.kron(coarse, np.ones((_BLOCK, _BLOCK)))
        self._pattern = np.where(blocks, 220, 40).astype(np.uint8)

    def packet(self, number: int, time_s: float) -> bytes:
        start = int(time_s * _PATTERN_PIXELS_S) % (_PATTERN_SIDE - _SIDE)
        image = self._pattern[:, start : start + _SIDE]
        return self._encode(number, round(time_s * 1e6), image)


class EmulatedLoadCell(SensorFirmware):
    """Load cell with its A/D converter under a constant force, N. It sends lines of text like an
    HX711 sketch, or FORCE packets if ``framed``."""

    def __init__(self, force_n: float, framed: bool = False, rate_hz: float = 80.0) -> None:
        from smarttouch.sources.serial_sensors import encode_force

        super().__init__(rate_hz)
        self._encode = encode_force
        self.force_n: float = force_n
        self._framed = framed
        self._random = np.random.default_rng(0)

    def packet(self, number: int, time_s: float) -> bytes:
        noise = _NOISE_COUNTS * self._random.standard_normal()
        counts = round(ZERO_COUNTS + COUNTS_PER_N * self.force_n + noise)
        reading = min(max(counts, -_LARGEST_RAW - 1), _LARGEST_RAW)
        if self._framed:
            return self._encode(number, round(time_s * 1e6), reading)
        return f"HX711 reading: {reading}\r\n".encode()
