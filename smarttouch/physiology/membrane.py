"""Thresholds of a myelinated fiber, by an active membrane at every node.

The nodes carry the CRRSS membrane (rabbit node at 37 °C: Chiu, Ritchie,
Rogart & Stagg 1979, as put by Sweeney, Mortimer & Durand 1987 and Rattay
1990). Myelin is a perfect insulator and the axon joins node to node as a
resistor (McNeal 1976). Membrane potentials are relative to rest.
"""

import json
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from smarttouch.base.errors import DesignError

Array = NDArray[np.float64]

_NODE_UF_PER_CM2 = 2.5
_SODIUM_PER_US = 1445.0 / _NODE_UF_PER_CM2 / 1000  # mS/cm², over µF/cm² 1/ms
_LEAK_PER_US = 128.0 / _NODE_UF_PER_CM2 / 1000
_SODIUM_MV = 115.0
_AXOPLASM_OHM_CM = 54.7  # Sweeney et al. 1987
_BARE_UF_PER_CM2, _BARE_MS_PER_CM2 = 1.0, 1.0  # unmyelinated membrane, the textbook figures
_RATES_HOLD_MV = 200.0  # the gates are long saturated there, and exp() does not overflow

_PADDING = 12  # nodes beyond the last one given
_WATCHED = -5  # the padding node that must fire
_FIRED_MV = 80.0
_QUIET_MV = 10.0  # below it sodium cannot outweigh the leak, even with every h gate open,
_SETTLED_US = 100.0  # once the m gates have followed (12 µs)
_FLOOR_MA, _CEILING_MA = 1e-4, 1000.0
_ROUNDS = (71, 17, 17)  # candidates, down to 0.1 %; many at first, as a cathode also blocks:
# a fiber may fire only between its threshold and three times that
_PATIENCE_US = 20_000.0  # after the pulse; an action potential passes a node in about 10


@dataclass(frozen=True)
class Fiber:
    """Myelinated fiber whose first node is its ending in the skin.

    A first node that is "passive" is the bare terminal of the receptor, sealed, with leak and
    capacitance and no sodium channels; "active" is a sealed full node; "through" is an ordinary
    node of a fiber that runs on, so that the cut has no effect.
    """

    diameter_um: float = 3.3  # outer; 3.3 ± 0.5 at the fingertip (Nolano et al. 2003)
    # 0.079 ± 0.014 at the fingertip (the same), 100 outer diameters in nerve trunks (McNeal 1976)
    internode_mm: float = 0.079
    axon_ratio: float = 0.6  # axon over fiber diameter (Sweeney et al. 1987)
    node_um: float = 1.5  # length of a node (Sweeney et al. 1987)
    end: Literal["passive", "active", "through"] = "passive"
    # Membrane of a passive terminal, of 1 µF/cm² and 1 mS/cm². An estimate: half a millimeter of
    # neurite 2 µm thick, coiled in a corpuscle some 100 µm long and 60 µm wide. It decides which
    # polarity fires a fiber that rises to its ending: with the defaults, a 200 µs pulse and 0.7 mm
    # of depth the cathode has the lower threshold below about 1250 µm².
    terminal_um2: float = 3000.0

    def __post_init__(self) -> None:
        sizes = (self.diameter_um, self.internode_mm, self.node_um, self.terminal_um2)
        if min(sizes) <= 0 or not 0 < self.axon_ratio <= 1:
            raise ValueError(f"every size of a fiber must be positive and axon_ratio ≤ 1: {self}")
        if self.end not in ("passive", "active", "through"):
            raise ValueError(f"end is {self.end!r}: not passive, active or through")

    @property
    def coupling_per_us(self) -> float:
        """Axial conductance between nodes over the capacitance of one, d / (4 ρ L c l), 1/µs."""
        axon_over_node = self.diameter_um * self.axon_ratio / self.node_um
        return axon_over_node / (4 * _AXOPLASM_OHM_CM * self.internode_mm * 0.1 * _NODE_UF_PER_CM2)


