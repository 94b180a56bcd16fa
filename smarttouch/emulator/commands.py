"""The commands that emulate a board or a sensor, with all their options."""

import json
import math
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from smarttouch.base.command_options import argument, option
from smarttouch.base.errors import SmartTouchError, not_offered, require_within
from smarttouch.base.files import require_folder, write_bytes
from smarttouch.base.wire.device_lines import PtyLine, TcpLine

if TYPE_CHECKING:
    from smarttouch.boards.link.protocol import Output
    from smarttouch.emulator.finger_events import EmulatedFinger
    from smarttouch.emulator.firmware import DeliveryLog, Firmware
    from smarttouch.emulator.sensors import Look
    from smarttouch.emulator.server import LineStatistics
    from smarttouch.profile import Profile

BOARDS = {"link": 64, "kajimoto61": 61, "etactilekit": 32}
"""Usual number of electrodes of each board."""
_MOST_ELECTRODES = {"link": 4096, "kajimoto61": 61, "etactilekit": 255}
SENSORS = {"serial-array": 200.0, "hx711": 80.0, "loadcell": 80.0}
_RATES_HZ = (0.01, 2000.0)
_COMPLIANCES_V = (1.0, 10_000.0)
_LARGEST = 1e9

_Linger = Annotated[float, option("How long to live on without a host.", "S", "--linger")]
_Parent = Annotated[int | None, option("Process that it is not to outlive.", "PID", "--parent")]
_PortOnly = Annotated[
    bool, option("Print the name of the port and no advice.", None, "--port-only")
]


def emulate_board(
    name: Annotated[str, argument("link, kajimoto61 or etactilekit", "NAME")],
    electrodes: Annotated[int | None, option("Of a link board or an eTactileKit.", "N")] = None,
    output: Annotated[
        str, option("Of a link board: weighted, three-state, ...", "KIND")
    ] = "weighted",
    firmware: Annotated[str | None, option("Of an eTactileKit: 71adee2 or newest.", "NAME")] = None,
    tcp: Annotated[bool, option("Serve TCP instead of a serial port.", None, "--tcp")] = False,
    discovery_port: Annotated[
        int | None, option("With --tcp: UDP port to answer ETK? on.", "N")
    ] = None,
    ramp_ms: Annotated[int, option("Least time to full of a link board; 0 for tests.", "N")] = 500,
    event: Annotated[
        list[str] | None,
        option(
            "What happens to the finger: '2 lift', '3 touch', '0 force 0.6', '0 drift 12 4 "
            "60', '5 peel 7 0.3', '5 open 7', '5 short 7', '5 heal 7', '6 emergency', '7 "
            "release'",
            "TEXT",
        ),
    ] = None,
    compliance: Annotated[float | None, option("Most volts of its sources.", "V")] = None,
    books: Annotated[Path | None, option("For state.json and delivered.bin.", "FOLDER")] = None,
    linger: _Linger = math.inf,
    parent: _Parent = None,
    port_only: _PortOnly = False,
) -> None:
    """Emulate a board on skin, behind a port whose name is printed, until Ctrl-C."""
    from smarttouch.boards.link.protocol import OUTPUTS
    from smarttouch.emulator.finger_events import EmulatedFinger
    from smarttouch.emulator.firmware import DeliveryLog
    from smarttouch.emulator.skin import COMPLIANCE_V

    if name not in BOARDS:
        raise not_offered("emulator", name, BOARDS)
    electrodes = BOARDS[name] if electrodes is None else electrodes
    volts = COMPLIANCE_V if compliance is None else compliance
    _require(
        ("electrodes", electrodes, 61 if name == "kajimoto61" else 1, _MOST_ELECTRODES[name]),
        ("compliance", volts, *_COMPLIANCES_V),
        ("ramp_ms", ramp_ms, 0, 10_000),
        ("discovery_port", 1 if discovery_port is None else discovery_port, 1, 65_535),
    )
    kind = next((each for each in OUTPUTS if each == output), None)
    if kind is None:
        raise not_offered("output", output, OUTPUTS)
    _require_firmware(name, firmware)
    if discovery_port is not None and not tcp:
        raise SmartTouchError("discovery_port is for a board on the network: serve TCP")
    if books is not None and not books.is_dir():
        raise SmartTouchError(f"{books} is no folder: make it first")
    kept, finger = DeliveryLog(electrodes, books), EmulatedFinger(electrodes, event or ())
    device = _board(name, kind, firmware or "71adee2", ramp_ms, kept, finger, volts)
    _serve(
        device,
        lambda: TcpLine(discovery_port) if tcp else PtyLine(),
        str if port_only else partial(_board_advice, name),
        linger,
        parent,
    )


