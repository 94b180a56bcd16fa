"""An emulated board with a fault: ``faulty_board.py FAULT URL-FOR-THE-EMULATOR``.

The board delivers pulses that were not sent, or reports false values.
"""

import sys

import numpy as np

import smarttouch.emulator.etactilekit_firmware as kit
import smarttouch.emulator.link_board as link
from smarttouch.emulator.__main__ import main
from smarttouch.emulator.firmware_base import DeliveryLog

fault = sys.argv.pop(1)


def entering(enter):
    """Wrap `DeliveryLog.enter`: record each slot twice, or falsify a counter."""

    def entered(books, *given, **named):
        for _ in range(1 + (fault == "twice")):
            taken = enter(books, *given, **named)
        books.violations += fault == "violation"
        books.max_current_ma = 4.9 if fault == "strong" else books.max_current_ma
        return taken

    return entered


def after_zero(report):
    """Wrap `_report`: after a stop, each report adds one slot to the counter of slots."""

    def reported(board):
        board.books.slots += board._refusing is not None
        return report(board)

    return reported


def beside(pulses):
    """Wrap `_pulses`: output 5 fires whenever any output fires."""

    def pulsed(board):
        found = list(pulses(board))
        if any(height for height, _, _ in found):
            found[5] = max(found)
        return found

    return pulsed


if fault == "after zero":
    link.LinkFirmware._report = after_zero(link.LinkFirmware._report)
elif fault == "volts":
    encode = link.link_packets.encode_volts
    link.link_packets.encode_volts = lambda volts: encode(np.full(len(volts), 650.0))
elif fault == "beside":
    kit.ETactileKitFirmware._pulses = beside(kit.ETactileKitFirmware._pulses)
else:
    DeliveryLog.enter = entering(DeliveryLog.enter)
main()