class Axon:
    """Fiber in one field or in several, ready to be stepped in time under many currents at once.

    A step is split (Strang): half of it for the membranes, all of it for axial current, half of it
    for the membranes again; each part is exact, with gates half a step ahead. Beyond the last node
    given the fiber goes on where the field bends no more. Arguments are those of `threshold_ma`;
    potentials may be (C, N), of C fields. `push`, (P,) or (C, P) mV, is the effect of a step of 1
    mA at each of P padded nodes.
    """

    def __init__(self, potential_mv_per_ma: ArrayLike, fiber: Fiber, step_us: float) -> None:
        potential = np.asarray(potential_mv_per_ma, np.float64)
        nodes = potential.shape[-1] if potential.ndim else 0
        if potential.ndim not in (1, 2) or nodes < 2 or not np.isfinite(potential).all():
            raise ValueError("potentials must be finite, one for each of at least two nodes")
        count = nodes + _PADDING
        slope = np.diff(potential)
        before = slope[..., :1] if fiber.end == "through" else 0 * slope[..., :1]
        field = np.zeros((*potential.shape[:-1], count))
        field[..., :nodes] = np.diff(slope, prepend=before, append=slope[..., -1:])

        self._leak = self.passive_parts(fiber, count)[1]
        self._sodium = np.full(count, _SODIUM_PER_US)
        if fiber.end == "passive":
            self._sodium[0] = 0.0
        over_step = _over_step(fiber, count, step_us)
        self._spread = over_step[:count, :count].T.copy()
        self.push: NDArray[np.float64] = field @ over_step[:count, count:].T

        self._gates_at_rest = _gates(np.zeros(1))[1]
        m, h = self._gates_at_rest[:, 0]
        # Sweeney's −0.01 mV is this figure rounded: the leak that makes 0 mV the resting state.
        self._leak_current = -self._sodium * m * m * h * _SODIUM_MV
        self.step_us = step_us

    @staticmethod
    def passive_parts(fiber: Fiber, count: int) -> tuple[Array, Array]:
        """Return axial coupling (P, 2P) of potentials and of field, and leaks (P,), 1/µs."""
        coupling = np.eye(count, k=1) + np.eye(count, k=-1)
        coupling -= np.diag(coupling.sum(axis=1))
        axial = fiber.coupling_per_us * np.column_stack([coupling, np.eye(count)])
        leak = np.full(count, _LEAK_PER_US)
        if fiber.end == "passive":
            node_um2 = np.pi * fiber.diameter_um * fiber.axon_ratio * fiber.node_um
            axial[0] *= node_um2 * _NODE_UF_PER_CM2 / (fiber.terminal_um2 * _BARE_UF_PER_CM2)
            leak[0] = _BARE_MS_PER_CM2 / _BARE_UF_PER_CM2 / 1000
        return axial, leak

    def rest(self, count: int) -> tuple[Array, Array]:
        """Return potentials (A, P) in mV and gates m and h (2, A, P) at rest, P padded nodes."""
        size = (count, self._sodium.size)
        gates = np.broadcast_to(self._gates_at_rest[:, :, None], (2, *size))
        return np.zeros(size), gates.copy()

    def advance(self, state: tuple[Array, Array], driven_mv: Array | None) -> tuple[Array, Array]:
        """Return the state after one step, driven by (A, P) mV, currents times `push`, or not."""
        v, gates = state
        rate, target = _gates(v)
        rate *= -self.step_us
        gates = target + (gates - target) * np.exp(rate, out=rate)
        sodium = self._sodium * gates[0] * gates[0] * gates[1]
        conductance = sodium + self._leak
        target_v = (sodium * _SODIUM_MV + self._leak_current) / conductance
        conductance *= -self.step_us / 2
        decay = np.exp(conductance, out=conductance)
        v = (target_v + (v - target_v) * decay) @ self._spread
        if driven_mv is not None:
            v += driven_mv
        return target_v + (v - target_v) * decay, gates


@lru_cache(maxsize=16)
def _over_step(fiber: Fiber, count: int, step_us: float) -> Array:
    """Return the matrix of one step on potentials and field, (2P, 2P) of P padded nodes."""
    axial = Axon.passive_parts(fiber, count)[0]
    step_matrix: Array = expm(np.vstack([axial, np.zeros_like(axial)]) * step_us)
    step_matrix.setflags(write=False)
    return step_matrix


