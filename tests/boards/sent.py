"""What a board was sent, as pulses, by code that shares nothing with the drivers."""

import numpy as np

from smarttouch.emulator.firmware import read_slots
from smarttouch.testing.driver_contract import SentPulse


class Source:
    """The source of a kit's emulated firmware, without skin: it keeps what it is to drive."""

    def __init__(self, extra_us):
        self.pulses, self._extra_us = [], extra_us

    def pulse(
        self, number, electrode, current_ua, width_us, start_ns, *, among, rest_us, more=False, **_
    ):
        """Keep a pulse; the others share its current.

        What comes before it is of the self-test, and not of what is sent.
        """
        current = [-current_ua / (among - 1)] * among
        current[electrode] = current_ua
        if current_ua and not more:
            self.pulses.append(SentPulse(tuple(current), width_us, rest_us - self._extra_us))
        return 0


class SentBytes:
    """All that a driver writes to its line, and when."""

    def __init__(self, now_ns):
        self.written, self.now_ns = [], now_ns

    def keep(self, driver):
        """Keep what is written from when a driver is opened."""
        open_driver = driver.open

        def opened(line, limits):
            connect = type(line).connect
            line.connect = lambda name, wrap=_same: connect(line, name, self._of(wrap))
            return open_driver(line, limits)

        driver.open = opened

    def _of(self, wrap):
        def wrapped(port):
            line = wrap(port)
            write = line.write

            def kept(data):
                self.written.append((self.now_ns(), bytes(data)))
                return write(data)

            # Without a number it is written to by this alone.
            line.write, line.fileno = kept, _no_number
            return line

        return wrapped

    def pulses(self, firmware, extra_us=0):
        """Return the pulses that a firmware gives by these bytes at these times.

        It rests for ``extra_us`` longer after each than is asked for.
        """
        source = Source(extra_us)
        firmware._pulse = source.pulse
        for time_ns, data in self.written:
            firmware.feed(data, time_ns)
        firmware.advance(self.now_ns())
        return source.pulses


def _same(port):
    return port


def _no_number():
    raise OSError


def pulses_in_books(folder):
    """Return the pulses that an emulated link board has delivered."""
    slots = np.concatenate([read_slots(folder), read_slots(folder, recharges=True)])
    slots = slots[np.argsort(slots["time_us"], kind="stable")]
    found = []
    for number, slot in enumerate(slots):
        current_ua = slot["current_ua"].astype(float)
        strongest = np.abs(current_ua).argmax()
        width_us = round(1e6 * float(slot["charge_uc"][strongest] / current_ua[strongest]), 3)
        discharge_us = None
        if number + 1 < len(slots) and slots[number + 1]["slot"] == int(slot["slot"]) + 1:
            discharge_us = float(slots[number + 1]["time_us"] - slot["time_us"]) - width_us
        found.append(SentPulse(tuple(current_ua), width_us, discharge_us))
    return found
