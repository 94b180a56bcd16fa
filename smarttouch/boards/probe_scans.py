"""Measuring scans: small currents through each electrode in turn, or through pairs of them.

On a board whose outputs each force their own current, one open electrode among the
returns takes all the voltage there is, whichever electrode is measured.
"""

import time
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import BoardError
from smarttouch.boards.reports import SATURATED, Capabilities, Impedance, classify, judge
from smarttouch.profile.device import Output
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

PROBE_MA = 0.5
PROBE_US = 50
_STEPS = 20
_SLOWEST_US = 20_000  # period that leaves any board the time to answer
_SWITCHING_US = 30  # most that switching adds to a slot


def probe_sequences(limits: SafetyLimits, output: Output | None) -> Iterator[ScanSequence]:
    """Yield scans of one electrode against all others that rise from zero to `PROBE_MA`, without
    masked electrodes. The last one is the measurement; those before it keep the rise within the
    ramp, by their own time stamps."""
    peak_ma = min(PROBE_MA, 0.9 * limits.current_ma, 0.9 * limits.full_ma)
    if limits.electrode_ma is not None:
        peak_ma = min(peak_ma, 0.9 * min(limits.electrode_ma))
    if peak_ma < 0.02:
        raise BoardError(f"the limits allow {peak_ma * 1000:.0f} µA: too little to measure with")
    top = peak_ma / limits.full_ma
    rise_s = limits.ramp_s * top
    # Only the time of passes with current counts towards the rise.
    step_us = max(_SLOWEST_US, int(np.ceil(1.05e6 * rise_s / _STEPS)))
    start = time.monotonic_ns()
    cathodic = output is None or "cathodic" in output.polarities
    for step in range(_STEPS + 1):
        part = step / _STEPS
        due_ns = start + int(1.05 * part * rise_s * 1e9)
        time.sleep(max(0.0, (due_ns - time.monotonic_ns()) / 1e9))
        yield one_each(
            limits, round(1000 * peak_ma * part), PROBE_US, top * part, due_ns, cathodic=cathodic,
            sites=np.delete(np.arange(limits.electrodes), limits.masked).tolist(),
            masked=limits.masked, period_us=step_us,
        )  # fmt: skip


def one_each(
    limits: SafetyLimits,
    level_ua: int,
    width_us: int,
    intensity: float,
    time_ns: int,
    *,
    cathodic: bool,
    sites: list[int] | None = None,
    masked: tuple[int, ...] = (),
    discharge_us: int = 100,
    period_us: int = 0,
) -> ScanSequence:
    """Return a scan of one slot for each site (all if not given): ``level_ua`` through it, returned
    equally by the other electrodes; no slots if that is 0. Masked ones take no share, as an open
    one would need all the voltage there is."""
    count = limits.electrodes
    driven = list(range(count) if sites is None else sites) if level_ua else []
    currents = np.zeros((len(driven), count), np.int16)
    for current, site in zip(currents, driven, strict=True):
        # From the driven electrode on: the nearest ones take the remainder.
        others = ((site + step) % count for step in range(1, count))
        returns = [other for other in others if other not in masked]
        share, rest = divmod(level_ua, len(returns))
        current[returns] = -share
        current[returns[:rest]] -= 1
        current[site] = level_ua
    return _scan(
        limits, currents if cathodic else -currents, driven, width_us,
        intensity, time_ns, discharge_us, period_us,
    )  # fmt: skip


def _scan(
    limits: SafetyLimits,
    current_ua: NDArray[np.int16],
    sites: list[int],
    width_us: int,
    intensity: float,
    time_ns: int,
    discharge_us: int = 100,
    period_us: int = 0,
) -> ScanSequence:
    slots = len(current_ua)
    slot_us = max(width_us + discharge_us, int(np.ceil(width_us / limits.duty))) + _SWITCHING_US
    shortest = int(np.ceil(1e6 / limits.rate_hz))
    return ScanSequence(
        current_ua=current_ua,
        width_us=np.full(slots, width_us, np.uint16),
        discharge_us=np.full(slots, discharge_us, np.uint16),
        site=np.asarray(sites, np.uint16),
        period_us=max(period_us, shortest, slots * slot_us),
        intensity=intensity if slots else 0.0,
        time_ns=time_ns,
    )


