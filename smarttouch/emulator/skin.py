"""Electrical circuit of electrodes on skin, and an emulated finger with events.

Each electrode has a series resistance R_s and the stratum corneum, a resistance R_p in parallel
with a capacitance C_p. All electrodes meet in one node, the tissue::

    output ── R_s ──┬─ R_p ─┬── tissue
                    └─ C_p ─┘

Cathodic currents and voltages are positive. Voltages of electrodes are relative to the tissue.

An event of the finger is a text that begins with a time in seconds::

    2.0 lift            the finger leaves all electrodes
    3.0 touch           the finger touches them again
    0 force 0.6         the finger presses with 0.6 N while it touches
    5 open 7            electrode 7 is cut off
    5 short 7           electrode 7 is connected to the tissue by a few ohm
    6 emergency         the emergency switch is opened
    7 release           the emergency switch is closed
"""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import BoardError

SERIES_OHM = 2.0e3
"""Series resistance: 1.16 kΩ is the spreading resistance 1/(4 σ a) of a 1 mm disc on skin of 0.43
S/m; the rest is our estimate for tissue and contact."""
PARALLEL_OHM = 50e3
CAPACITANCE_F = 1.0e-9
"""Resistance and capacitance of the stratum corneum under a 1 mm disc on a moist fingertip (our
estimate). A pulse of 2.4 mA and 200 µs needs about 125 V, which electrotactile displays supply."""
SPREAD = 0.15  # largest relative difference between electrodes of an array (our estimate)
COMPLIANCE_V = 300.0
_CONSTANT = (1, 1.0, 1.0)
_SHARED = (6, 1.3, 0.6)
_CAPPED = (24, 1.15, 1.0)
"""Division of a pulse into time steps. The three values are: number of steps; length of a step,
relative to the previous step; place within a step at which the current is computed, from 0 (start)
to 1 (end). Finer steps change results by at most 3 %."""
_SHORT_STEPS, _SHORT_GROWTH = 3, 3.0
"""Time steps of a discharge: number of steps; length of each step relative to the step before. If
the impedances of electrodes differ by up to 15 %, the error of the remaining charge is below 1 % of
the initial charge."""
_LONGEST_SHORT_US = 2000.0
_MOST_WIDTHS = 64


@dataclass(frozen=True, eq=False)
class Delivered:
    """Delivered current and charge of one pulse, and voltages at its end."""

    current_ua: NDArray[np.float64]  # (E,): mean over the pulse
    charge_pc: NDArray[np.float64]
    volts: NDArray[np.float64]  # (E,): voltage of each electrode at the end of the pulse
    source_v: float  # voltage between the poles of the source at the end of the pulse


class _Steps(NamedTuple):
    """The K time steps of a pulse. Arrays are (K,) or (K, E). During a step, the current I of an
    electrode is constant. It changes the capacitor's voltage from v to v·decay + I·rise_ohm. I is
    calculated for one instant of the step, when the electrode's voltage is v·late + I/admittance.
    The last step has length 0: its I is the current at the end of the pulse."""

    length_s: NDArray[np.float64]
    decay: NDArray[np.float64]
    rise_ohm: NDArray[np.float64]
    late: NDArray[np.float64]
    admittance: NDArray[np.float64]


