"""Impedances of electrodes from the voltages of measuring scans."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import BoardError
from smarttouch.boards.reports import Capabilities
from smarttouch.profile.profile_tables import Output
from smarttouch.stimulation.probe_scans import probe_sequences
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

SATURATED = 0.97  # share of the compliance at which a source counts as saturated
OPEN_FACTOR = 5.0
SHORT_FACTOR = 0.1
"""An electrode counts as shorted if its impedance is below this share of the median impedance. The
share is our estimate: good electrodes differ by a factor of two or three."""

Array = NDArray[np.float64]
Condition = Literal["good", "open", "short", "unsure"]  # unsure: measurements disagree


@dataclass(frozen=True, eq=False)
class Impedance:
    """Impedances of all electrodes, from one measurement."""

    # (E,) impedance from each electrode to the skin: voltage over current at the end of the
    # measuring pulse; infinite if the source was saturated
    kohm: NDArray[np.float64]
    condition: tuple[Condition, ...]
    current_ma: float  # current of the measuring pulse

    @property
    def broken(self) -> tuple[int, ...]:
        """Electrodes that are open or shorted."""
        return tuple(i for i, name in enumerate(self.condition) if name in ("open", "short"))

    @property
    def lifted(self) -> bool:
        """True if nothing touches the electrodes."""
        return all(name == "open" for name in self.condition)


def measure_by_probes(
    ask: Callable[[ScanSequence], Array],
    limits: SafetyLimits,
    output: Output | None,
    can: Capabilities,
) -> Impedance:
    """Measure the impedance of each electrode by sequences whose current rises from zero.

    ``ask`` delivers a sequence and returns the voltage of each slot, (S,) V.
    """
    if not can.measures or can.compliance_v is None:
        raise BoardError("this board does not measure voltages: use a multimeter")
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


def _from_pairs(probe: ScanSequence, volts: Array, compliance_v: float) -> Impedance:
    """Return the impedance of each electrode, by least squares. With the current I, the voltage of
    a conducting pair is I · (Zᵢ + Zⱼ). An electrode without a conducting pair counts as open."""
    level_ua = int(probe.current_ua.max(initial=0))
    conducts = volts < SATURATED * compliance_v
    pairs = (probe.current_ua[conducts] != 0).astype(np.float64)
    kohm, *_ = np.linalg.lstsq(pairs.T @ pairs, pairs.T @ (1000 * volts[conducts] / level_ua))
    return _classify(np.where(pairs.any(axis=0), np.maximum(kohm, 1e-3), np.inf), level_ua / 1000)


def judge(volts: Array, current_ma: float | Array, compliance_v: float) -> Impedance:
    """Return impedances. ``volts``, (E,), is the voltage of each electrode against all others.

    With the current I, electrode i has the voltage I · (Zᵢ + 1 / Σⱼ≠ᵢ 1/Zⱼ). Iteration solves this
    for Z. It converges because the impedance of the parallel return path is small.
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