MOST_REFERENCES = 16  # tried before all count as open; far apart, for partial touch
MOST_TRIPLES = 16
ENOUGH = 0.5  # part of the electrodes that must conduct to a good reference

Ask = Callable[[ScanSequence], NDArray[np.float64]]  # delivers a scan, returns (S,) V


def measure_by_probes(
    ask: Ask, limits: SafetyLimits, output: Output | None, can: Capabilities
) -> Impedance:
    """Return the impedance of each electrode, measured by sequences that rise from zero."""
    if not can.measures or can.compliance_v is None:
        raise BoardError("this board does not measure: use a multimeter")
    for probe in probe_sequences(limits, output):
        volts = ask(probe)
    is_saturated = bool((volts >= SATURATED * can.compliance_v).any())
    if can.output == "weighted" and is_saturated and not limits.masked:
        return measure_in_pairs(ask, limits, probe, can.compliance_v)
    # A masked electrode is not driven, and counts as open.
    every = np.full(limits.electrodes, can.compliance_v)
    every[probe.site] = volts
    beside_ma = every / can.load_kohm if can.load_kohm else 0.0
    skin_ma = np.maximum(probe.source_ua[0] / 1000 - beside_ma, 1e-6)
    return judge(every, skin_ma, can.compliance_v)


def measure_in_pairs(
    ask: Ask, limits: SafetyLimits, probe: ScanSequence, compliance_v: float
) -> Impedance:
    """Return the impedance of each electrode, from scans of two electrodes at a time.

    All are measured against one reference r: I (Zᵢ + Zᵣ). Of three electrodes that all conduct, Zᵣ
    = (Zᵢᵣ + Zⱼᵣ − Zᵢⱼ) / 2; the median over neighbors counts. The board is at the intensity of the
    last ``probe`` already; scans are stamped a millisecond apart after it.
    """
    count, step = limits.electrodes, 0
    level_ua = int(np.abs(probe.current_ua).max())

    def kohm_of(pairs: list[tuple[int, int]]) -> NDArray[np.float64]:
        nonlocal step
        step += 1
        currents = np.zeros((len(pairs), count), np.int16)
        for current, (first, second) in zip(currents, pairs, strict=True):
            current[first], current[second] = level_ua, -level_ua
        sites, time_ns = [first for first, _ in pairs], probe.time_ns + step * 1_000_000
        volts = ask(_scan(limits, currents, sites, PROBE_US, probe.intensity, time_ns))
        return np.where(volts >= SATURATED * compliance_v, np.inf, 1000 * volts / level_ua)

    references = np.unique(np.linspace(0, count - 1, min(count, MOST_REFERENCES)).round())
    best, chosen = np.full(count, np.inf), 0
    for reference in references.astype(int).tolist():
        others = [electrode for electrode in range(count) if electrode != reference]
        kohm = np.full(count, np.inf)
        kohm[others] = kohm_of([(other, reference) for other in others])
        if np.isfinite(kohm).sum() > np.isfinite(best).sum():
            best, chosen = kohm, reference
        if np.isfinite(best).sum() >= ENOUGH * (count - 1):
            break
    good = np.flatnonzero(np.isfinite(best))[: MOST_TRIPLES + 1]
    if len(good) < 2:
        return classify(np.full(count, np.inf), level_ua / 1000)
    first, second = good[:-1], good[1:]
    between = kohm_of(list(zip(first.tolist(), second.tolist(), strict=True)))
    reference_kohm = float(np.median((best[first] + best[second] - between) / 2))
    kohm = np.maximum(best - reference_kohm, 1e-3)
    kohm[chosen] = max(reference_kohm, 1e-3)
    return classify(kohm, level_ua / 1000)
