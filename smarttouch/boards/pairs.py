"""Impedances from pairs of electrodes, where one against all others is not informative.

On a board whose outputs each force their own current, one open electrode among the
returns takes all the voltage there is, whichever electrode is measured.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.impedance import SATURATED, Impedance, classify
from smarttouch.boards.probe import one_pair_each
from smarttouch.stimulation.safety import SafetyLimits
from smarttouch.stimulation.sequence import ScanSequence

MOST_REFERENCES = 16  # tried before all count as open; far apart, for partial touch
MOST_TRIPLES = 16
ENOUGH = 0.5  # part of the electrodes that must conduct to a good reference

Ask = Callable[[ScanSequence], NDArray[np.float64]]  # delivers a scan, returns (S,) V


def measure_in_pairs(
    ask: Ask,
    limits: SafetyLimits,
    level_ua: int,
    intensity: float,
    time_ns: int,
    compliance_v: float,
) -> Impedance:
    """Return the impedance of each electrode, from scans of two electrodes at a time.

    All are measured against one reference r: I (Zᵢ + Zᵣ). Of three electrodes that all conduct, Zᵣ
    = (Zᵢᵣ + Zⱼᵣ − Zᵢⱼ) / 2; the median over neighbors counts. The board is at the intensity of
    ``level_ua`` already; scans are stamped a millisecond apart from ``time_ns`` on.
    """
    count, step = limits.electrodes, 0
    current_ma = level_ua / 1000

    def kohm_of(pairs: list[tuple[int, int]]) -> NDArray[np.float64]:
        nonlocal step
        step += 1
        scan = one_pair_each(limits, level_ua, pairs, intensity, time_ns + step * 1_000_000)
        volts = ask(scan)
        return np.where(volts >= SATURATED * compliance_v, np.inf, volts / current_ma)

    references = np.unique(np.linspace(0, count - 1, min(count, MOST_REFERENCES)).round())
    best = np.full(count, np.inf)
    chosen = 0
    for reference in references.astype(int).tolist():
        others = [each for each in range(count) if each != reference]
        found = np.full(count, np.inf)
        found[others] = kohm_of([(each, reference) for each in others])
        if np.isfinite(found).sum() > np.isfinite(best).sum():
            best, chosen = found, reference
        if np.isfinite(best).sum() >= ENOUGH * (count - 1):
            break
    good = np.flatnonzero(np.isfinite(best))[: MOST_TRIPLES + 1]
    if len(good) < 2:
        return classify(np.full(count, np.inf), current_ma)
    pairs = list(zip(good[:-1].tolist(), good[1:].tolist(), strict=True))
    between = kohm_of(pairs)
    its_own = float(np.median((best[good[:-1]] + best[good[1:]] - between) / 2))
    kohm = np.maximum(best - its_own, 1e-3)
    kohm[chosen] = max(its_own, 1e-3)
    return classify(kohm, current_ma)
