"""``python -m smarttouch.sources.emulator``: a sensor's process.

It prints the name of its port, serves it, and ends by itself a while after the
host has closed it. At its end it says what it has sent in full. Lines on its standard
input are orders: ``weight 100`` (grams on a load cell), ``force 0.5`` (N), or an event
without its time, such as ``garbage 0.5``.
"""

import argparse
import contextlib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from smarttouch.errors import SmartTouchError
from smarttouch.profile import DEFAULT_PROFILE, load_profile
from smarttouch.sources.emulator import devices
from smarttouch.sources.emulator.faults import Faults, parse_fault
from smarttouch.sources.emulator.serve import Server, Socket
from smarttouch.sources.sensor_protocol import MOST_PIXELS_A_SIDE

KINDS = ("serial-array", "hx711", "loadcell")
USUAL_RATE_HZ = {"serial-array": 200.0, "hx711": 80.0, "loadcell": 80.0}
HIGHEST_RATE_HZ = 2000.0


def main(arguments: Sequence[str] | None = None) -> None:
    """Run an emulated sensor until its host is gone.

    Parameters
    ----------
    arguments : sequence of str, optional
        Instead of the command line's.
    """
    parser = _parser()
    options = parser.parse_args(arguments)
    rate_hz = USUAL_RATE_HZ[options.kind] if options.rate is None else options.rate
    _require(parser, options, rate_hz)
    try:
        faults = [parse_fault(text) for text in options.event]
        device = _make(options, rate_hz)
    except SmartTouchError as error:
        parser.error(str(error))
    if options.kind == "serial-array" and any(fault.kind == "nan" for fault in faults):
        parser.error("a pixel is always a number: event nan is for load cells")
    try:
        socket = Socket(may_unplug=any(fault.kind == "unplug" for fault in faults))
    except OSError as error:
        parser.error(f"cannot open a port: {error.strerror or error}")
    if options.sensor is not None:
        # A patch is small: a second thread would only take the host's processor.
        import cv2

        cv2.setNumThreads(1)
    server = Server(device, socket, Faults(faults), rate_hz, options.count)
    try:
        server.serve(options.linger, options.parent)
    finally:
        socket.close()
    account = json.dumps(asdict(server.books))
    if options.books is not None:
        options.books.write_text(account + "\n", encoding="utf-8")
    else:
        with contextlib.suppress(BrokenPipeError):
            print(account, flush=True)


def _make(options: argparse.Namespace, rate_hz: float) -> devices.Device:
    profile = load_profile(options.profile)
    if options.kind == "serial-array":
        shape = (options.rows, options.columns)
        if options.sensor is None:
            look = devices.look_at_pattern(*shape)
        else:
            look = devices.look_at_page(options.sensor, profile, *shape)
        return devices.ArrayDevice(look, rate_hz)
    return devices.CellDevice(
        devices.press(options.force, options.path, profile),
        options.counts_per_n,
        options.zero,
        options.noise,
        framed=options.kind == "loadcell",
        seed=options.seed,
    )


def _require(parser: argparse.ArgumentParser, options: argparse.Namespace, rate_hz: float) -> None:
    if not 0 < rate_hz <= HIGHEST_RATE_HZ:
        parser.error(f"--rate {rate_hz:g} is out of range: give 0 to {HIGHEST_RATE_HZ:g} Hz")
    for name in ("rows", "columns"):
        side = getattr(options, name)
        if not 2 <= side <= MOST_PIXELS_A_SIDE:
            parser.error(f"--{name} {side} is out of range: give 2 to {MOST_PIXELS_A_SIDE}")
    for name in ("force", "counts_per_n", "zero", "noise"):
        value = getattr(options, name)
        if not math.isfinite(value) or (name == "noise" and value < 0):
            parser.error(f"--{name.replace('_', '-')} {value:g} is no good number")
    if not options.linger >= 0:
        parser.error(f"--linger {options.linger:g} is no time: give seconds, or inf")
    if options.books is not None and not options.books.absolute().parent.is_dir():
        parser.error(f"--books {options.books} is in no folder: create it first")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m smarttouch.sources.emulator", description=__doc__
    )
    parser.add_argument("kind", choices=KINDS, help="what to be")
    parser.add_argument("--rate", type=float, help="frames or readings a second")
    parser.add_argument("--sensor", help="what an array looks at: page:FILE or text:STRING")
    parser.add_argument("--rows", type=int, default=64, help="of an array")
    parser.add_argument("--columns", type=int, default=64, help="of an array")
    parser.add_argument("--profile", default=DEFAULT_PROFILE, help="optics of an array")
    parser.add_argument("--force", type=float, default=0.0, help="on a load cell, N")
    parser.add_argument("--path", type=Path, help="CSV of that force: time_s, force_n")
    parser.add_argument("--counts-per-n", type=float, default=50_000.0, help="of a load cell")
    parser.add_argument("--zero", type=float, default=80_000.0, help="its reading at rest")
    parser.add_argument("--noise", type=float, default=60.0, help="its noise, counts")
    parser.add_argument("--seed", type=int, default=0, help="of the noise")
    parser.add_argument(
        "--event",
        action="append",
        default=[],
        help="what goes wrong: '2 garbage 0.5', '3 nan', '4 freeze', '5 silent', '6 unplug 1.5'",
    )
    parser.add_argument("--count", type=int, help="fall silent after so many")
    parser.add_argument("--books", type=Path, help="file for what it has sent, as JSON")
    parser.add_argument(
        "--linger", type=float, default=2.0, help="seconds to live on without a host, or inf"
    )
    parser.add_argument("--parent", type=int, help="process that it is not to outlive")
    return parser


if __name__ == "__main__":
    main()
