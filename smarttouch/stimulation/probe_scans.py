"""Scans that measure the impedances of electrodes.

A board with one source drives each electrode in turn against all others. A board with a source for
each electrode drives pairs of near electrodes: in a larger group, one electrode without contact
would saturate the voltage.
"""

from collections.abc import Iterator

import numpy as np

from smarttouch.base.errors import BoardError
from smarttouch.profile.profile_tables import Output
from smarttouch.stimulation.safety_limits import SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

PROBE_MA = 0.5
PROBE_US = 50
_DISCHARGE_US = 100
_STEPS = 20
_SLOWEST_US = 20_000  # shortest period in which every board can report its voltages
_SWITCHING_US = 30  # longest time that switching adds to a slot
_PAIRS = 4  # each electrode forms a pair with each of the next four electrodes


def probe_sequences(
    limits: SafetyLimits, output: Output | None, *, in_pairs: bool
) -> Iterator[ScanSequence]:
    """Yield scans whose current rises from zero to at most `PROBE_MA`. Measure with the last scan.

    Each slot drives one electrode against all others or, if ``in_pairs``, against a near electrode.
    In each scan an electrode carries equal charges of both signs. Masked electrodes carry no
    current: without contact they would saturate the voltage. The scans keep the ramp limit if the
    board delivers each of them completely.
    """
    most_ma = min(limits.current_ma, limits.full_ma, *(limits.electrode_ma or ()))
    peak_ma = min(PROBE_MA, 0.9 * most_ma)
    if peak_ma < 0.02:
        raise BoardError(
            f"the limits allow {peak_ma * 1000:.0f} µA, and a measurement needs 20 µA: raise "
            "the current limits of the profile"
        )
    top, sites = peak_ma / limits.full_ma, np.delete(np.arange(limits.electrodes), limits.masked)
    turns = range(1, min(_PAIRS, len(sites) // 2) + 1) if in_pairs else [1]
    driven = np.tile(sites, len(turns))
    returns = [back for turn in turns for back in np.roll(sites, -turn)[:, None]]
    if not in_pairs:
        # The first return electrodes of a list can carry 1 µA more, as currents are integers. Begin
        # each list after the driven electrode, so that the slots differ in these electrodes.
        returns = [np.roll(sites, -at)[1:] for at in range(len(sites))]
    slot_us = max(PROBE_US + _DISCHARGE_US, int(np.ceil(PROBE_US / limits.duty))) + _SWITCHING_US
    # The ramp rises only while current flows, so a scan must last until the next step is allowed.
    step_us = max(_SLOWEST_US, int(np.ceil(1.05e6 * limits.ramp_s * top / _STEPS)))
    period_us = max(step_us, int(np.ceil(1e6 / limits.rate_hz)), len(driven) * slot_us)
    sign = 1 if output is None or "cathodic" in output.polarities else -1
    for step in range(_STEPS + 1):
        level_ua = round(1000 * peak_ma * step / _STEPS)
        slots = len(driven) if level_ua else 0
        currents = np.zeros((slots, limits.electrodes), np.int16)
        for current, site, back in zip(currents, driven, returns, strict=False):
            share, rest = divmod(level_ua, len(back))
            current[back] = -share
            current[back[:rest]] -= 1
            current[site] = level_ua
        yield ScanSequence(
            current_ua=sign * currents,
            width_us=np.full(slots, PROBE_US, np.uint16),
            discharge_us=np.full(slots, _DISCHARGE_US, np.uint16),
            site=driven[:slots].astype(np.uint16),
            period_us=period_us,
            intensity=top * step / _STEPS,
            time_ns=1000 * step * period_us,
        )
