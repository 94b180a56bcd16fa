"""Opening of a level by weak current, for tests that begin at full intensity."""

import math
from dataclasses import replace

import numpy as np

from smarttouch.base.clock import LATE_NS
from smarttouch.stimulation.safety_limits import STRENGTH


def open_level(send, like, limits, time_ns=0, clock=None, electrodes=(0, 1)):
    """Send a silent sequence and weak ones for less than a second; then any intensity is open.

    Sequences are like the one given, through two electrodes; the silent one claims ``time_ns``,
    those after it up to a second more, by which the clock of a gate, if given, is moved on. The
    limits' ramp takes half a second at most.
    """
    first = np.zeros(2, np.uint16)
    weak = np.zeros((2, like.current_ua.shape[1]), np.int16)
    one = replace(
        like, current_ua=weak, width_us=first + limits.pulse_whole_us, discharge_us=first + 50,
        site=first, period_us=LATE_NS // 1000, proof=None, sums=None, vibration=None,
        recharge_ua=None, recharge_us=0,
    )  # fmt: skip
    none = slice(0, 0)
    send(
        replace(
            one,
            current_ua=weak[none],
            width_us=first[none],
            discharge_us=first[none],
            site=first[none],
            intensity=0.0,
            time_ns=time_ns,
            period_us=20_000,
        )
    )
    steps = math.ceil(limits.ramp_ns / LATE_NS)
    waits_ns = [20_000_000, *[LATE_NS] * steps, 980_000_000 - steps * LATE_NS]
    for step, wait_ns in enumerate(waits_ns):
        if clock is not None:
            clock.time_ns += wait_ns
        if step < steps:
            share = (step + 1) / steps
            current = np.zeros_like(weak)
            # The least that counts for as much as it claims, and leaves no charge.
            least_ua = math.ceil(share * limits.full_ua / STRENGTH)
            current[:, list(electrodes)] = [[least_ua, -least_ua], [-least_ua, least_ua]]
            send(
                replace(
                    one, current_ua=current, intensity=share, time_ns=time_ns + 1 + step * LATE_NS
                )
            )
