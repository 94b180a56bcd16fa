"""Emulated devices by URLs, as in ``smarttouch devices emulate "link?electrodes=16"``."""

import math
from collections.abc import Sequence
from contextlib import closing
from functools import partial
from pathlib import Path

from threadpoolctl import threadpool_limits

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import SmartTouchError, choice_of, not_offered, require_within
from smarttouch.base.url_options import options_of, read_options
from smarttouch.base.wire.device_lines import PtyLine, TcpLine
from smarttouch.boards.link.protocol import OUTPUTS
from smarttouch.emulator.etactilekit_firmware import FIRMWARES, ETactileKitFirmware
from smarttouch.emulator.finger_events import EmulatedFinger
from smarttouch.emulator.firmware import DeliveryLog, Firmware
from smarttouch.emulator.kajimoto61_firmware import Kajimoto61Firmware
from smarttouch.emulator.link_firmware import LinkFirmware
from smarttouch.emulator.link_rules import Room
from smarttouch.emulator.server import Orders, Server

BOARDS = {"link": (64, 1, 4096), "kajimoto61": (61, 61, 61), "etactilekit": (32, 1, 255)}
"""Default, smallest and largest number of electrodes of each board."""
SENSORS = {"serial-array": 200.0, "hx711": 80.0, "loadcell": 80.0}
"""Default rate of each sensor, Hz."""
_LARGEST_N = 1e9


def emulate(url: str, advise: bool = False) -> None:
    """Emulate the device of a URL behind a port whose name is printed, until it ends.

    The options of a URL are those of `emulate_board` or `emulate_sensor`. With ``advise``, the
    commands that use the port are printed with it.
    """
    name = url.partition("?")[0]
    if name not in (*BOARDS, *SENSORS):
        raise not_offered("emulator", name, (*BOARDS, *SENSORS))
    device = emulate_board if name in BOARDS else emulate_sensor
    place, options = read_options(device, url, SmartTouchError)
    if place != name:
        known = ", ".join(sorted(options_of(device)))
        raise SmartTouchError(f"{url!r} has an option that {name} has not: choose {known}")
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
    """Emulate a board on skin until Ctrl-C, or for ``linger`` seconds without a host.

    ``output`` and ``ramp_ms``, the least time from zero to full, are of a link board; ``firmware``
    is of an eTactileKit. With ``tcp``, the port is one of the network. Each ``event`` is as in
    `finger_events`, and ``books`` is an existing folder for the delivery log.
    """
    default, least, most = BOARDS[name]
    electrodes = default if electrodes is None else electrodes
    require_within(SmartTouchError, "electrodes", electrodes, least, most)
    require_within(SmartTouchError, "ramp_ms", ramp_ms, 0, 10_000)
    kind = choice_of("output", output, OUTPUTS)
    if firmware is not None and name != "etactilekit":
        message = f"firmware is for etactilekit, and a {name} has only one: leave it out"
        raise SmartTouchError(message)
    firmware = choice_of("firmware", firmware or FIRMWARES[0], FIRMWARES)
    if books is not None and not books.is_dir():
        raise SmartTouchError(f"{books} is not a folder: make it first")
    log, finger = DeliveryLog(electrodes, books), EmulatedFinger(electrodes, event)
    if name == "kajimoto61":
        device: Firmware = Kajimoto61Firmware(log, finger)
    elif name == "etactilekit":
        device = ETactileKitFirmware(log, finger, firmware=firmware)
    else:
        # Kernels of all classes, however many electrodes there are.
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
    """Emulate a sensor as `emulate_board` does a board; ``rate`` is in Hz, and ``force`` in newtons
    on a load cell."""
    from smarttouch.emulator import sensors

    rate_hz = SENSORS[name] if rate is None else rate
    require_within(SmartTouchError, "rate", rate_hz, 0.01, 2000.0)
    require_within(SmartTouchError, "force", force, -_LARGEST_N, _LARGEST_N)
    if name == "serial-array":
        device: Firmware = sensors.SensorArray(rate_hz)
    else:
        device = sensors.EmulatedLoadCell(force, framed=name == "loadcell", rate_hz=rate_hz)
    _serve(name, device, linger, advise, orders=Orders())


_USES = {
    "kajimoto61": "live --board kajimoto61:PORT --force fixed:0.9",  # kits do not measure force
    "etactilekit": "live --board etactilekit:PORT --force fixed:0.9",
    "link": "live --board link:PORT",
    "serial-array": "live serial-array:PORT --force fixed:0.5",
    "hx711": "live --force hx711:PORT --profile P",
    "loadcell": "live --force loadcell:PORT --profile P",
}


def _advice(name: str, port: str) -> str:
    from smarttouch.emulator.sensors import COUNTS_PER_N, ZERO_COUNTS

    more = ""
    if name in ("hx711", "loadcell"):
        more = (
            f" The curve in [force] of the profile P is [{-ZERO_COUNTS / COUNTS_PER_N:g}, "
            f"{1 / COUNTS_PER_N:g}], or smarttouch calibrate force finds it. A line typed here "
            "puts something else on the cell: weight 100 (grams), force 0.5 (newtons)."
        )
    use = _USES[name].replace("PORT", port)
    return f"In another terminal:\n\n  smarttouch {use}\n\nCtrl-C ends this {name}.{more}"


def _serve(
    name: str,
    device: Firmware,
    linger_s: float,
    advise: bool,
    line: type[PtyLine | TcpLine] = PtyLine,
    orders: Orders | None = None,
) -> None:
    require_within(SmartTouchError, "linger", linger_s, 0, math.inf)
    # Circuits and images are small: a second thread would only slow down the host.
    with closing(line()) as opened, threadpool_limits(1):
        server = Server(device, opened, orders)
        server.serve(linger_s, partial(_advice, name) if advise else str)
