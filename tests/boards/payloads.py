"""Payloads of the link, for boards on a clock of a test's own."""

import numpy as np

from smarttouch.boards.link.sequence_encoding import encode_limits, encode_scan
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence


def limits_payload(electrodes):
    """Return LIMITS that allow as much as any board does."""
    return encode_limits(SafetyLimits(electrodes, 5.0, 200, 0.5, 200, 0.8, 0.5, 5.0))


def encode_lists(sequence, times, measure, switched, image, most_bytes):
    """Return the payload of a SEQUENCE that a board has room for at once."""
    (part,) = encode_scan(sequence, times, measure, switched, image, most_bytes, 1 << 16)
    return part.payload


def sequence_payload(
    output, period_us, width_us, discharge_us, site, current_ua, times=1, measure=False,
    recharge_ua=None, recharge_us=0,
):  # fmt: skip
    """Return the payload of a SEQUENCE at full intensity, without kernels."""
    columns = [np.asarray(each, np.uint16) for each in (width_us, discharge_us, site)]
    current = np.asarray(current_ua, np.int16)
    sequence = ScanSequence(
        current, *columns, period_us, 1.0, 0, recharge_ua=recharge_ua, recharge_us=recharge_us
    )
    return encode_lists(sequence, times, measure, output != "weighted", None, 1 << 20)