class SkinCircuit:
    """Circuit of E electrodes, whose voltages are updated pulse by pulse. Impedances differ from
    their mean by at most ``spread`` (relative), in a fixed random pattern."""

    def __init__(
        self, electrodes: int, *, compliance_v: float = COMPLIANCE_V, spread: float = SPREAD
    ) -> None:
        differ = np.random.default_rng(0).uniform(1 - spread, 1 + spread, (3, electrodes))
        self._healthy = differ * np.array([[SERIES_OHM], [PARALLEL_OHM], [CAPACITANCE_F]])
        self.electrodes: int = electrodes
        self.compliance_v: float = compliance_v
        self._volts = np.zeros(electrodes)
        self.scale(np.ones(electrodes), np.ones(electrodes))

    def scale(self, resistance: NDArray[np.float64], capacitance: NDArray[np.float64]) -> None:
        """Multiply initial resistances and capacitances by factors, (E,); keep all voltages."""
        series, parallel, capacity = self._healthy
        self.series_ohm: NDArray[np.float64] = series * resistance
        self.parallel_ohm: NDArray[np.float64] = parallel * resistance
        self.capacitance_f: NDArray[np.float64] = capacity * capacitance
        self._steps_of = lru_cache(_MOST_WIDTHS)(self._find_steps)
        self._shorts_of = lru_cache(_MOST_WIDTHS)(self._find_shorts)

    @property
    def residual_uc(self) -> NDArray[np.float64]:
        """Charge on the capacitance of each electrode, (E,) µC."""
        return np.asarray(1e6 * self.capacitance_f * self._volts)

    def pulse(self, current_ua: NDArray[np.float64], width_us: float) -> Delivered:
        """Drive each electrode with its own current, (E,), for ``width_us``. The compliance voltage
        limits currents. If the anodic and cathodic sums differ, the larger sum is scaled down."""
        asked_ua = _balance(np.asarray(current_ua, np.float64))
        amps = asked_ua * 1e-6
        steps = self._steps_of(width_us, *_CONSTANT)
        end = self._volts * steps.decay[0] + amps * steps.rise_ohm[0]
        drop = amps * self.series_ohm
        # At constant current, voltages are monotonic: check only the start and the end.
        need = max(np.abs(drop + self._volts).max(), np.abs(drop + end).max())
        if need <= self.compliance_v:
            self._volts = end
            return self._delivered(asked_ua * width_us, drop + end, width_us, asked_ua)
        return self._saturated_pulse(asked_ua, amps, width_us)

    def _saturated_pulse(
        self, asked_ua: NDArray[np.float64], asked: NDArray[np.float64], width_us: float
    ) -> Delivered:
        charge, amps, volts = np.zeros(self.electrodes), asked, self._volts
        steps = self._steps_of(width_us, *_CAPPED)
        for length, decay, rise, late, admittance in zip(*steps, strict=True):
            rest = volts * late
            limit = (self.compliance_v - rest) * admittance
            least = (-self.compliance_v - rest) * admittance
            amps = _balance(np.clip(asked, least, limit))
            volts = volts * decay + rise * amps
            charge += amps * length
        self._volts = volts
        ends_v = volts + amps * self.series_ohm
        return self._delivered(charge * 1e12, ends_v, width_us, asked_ua)

    def switched_pulse(
        self,
        state: NDArray[np.integer[Any]],
        source_ua: float,
        width_us: float,
        shunt_ohm: float = np.inf,
    ) -> Delivered:
        """Drive one source for ``width_us``. ``state``, (E,), is 1 for cathode, −1 for anode, 0 for
        insulated. No current flows unless there are a cathode and an anode. The electrodes of one
        pole share the current. An electrode with more impedance gets less of the current.
        ``shunt_ohm`` is a load in parallel with the skin."""
        poles = np.array([state > 0, state < 0])
        if not poles.any(axis=1).all() or not width_us:
            self.idle(width_us)
            nothing = np.zeros(self.electrodes)
            return Delivered(nothing, nothing, self._volts, 0.0)
        steps = self._steps_of(width_us, *_SHARED)
        # Electrode current = `weights` · voltage of its pole − `pulls` · voltage of its capacitor
        weights = steps.admittance[:, None, :] * poles
        pulls = weights * steps.late[:, None, :]
        lifts = weights * steps.rise_ohm[:, None, :]
        linked = pulls[:, 0] + pulls[:, 1]
        keeps = steps.decay - steps.rise_ohm * linked
        volts, source, source_v = self._volts, source_ua * 1e-6, 0.0
        history, nodes = np.empty(keeps.shape), np.empty((len(keeps), 2))
        for step, (to_cathode, to_anode) in enumerate((1 / weights.sum(axis=2)).tolist()):
            history[step] = volts
            pull_cathode, pull_anode = (pulls[step] @ volts).tolist()
            cathode_v, anode_v = pull_cathode * to_cathode, pull_anode * to_anode
            ohm, before_v = to_cathode + to_anode, cathode_v - anode_v
            total = (source - before_v / shunt_ohm) / (1 + ohm / shunt_ohm)
            total = min(total, (self.compliance_v - before_v) / ohm)
            source_v = before_v + total * ohm
            nodes[step] = cathode_v + total * to_cathode, anode_v - total * to_anode
            volts = keeps[step] * volts + nodes[step] @ lifts[step]
        self._volts = volts
        amps = (nodes[:, None, :] @ weights)[:, 0] - linked * history
        charge_pc = (steps.length_s @ amps) * 1e12
        ends_v = volts + amps[-1] * self.series_ohm
        return Delivered(charge_pc / width_us, charge_pc, ends_v, source_v)

    def idle(self, duration_us: float) -> None:
        """Leave all electrodes unconnected: each capacitance discharges through R_p."""
        self._volts = self._volts * np.exp(
            -duration_us * 1e-6 / (self.parallel_ohm * self.capacitance_f)
        )

    def short(self, duration_us: float) -> None:
        """Short all electrodes. Each capacitance discharges through R_p, and through R_s into a
        common node. In each time step, the voltage of the node is constant, and the charges that
        flow into the node add up to 0."""
        if duration_us < 1e-6:
            return
        # `_LONGEST_SHORT_US` is many time constants: the charge that remains is negligible.
        level, steps = self._shorts_of(min(duration_us, _LONGEST_SHORT_US))
        for lost, weights in steps:
            self._volts = self._volts + lost * (level * (weights @ self._volts) - self._volts)

    def _find_shorts(
        self, duration_us: float
    ) -> tuple[NDArray[np.float64], list[tuple[NDArray[np.float64], NDArray[np.float64]]]]:
        """Return ``level``, (E,), and for each time step ``lost`` and ``weights``, both (E,). In a
        step, the voltage of the node is the sum of the capacitor voltages, weighted with
        ``weights``. Each capacitor voltage approaches a target, ``level`` times the voltage of the
        node. The step removes the fraction ``lost`` of the distance to the target."""
        series = 1 / self.series_ohm
        rate = (series + 1 / self.parallel_ohm) / self.capacitance_f
        level = series / (rate * self.capacitance_f)
        share = _SHORT_GROWTH ** np.arange(_SHORT_STEPS, dtype=np.float64)
        length = (share * (duration_us * 1e-6 / share.sum()))[:, None]
        lost = -np.expm1(-rate * length)
        # Charge into the node = `out` · voltage of the capacitor − `back` · voltage of the node
        out = series * lost / rate
        back = series * length * (1 - level) + level * out
        return level, list(zip(lost, out / back.sum(axis=1, keepdims=True), strict=True))

    def _find_steps(self, width_us: float, count: int, growth: float, late: float) -> _Steps:
        share = np.append(growth ** np.arange(count, dtype=np.float64), 0)
        length = share * (width_us * 1e-6 / share.sum())
        spent = length[:, None] / (self.parallel_ohm * self.capacitance_f)
        return _Steps(
            length,
            np.exp(-spent),
            -self.parallel_ohm * np.expm1(-spent),
            np.exp(-late * spent),
            1 / (self.series_ohm - self.parallel_ohm * np.expm1(-late * spent)),
        )

    def _delivered(
        self,
        charge_pc: NDArray[np.float64],
        volts: NDArray[np.float64],
        width_us: float,
        asked_ua: NDArray[np.float64],
    ) -> Delivered:
        cathodes, anodes = volts[asked_ua > 0], volts[asked_ua < 0]
        source_v = float(cathodes.max() - anodes.min()) if len(cathodes) and len(anodes) else 0.0
        current = charge_pc / width_us if width_us else np.zeros(self.electrodes)
        return Delivered(current, charge_pc, volts, source_v)