def _gates(v: Array) -> tuple[Array, Array]:
    """Return rates (1/µs) and steady values of the gates m and h, stacked first (CRRSS)."""
    held = np.minimum(np.maximum(v, -_RATES_HOLD_MV), _RATES_HOLD_MV)
    opening, closing = np.empty((2, *v.shape)), np.empty((2, *v.shape))
    np.divide(97 + 0.363 * held, 1 + np.exp((31 - held) / 5.3), out=opening[0])
    np.multiply(opening[0], np.exp((23.8 - held) / 4.17), out=closing[0])
    np.divide(15.6, 1 + np.exp((24 - held) / 10), out=closing[1])
    np.multiply(closing[1], np.exp((5.5 - held) / 5), out=opening[1])
    rate = opening + closing
    opening /= rate
    rate /= 1000
    return rate, opening


def threshold_ma(
    potential_mv_per_ma: ArrayLike,
    fiber: Fiber,
    width_us: float = 200.0,
    *,
    cathodic: bool,
    step_us: float = 2.0,
) -> float:
    """Return the smallest current, mA, of a rectangular pulse that fires a fiber, within 0.1 %.

    Potentials (N,), mV per mA of cathodic current, are outside the nodes, ending first; they should
    have faded, or bend no more, at the last. A fiber fires if it sends an action potential out of
    the field: a node beyond the last one given crosses 80 mV. A threshold outside 0.0001 to 1000 mA
    is a DesignError.
    """
    steps = max(1, int(np.ceil(width_us / step_us - 1e-9)))
    axon = Axon(potential_mv_per_ma, fiber, width_us / steps)
    low, high = _FLOOR_MA, _CEILING_MA
    for count in _ROUNDS:
        candidates = np.geomspace(low, high, count)
        signed = candidates if cathodic else -candidates
        fired = _fires(axon, signed[:, None] * axon.push, steps)
        first = int(fired.argmax()) if fired.any() else count
        if not 0 < first < count:
            polarity = "cathodic" if cathodic else "anodic"
            raise DesignError(
                f"no {polarity} threshold from {_FLOOR_MA:g} to "
                f"{_CEILING_MA:g} mA with a {width_us:g} µs pulse: check the fiber's depth and "
                f"internode ({fiber.internode_mm:g} mm), and that potentials are in mV per mA"
            )
        low, high = float(candidates[first - 1]), float(candidates[first])
    return high


def _fires(axon: Axon, driven_mv: Array, steps: int) -> NDArray[np.bool_]:
    """Return whether each of (A, P) drives, held for a number of steps, fires the fiber, (A,)."""
    v, gates = axon.rest(len(driven_mv))
    alive = np.arange(len(driven_mv))
    fires, step = np.zeros(alive.size, np.bool_), 0
    settled, limit = (
        steps + int(duration_us / axon.step_us) for duration_us in (_SETTLED_US, _PATIENCE_US)
    )
    while alive.size and step < limit:
        v, gates = axon.advance((v, gates), driven_mv[alive] if step < steps else None)
        step += 1
        fired = v[:, _WATCHED] > _FIRED_MV
        fires[alive[fired]] = True
        keep = ~fired
        if step > settled:
            keep &= v.max(axis=1) > _QUIET_MV
        if not keep.all():
            v, gates, alive = v[keep], gates[:, keep], alive[keep]
    return fires


def weiss_fit(widths_us: ArrayLike, thresholds_ma: ArrayLike) -> tuple[float, float]:
    """Return rheobase (mA) and chronaxie (µs), I·w = rheobase × (w + chronaxie) (Weiss 1901), with
    charges weighted by their relative error."""
    widths = np.asarray(widths_us, np.float64)
    charges = widths * np.asarray(thresholds_ma, np.float64)
    rheobase, least_charge = np.polyfit(widths, charges, 1, w=1 / charges)
    return float(rheobase), float(least_charge / rheobase)


End = Literal["through", "active", "passive"]

_SHIPPED = Path(__file__).with_name("driving.json")

FIBERS = {
    "fingertip": Fiber(terminal_um2=1850.0),
    "trunk": Fiber(diameter_um=5.7, internode_mm=0.5, terminal_um2=1850.0),
    "mrg": Fiber(diameter_um=5.7, internode_mm=0.5055746, terminal_um2=1850.0),
}
"""Fibers by name: the fingertip's (Nolano et al. 2003) and one of a nerve trunk in our own cable
model, and the MRG model. With 1850 µm² of bare terminal an upright fiber at 0.7 mm needs 1.38
times as much cathodic as anodic current; macaque RA afferents 1.3 to 1.5 (Kaczmarek 2000)."""