def _require_firmware(name: str, firmware: str | None) -> None:
    """Raise unless a board has a firmware by that name, if one is named."""
    from smarttouch.emulator.etactilekit_firmware import FIRMWARES

    if firmware is not None and name != "etactilekit":
        message = f"firmware is for etactilekit, and a {name} has only one: leave it out"
        raise SmartTouchError(message)
    if firmware is not None and firmware not in FIRMWARES:
        raise not_offered("firmware", firmware, FIRMWARES)


def _board(
    name: str,
    kind: "Output",
    firmware: str,
    ramp_ms: int,
    kept: "DeliveryLog",
    finger: "EmulatedFinger",
    volts: float,
) -> "Firmware":
    """Return the firmware of a board."""
    from smarttouch.base.afferent import Afferent
    from smarttouch.emulator.etactilekit_firmware import ETactileKitFirmware
    from smarttouch.emulator.kajimoto61_firmware import Kajimoto61Firmware
    from smarttouch.emulator.link_firmware import LinkFirmware
    from smarttouch.emulator.rules_over_time import MOST_KERNELS, Room

    if name == "kajimoto61":
        return Kajimoto61Firmware(kept, finger, volts)
    if name == "etactilekit":
        return ETactileKitFirmware(kept, finger, volts, firmware)
    # Kernels of all classes, however many electrodes there are.
    room = Room(kernels=max(MOST_KERNELS, len(Afferent) * kept.electrodes))
    return LinkFirmware(kept.electrodes, kind, kept, finger, volts, ramp_ms=ramp_ms, room=room)


def _require(*ranges: tuple[str, float, float, float]) -> None:
    """Raise unless each option, with its value, least and most, is in its range."""
    for about, value, least, most in ranges:
        require_within(SmartTouchError, about, value, least, most)


def _board_advice(name: str, port: str) -> str:
    # The kits do not measure force.
    force = "" if name == "link" else " --force fixed:0.9"
    return (
        f"A {name} board on emulated skin. In another terminal:\n\n"
        f"  smarttouch live --board {name}:{port}{force}\n\nCtrl-C ends it."
    )


