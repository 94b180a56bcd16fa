"""Scan sequences from bare currents."""

import numpy as np

from smarttouch.stimulation.exposure import Exposure
from smarttouch.stimulation.safety_gate import SafetyLimits, frozen
from smarttouch.stimulation.scan_sequence import ScanSequence
from smarttouch.stimulation.sequence_limits import prove_sequence


def sequence(currents, widths=200, *, electrodes=4, discharge_us=100, **other):
    """Return a sequence of these currents in µA, a slot a row, at full intensity after a second."""
    currents = np.asarray(currents, np.int16).reshape(-1, electrodes)
    slots = len(currents)
    return ScanSequence(
        current_ua=currents,
        width_us=np.full(slots, widths, np.uint16),
        discharge_us=np.full(slots, discharge_us, np.uint16),
        site=np.zeros(slots, np.uint16),
        **({"period_us": 20_000, "intensity": 1.0, "time_ns": 10**9} | other),
    )


def prove_alone(profile, sequence):
    """Prove all limits of a sequence but the ramp, as if nothing had come before it."""
    limits = SafetyLimits.of(profile)
    load = prove_sequence(frozen(sequence), limits)
    Exposure(limits).enter(sequence.time_ns, sequence.period_us, 1, load, flows=True)
