"""Opening of a level by the least current, for tests that begin at full intensity."""

from dataclasses import replace

import numpy as np


def open_level(send, like, time_ns=0, clock=None, electrodes=(0, 1)):
    """Send a silent sequence and a weak one that lasts a second; then any intensity is open.

    Parameters
    ----------
    send : callable
        Of a gate or a board.
    like : ScanSequence
        Of the array.
    time_ns : int
        That the silent one claims; what follows may claim a second more.
    clock : optional
        Of the gate, moved on by a second.
    electrodes : tuple of int
        That carry a microampere.
    """
    first = np.zeros(1, np.uint16)
    weak = np.zeros((1, like.current_ua.shape[1]), np.int16)
    weak[0, list(electrodes)] = 1, -1
    quiet = replace(
        like, current_ua=weak, width_us=first + 1, discharge_us=first + 50, site=first,
        period_us=999_999, intensity=0.1, time_ns=time_ns + 1, proof=None, sums=None,
        vibration=None, recharge_ua=None, recharge_us=0,
    )  # fmt: skip
    none = slice(0, 0)
    send(
        replace(
            quiet,
            current_ua=weak[none],
            width_us=first[none],
            discharge_us=first[none],
            site=first[none],
            intensity=0.0,
            time_ns=time_ns,
            period_us=20_000,
        )
    )
    if clock is not None:
        clock.time_ns += 20_000_000
    send(quiet)
    if clock is not None:
        clock.time_ns += 980_000_000