def emulate_sensor(
    name: Annotated[str, argument("serial-array, hx711 or loadcell", "KIND")],
    rate: Annotated[float | None, option("200 frames or 80 readings if not given.", "HZ")] = None,
    url: Annotated[
        str | None, option("What an array looks at: page:FILE, text:...", "URL", "--sensor")
    ] = None,
    rows: Annotated[int, option("Of an array.", "N")] = 64,
    columns: Annotated[int, option("Of an array.", "N")] = 64,
    force: Annotated[float, option("On a load cell, newtons.", "N")] = 0.5,
    path: Annotated[Path | None, option("Or as recorded: time_s,force_n.", "CSV")] = None,
    counts_per_n: Annotated[float, option("Of a load cell.")] = 50_000.0,
    zero: Annotated[float, option("Its reading at rest, counts.")] = 80_000.0,
    noise: Annotated[float, option("Its noise, counts.")] = 60.0,
    seed: Annotated[int, option("Of the noise.", "N")] = 0,
    event: Annotated[
        list[str] | None,
        option(
            "What goes wrong: '2 garbage 0.5', '3 nan', '4 freeze', '5 silent', '6 unplug 1'",
            "TEXT",
        ),
    ] = None,
    count: Annotated[int | None, option("Fall silent after so many.", "N")] = None,
    books: Annotated[
        Path | None, option("For what it has sent in full; printed if not given.", "FILE")
    ] = None,
    profile: Annotated[
        str | None, option("Device and finger; electric-mouse.", "NAME|FILE")
    ] = None,
    linger: _Linger = math.inf,
    parent: _Parent = None,
    port_only: _PortOnly = False,
) -> None:
    """Emulate a sensor, behind a port whose name is printed, until Ctrl-C."""
    from smarttouch.base.errors import SourceError
    from smarttouch.emulator import sensors
    from smarttouch.emulator.finger_events import parse
    from smarttouch.emulator.server import FAULTS, Orders
    from smarttouch.profile import DEFAULT_PROFILE, load_profile
    from smarttouch.sources.sensor_protocol import MOST_PIXELS_A_SIDE

    if name not in SENSORS:
        raise not_offered("emulator", name, SENSORS)
    rate_hz = SENSORS[name] if rate is None else rate
    _require(
        ("rate", rate_hz, *_RATES_HZ),
        ("rows", rows, 2, MOST_PIXELS_A_SIDE),
        ("columns", columns, 2, MOST_PIXELS_A_SIDE),
        ("force", force, -_LARGEST, _LARGEST),
        ("zero", zero, -_LARGEST, _LARGEST),
        ("counts_per_n", abs(counts_per_n), 0.001, _LARGEST),
        ("noise", noise, 0, _LARGEST),
        ("seed", seed, 0, math.inf),
    )
    require_folder(books)
    faults = [parse(text, FAULTS, SourceError) for text in event or ()]
    kinds = {fault.kind for fault in faults}
    chosen = load_profile(profile or DEFAULT_PROFILE)
    if name == "serial-array":
        if "nan" in kinds:
            message = "a pixel is always a number: event nan is for load cells"
            raise SmartTouchError(message)
        device: sensors.SensorFirmware = sensors.SensorArray(
            _look(url, chosen, rows, columns), rate_hz
        )
    else:
        pressed, framed = sensors.press(force, path), name == "loadcell"
        device = sensors.EmulatedLoadCell(
            pressed, counts_per_n, zero, noise, framed=framed, seed=seed, rate_hz=rate_hz
        )
    curve = f"curve = [{-zero / counts_per_n:g}, {1 / counts_per_n:g}]"
    say = str if port_only else partial(_sensor_advice, name, curve)
    more = {"faults": faults, "count": count, "orders": Orders()}
    sent = _serve(
        device, lambda: PtyLine(keeps_name="unplug" in kinds), say, linger, parent, **more
    )
    _report(sent, books)


def _look(url: str | None, profile: "Profile", rows: int, columns: int) -> "Look":
    """Return what an array looks at: a source by its URL, else a pattern."""
    from smarttouch.emulator import sensors

    if url is None:
        return sensors.look_at_pattern(rows, columns)
    import cv2

    cv2.setNumThreads(1)
    return sensors.look_at_page(url, profile, rows, columns)


def _sensor_advice(name: str, curve: str, port: str) -> str:
    if name == "serial-array":
        return (
            f"A sensor array. In another terminal:\n\n  smarttouch devices show {name}:{port}\n"
            f"  smarttouch live {name}:{port} --force fixed:0.5\n\nCtrl-C ends it."
        )
    return (
        "A load cell. In another terminal:\n\n"
        f"  smarttouch devices show {name}:{port} --profile P\n"
        f"  smarttouch live --force {name}:{port} --profile P\n\n"
        f"with {curve} in [force] of the profile P, or smarttouch calibrate force to find it. "
        "A line typed here puts something else on it: weight 100 (grams), force 0.5 (newtons). "
        "Ctrl-C ends it."
    )


def _report(sent: "LineStatistics", books: Path | None) -> None:
    """Write what was sent to a file, or print it."""
    account = json.dumps(asdict(sent))
    if books is not None:
        write_bytes(books, (account + "\n").encode())
    else:
        with suppress(BrokenPipeError):
            print(account, flush=True)


def _serve(
    device: "Firmware",
    open_line: Callable[[], PtyLine | TcpLine],
    describe: Callable[[str], str],
    linger_s: float,
    parent: int | None,
    **more: Any,
) -> "LineStatistics":
    """Serve a device until its end; return what was sent."""
    from threadpoolctl import threadpool_limits

    from smarttouch.emulator.server import Server

    require_within(SmartTouchError, "linger", linger_s, 0, math.inf)
    try:
        line = open_line()
    except OSError as error:
        raise SmartTouchError(f"cannot open a port: {error}") from None
    server = Server(device, line, **more)
    # Circuits and images are small: a second thread would only slow down the host.
    with threadpool_limits(1), closing(line):
        server.serve(linger_s, parent, describe)
    return server.statistics
