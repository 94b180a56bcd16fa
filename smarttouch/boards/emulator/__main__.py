"""``python -m smarttouch.boards.emulator``: the board's process.

It prints the name of its port, serves it, and ends by itself a while after the
host has closed it.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from threadpoolctl import threadpool_limits

from smarttouch.boards.emulator import serve
from smarttouch.boards.emulator.books import Books
from smarttouch.boards.emulator.etactilekit import ETactileKitFirmware
from smarttouch.boards.emulator.etactilekit_generations import GENERATIONS
from smarttouch.boards.emulator.finger import Finger
from smarttouch.boards.emulator.kajimoto61 import ELECTRODES, Kajimoto61Firmware
from smarttouch.boards.emulator.link import LinkFirmware
from smarttouch.boards.emulator.skin import COMPLIANCE_V
from smarttouch.boards.link_protocol import OUTPUTS
from smarttouch.errors import BoardError
from smarttouch.wire.pty_line import PtyLine

PROTOCOLS = ("link", "kajimoto61", "etactilekit")
MOST_OUTPUTS = 255


def main(arguments: Sequence[str] | None = None) -> None:
    """Run an emulated board until its host is gone.

    Parameters
    ----------
    arguments : sequence of str, optional
        Instead of the command line's.
    """
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.discovery_port is not None and not options.tcp:
        parser.error("--discovery-port is for a board on the network: add --tcp")
    if not options.linger >= 0:
        parser.error(f"--linger {options.linger:g} is no time: give seconds, or inf")
    if not 0 < options.compliance <= 10_000:
        parser.error(f"--compliance {options.compliance:g} is out of range: give 1 to 10000 V")
    try:
        firmware = _make(options)
    except BoardError as error:
        parser.error(str(error))
    if options.books is not None and not options.books.is_dir():
        parser.error(f"--books {options.books} is no folder: create it first")
    try:
        line = serve.TcpLine(options.discovery_port) if options.tcp else PtyLine()
    except OSError as error:
        parser.error(f"cannot open a port: {error.strerror or error}")
    firmware.books.write()
    # The circuit is small: a second thread would only take the host's processor.
    with threadpool_limits(1):
        serve.serve(firmware, line, options.linger, options.parent)


def _make(options: argparse.Namespace) -> serve.Firmware:
    electrodes, protocol = options.electrodes, options.protocol
    if protocol == "kajimoto61":
        if electrodes not in (None, ELECTRODES):
            raise BoardError(
                f"a kajimoto61 has {ELECTRODES} electrodes, not {electrodes}",
                about="--electrodes",
                problem="conflict",
                value=electrodes,
                allowed=ELECTRODES,
            )
        electrodes = ELECTRODES
    elif protocol == "etactilekit":
        electrodes = 32 if electrodes is None else electrodes
        if not 1 <= electrodes <= MOST_OUTPUTS:
            raise BoardError(
                f"an eTactileKit has 1 to {MOST_OUTPUTS} outputs, not {electrodes}",
                about="--electrodes",
                problem="too few" if electrodes < 1 else "too many",
                value=electrodes,
                allowed=MOST_OUTPUTS,
            )
    elif electrodes is None or electrodes < 1:
        raise BoardError(
            "a board needs electrodes: say how many with --electrodes",
            about="--electrodes",
            problem="missing" if electrodes is None else "too few",
            value=electrodes,
        )
    books, finger = Books(electrodes, options.books), Finger(electrodes, options.event)
    if protocol == "kajimoto61":
        return Kajimoto61Firmware(books, finger, options.compliance)
    if protocol == "etactilekit":
        return ETactileKitFirmware(books, finger, options.compliance, options.firmware)
    return LinkFirmware(electrodes, options.output, books, finger, options.compliance)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m smarttouch.boards.emulator", description=__doc__
    )
    parser.add_argument("--protocol", choices=PROTOCOLS, default="link", help="whose firmware")
    parser.add_argument("--electrodes", type=int, help="how many; kajimoto61 always has 61")
    parser.add_argument("--output", choices=OUTPUTS, default="weighted", help="of a link board")
    parser.add_argument("--books", type=Path, help="folder for state.json and delivered.bin")
    parser.add_argument(
        "--linger", type=float, default=2.0, help="seconds to live on without a host, or inf"
    )
    parser.add_argument("--parent", type=int, help="process that it is not to outlive")
    parser.add_argument("--tcp", action="store_true", help="serve a TCP port, not a serial one")
    parser.add_argument("--discovery-port", type=int, help="UDP port to answer ETK? on")
    parser.add_argument(
        "--event",
        action="append",
        default=[],
        help="what happens to the finger: '2 lift', '3 touch', '0 force 0.6', "
        "'0 drift 12 4 60', '5 peel 7 0.3', '5 open 7', '5 short 7', '5 heal 7'",
    )
    parser.add_argument(
        "--firmware", choices=GENERATIONS, default="71adee2", help="which of an etactilekit"
    )
    parser.add_argument(
        "--compliance", type=float, default=COMPLIANCE_V, help="most volts of its sources"
    )
    return parser


if __name__ == "__main__":
    main()
