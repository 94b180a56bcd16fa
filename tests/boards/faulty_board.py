"""An emulated board with a fault: ``faulty_board.py FAULT URL-FOR-THE-EMULATOR``.

It delivers what was not sent, or reports that it has.
"""

import sys

import numpy as np

import smarttouch.emulator.etactilekit_firmware as kit
import smarttouch.emulator.link_firmware as link
from smarttouch.emulator.__main__ import main
from smarttouch.emulator.firmware import DeliveryLog


def twice(enter):
    """Deliver each slot twice."""

    def entered(books, *given, **named):
        enter(books, *given, **named)
        return enter(books, *given, **named)

    return entered


def counting(name, value):
    """Return a change by which each slot leaves a value in the books."""

    def change(enter):
        def entered(books, *given, **named):
            taken = enter(books, *given, **named)
            setattr(books, name, value)
            return taken

        return entered

    return change


def after_zero(report):
    """Deliver one more slot between any two reports after a stop."""

    def reported(board):
        board.books.slots += board._refusing is not None
        return report(board)

    return reported


def beside(pulses):
    """Pulse output 5, too, wherever any is pulsed."""

    def pulsed(board):
        found = list(pulses(board))
        if any(height for height, _, _ in found):
            found[5] = max(found)
        return found

    return pulsed


def change(owner, name, by):
    setattr(owner, name, by(getattr(owner, name)))


fault = sys.argv.pop(1)
if fault == "twice":
    change(DeliveryLog, "enter", twice)
elif fault == "violation":
    change(DeliveryLog, "enter", counting("violations", 1))
elif fault == "strong":
    change(DeliveryLog, "enter", counting("max_current_ma", 4.9))
elif fault == "after zero":
    for each in (link.LinkFirmware, *link.LinkFirmware.__subclasses__()):
        if "_report" in vars(each):
            change(each, "_report", after_zero)
elif fault == "volts":
    change(link, "encode_volts", lambda encode: lambda volts: encode(np.full(len(volts), 650.0)))
elif fault == "beside":
    change(kit.ETactileKitFirmware, "_pulses", beside)
else:
    raise SystemExit(f"no such fault: {fault}")
main()