@dataclass(frozen=True, eq=False)
class DrivingFunction:
    """Weights that make a fiber's drive from potentials along it."""

    internode_mm: float
    end: End  # kind of the first node, as in `membrane.Fiber`
    along: Array  # (K + 1,) 1/mV, of a node and its K neighbors to either side
    near_end: Array  # (H, L) 1/mV, of the first H nodes that can fire; (0, 0) if it runs through
    # Drive of opposite sign that blocks a passing spike, over that of the node that fires: anodes
    # of long pulses do so. Infinite where none do.
    block: float = np.inf

    def drive(self, potential_mv: Array) -> Array:
        """Return the drive, (C, M, E), 1 at threshold, of potentials (C, N, E), ending first."""
        return self.operator(potential_mv.shape[-2]) @ potential_mv

    def highest(self, potential_mv: Array) -> Array:
        """Return the largest drive (C,) of a node whose spike gets out, by potentials (C, N).

        A spike blocked on its way toward the last node does not count; 0 if all are.
        """
        drive = self.drive(potential_mv[..., None])[..., 0]
        return np.asarray(np.where(passes(drive, self.block), drive, 0.0).max(axis=1))

    def operator(self, nodes: int) -> Array:
        """Return the drive as a matrix on the potentials of a number of nodes, (M, N) 1/mV."""
        bend = bend_operator(self.end, nodes)
        first = self.end == "passive"
        size = len(bend)
        smooth = np.zeros((size, size))
        for away, weight in enumerate(self.along):
            smooth += weight * np.eye(size, k=away)
            if away:
                smooth += weight * np.eye(size, k=-away)
        smooth = smooth[first:]
        for row, weights in zip(smooth, self.near_end, strict=False):
            row[:] = 0
            row[: weights.size] = weights[:size]
        return np.asarray(smooth @ bend)


def passes(drive: Array, block: float) -> NDArray[np.bool_]:
    """Return whether a spike of each node gets past the nodes after it, (C, M)."""
    against = np.maximum.accumulate(-drive[:, ::-1], axis=1)[:, ::-1]
    free = np.ones(drive.shape, np.bool_)
    if np.isfinite(block):
        free[:, :-1] = against[:, 1:] < block * drive[:, :-1]
    return free


def bend_operator(end: End, nodes: int) -> Array:
    """Return second differences along a fiber as a matrix, (B, N), and the first at an ending."""
    bends = np.diff(np.eye(nodes), 2, axis=0)
    if end == "through":
        return bends
    return np.vstack([np.eye(1, nodes, 1) - np.eye(1, nodes), bends])


@cache
def _shipped() -> dict[str, Any]:
    return dict(json.loads(_SHIPPED.read_text()))


def load_driving(fiber: str, end: End, width_us: float) -> DrivingFunction:
    """Return the driving function of one of `FIBERS`, interpolated over the logarithm of pulse
    width; DesignError if there is none."""
    offered = _shipped()
    fitted: dict[str, Any] = offered.get(fiber, {}).get(end, {})
    if not fitted:
        names = tuple(
            f"{name}, {ending_name}" for name, ends in offered.items() for ending_name in ends
        )
        raise DesignError(
            f"no driving function of a {fiber!r} fiber with ending {end!r}: there are those of "
            f"{'; '.join(names)}"
        )
    widths = sorted(float(width) for width in fitted)
    if not widths[0] <= width_us <= widths[-1]:
        raise DesignError(
            f"a pulse of {width_us:g} µs is outside the fitted widths of {widths[0]:g} to "
            f"{widths[-1]:g} µs: choose one within"
        )
    weights = {
        part: np.array([fitted[f"{width:g}"][part] for width in widths])
        for part in ("along", "near_end")
    }
    weights["passing"] = np.array(
        [1 / (fitted[f"{width:g}"].get("block") or np.inf) for width in widths]
    )
    at = float(np.interp(np.log(width_us), np.log(widths), np.arange(len(widths))))
    below = min(int(at), len(widths) - 2)
    along, near_end, passing = (
        (below + 1 - at) * weights[part][below] + (at - below) * weights[part][below + 1]
        for part in ("along", "near_end", "passing")
    )
    block = 1 / float(passing) if passing else np.inf
    return DrivingFunction(FIBERS[fiber].internode_mm, end, along, near_end, block)
