"""Scans that measure impedances, and their evaluation.

A board with one source drives each electrode in turn against all others. A board with a source for
each electrode drives pairs of near electrodes: with more, one open electrode would saturate the
voltage.
"""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import BoardError
from smarttouch.boards.reports import Capabilities, Impedance
from smarttouch.profile.device import Output
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

PROBE_MA = 0.5
PROBE_US = 50
_DISCHARGE_US = 100
_STEPS = 20
_SLOWEST_US = 20_000  # period that gives each board time to answer
_SWITCHING_US = 30  # largest additional time of a slot by switching
_PAIRS = 4  # number of pairs of each electrode, with the next ones
SATURATED = 0.97  # share of the compliance at which a source counts as saturated
OPEN_FACTOR = 5.0
SHORT_FACTOR = 0.1
"""Share of the median impedance below which an electrode is shorted (our estimate); good ones
differ by a factor of two or three."""

Array = NDArray[np.float64]


def measure_by_probes(
    ask: Callable[[ScanSequence], Array],
    limits: SafetyLimits,
    output: Output | None,
    can: Capabilities,
) -> Impedance:
    """Measure the impedance of each electrode by sequences that rise from zero.

    ``ask`` delivers a sequence and returns the voltage of each slot, (S,) V.
    """
    if not can.measures or can.compliance_v is None:
        raise BoardError("this board does not measure: use a multimeter")
    in_pairs = can.output == "weighted"
    for probe in probe_sequences(limits, output, in_pairs=in_pairs):
        volts = ask(probe)
    if in_pairs:
        return _from_pairs(probe, volts, can.compliance_v)
    # A masked electrode counts as open.
    every = np.full(limits.electrodes, can.compliance_v)
    every[probe.site] = volts
    beside_ma = every / can.load_kohm if can.load_kohm else 0.0
    return judge(every, np.maximum(probe.source_ua[0] / 1000 - beside_ma, 1e-6), can.compliance_v)


def probe_sequences(
    limits: SafetyLimits, output: Output | None, *, in_pairs: bool
) -> Iterator[ScanSequence]:
    """Yield scans that rise from zero to `PROBE_MA`; the last one is the measurement.

    Each slot drives an electrode against all others, or in pairs against one near it, so that each
    electrode carries equal charges of both signs in a scan. Masked electrodes carry nothing, as an
    open one would saturate the voltage. The rise is within the ramp if each scan is delivered
    completely.
    """
    most_ma = min(limits.current_ma, limits.full_ma, *(limits.electrode_ma or ()))
    peak_ma = min(PROBE_MA, 0.9 * most_ma)
    if peak_ma < 0.02:
        raise BoardError(f"the limits allow {peak_ma * 1000:.0f} µA: too little to measure with")
    top, sites = peak_ma / limits.full_ma, np.delete(np.arange(limits.electrodes), limits.masked)
    turns = range(1, min(_PAIRS, len(sites) // 2) + 1) if in_pairs else [1]
    driven = np.tile(sites, len(turns))
    returns = [back for turn in turns for back in np.roll(sites, -turn)[:, None]]
    if not in_pairs:
        # Start at the driven electrode: the next ones carry the rounding remainder.
        returns = [np.roll(sites, -at)[1:] for at in range(len(sites))]
    slot_us = max(PROBE_US + _DISCHARGE_US, int(np.ceil(PROBE_US / limits.duty))) + _SWITCHING_US
    # Only passes with current count toward the ramp.
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


def _from_pairs(probe: ScanSequence, volts: Array, compliance_v: float) -> Impedance:
    """Return impedances from the voltages of pairs, I (Zᵢ + Zⱼ), by least squares over conducting
    pairs. An electrode without such a pair is open."""
    level_ua = int(probe.current_ua.max(initial=0))
    conducts = volts < SATURATED * compliance_v
    pairs = (probe.current_ua[conducts] != 0).astype(np.float64)
    kohm, *_ = np.linalg.lstsq(pairs.T @ pairs, pairs.T @ (1000 * volts[conducts] / level_ua))
    return _classify(np.where(pairs.any(axis=0), np.maximum(kohm, 1e-3), np.inf), level_ua / 1000)


def judge(volts: Array, current_ma: float | Array, compliance_v: float) -> Impedance:
    """Return impedances from the voltages of each electrode against all others, (E,).

    The voltage of electrode i is I (Zᵢ + 1 / Σⱼ≠ᵢ 1/Zⱼ). It is solved by iteration, which converges
    because the parallel return is small.
    """
    total = np.asarray(volts, np.float64) / np.asarray(current_ma, np.float64)
    saturated = np.asarray(volts) >= SATURATED * compliance_v
    kohm = np.where(saturated, np.inf, np.maximum(total, 1e-3))
    for _ in range(20):
        admittance = 1 / kohm
        others = admittance.sum() - admittance
        back = np.divide(1, others, out=np.zeros_like(others), where=others > 0)
        kohm = np.where(saturated, np.inf, np.maximum(total - back, 1e-3))
    return _classify(kohm, float(np.mean(current_ma)))


def _classify(kohm: Array, current_ma: float) -> Impedance:
    """Classify electrodes as good, open or shorted by their impedances, (E,) kΩ."""
    finite = kohm[np.isfinite(kohm)]
    middle = np.median(finite) if finite.size else np.inf
    is_open = ~(kohm <= OPEN_FACTOR * middle) | ~np.isfinite(kohm)
    conditions = np.select([is_open, kohm < SHORT_FACTOR * middle], ["open", "short"], "good")
    return Impedance(kohm, tuple(conditions.tolist()), current_ma)