def _balance(current: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return currents that sum to zero: scale down the stronger pole."""
    if not current.sum():
        return current
    cathodic, anodic = np.maximum(current, 0), np.maximum(-current, 0)
    out, back = float(cathodic.sum()), float(anodic.sum())
    if out == back:
        return current
    total = min(out, back)
    return np.asarray(
        cathodic * (total / out if out else 0) - anodic * (total / back if back else 0)
    )


FORCE_N = 1.0  # default force: enough for the pressure gate to allow full intensity
OPEN_FACTOR = 5e5  # factor that raises the impedance of an open electrode to about 1 GΩ
SHORT_FACTOR = 1e-4  # factor that lowers the impedance of a shorted electrode to a few ohm

FORMS = {
    "lift": "", "touch": "", "force": "NEWTON",
    "open": "ELECTRODE", "short": "ELECTRODE", "emergency": "", "release": "",
}  # fmt: skip


class FingerEvent(NamedTuple):
    """Event of the finger: its time (s), kind, electrode (0 if unused) and force (N)."""

    time_s: float
    kind: str
    electrode: int
    force_n: float


def parse_event(text: str) -> FingerEvent:
    """Parse the text of an event, as described in the docstring of this module."""
    words = text.split()
    kind = "".join(words[1:2])
    if kind not in FORMS:
        known = ", ".join(FORMS)
        raise BoardError(f"event {text!r} is not valid: write a time in s and one of {known}")
    names = ["TIME", *FORMS[kind].split()]
    try:
        numbers = {
            name: int(word) if name == "ELECTRODE" else float(word)
            for name, word in zip(names, [words[0], *words[2:]], strict=True)
        }
    except ValueError:
        form = f"TIME {kind} {FORMS[kind]}".strip()
        raise BoardError(f"event {text!r} has a wrong form: write {form}") from None
    if not all(0 <= number < math.inf for number in numbers.values()):
        raise BoardError(f"event {text!r} is not valid: write finite numbers of at least 0")
    electrode = int(numbers.get("ELECTRODE", 0))
    return FingerEvent(numbers["TIME"], kind, electrode, numbers.get("NEWTON", FORCE_N))


class EmulatedFinger:
    """Finger on the electrodes, with the state of each contact. The docstring of this module
    describes ``events``, which can be in any order."""

    def __init__(self, electrodes: int, events: Iterable[str] = ()) -> None:
        parsed = sorted(parse_event(text) for text in events)
        if beyond := [event.electrode for event in parsed if event.electrode >= electrodes]:
            raise BoardError(
                f"an event names electrode {beyond[0]}, but the board has 0 to {electrodes - 1}"
            )
        self._switched = [event for event in parsed if event.kind in ("emergency", "release")]
        self._due = deque(event for event in parsed if event not in self._switched)
        self._touches, self._pressure_n = True, FORCE_N
        self._factor = np.ones(electrodes)  # (E,): factor by which events multiply R_s and R_p

    @property
    def force_n(self) -> float:
        """Force of the finger at present, N; 0 while it is lifted."""
        return self._pressure_n if self._touches else 0.0

    def opens_switch(self, now_s: float) -> bool:
        """Return whether the emergency switch is open."""
        before = [event.kind for event in self._switched if event.time_s <= now_s]
        return before[-1:] == ["emergency"]

    def at(self, now_s: float, skin: SkinCircuit) -> None:
        """Apply all due events to the skin; ``now_s`` must not decrease between calls."""
        due = len(self._due)
        while self._due and self._due[0].time_s <= now_s:
            event = self._due.popleft()
            if event.kind == "force":
                self._pressure_n = event.force_n
            elif event.kind in ("lift", "touch"):
                self._touches = event.kind == "touch"
            else:
                self._factor[event.electrode] = (
                    OPEN_FACTOR if event.kind == "open" else SHORT_FACTOR
                )
        if len(self._due) < due:
            factor = self._factor if self._touches else 0 * self._factor + OPEN_FACTOR
            # A short circuit does not change the capacitance.
            skin.scale(factor, 1 / np.maximum(factor, 1))
