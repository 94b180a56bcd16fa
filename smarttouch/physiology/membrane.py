"""Thresholds of a myelinated fiber with an active membrane at every node.

Nodes have the CRRSS membrane (rabbit node at 37 °C: Chiu, Ritchie, Rogart & Stagg 1979, as
formulated by Sweeney, Mortimer & Durand 1987 and Rattay 1990). Myelin insulates perfectly, and the
axon between nodes is a resistor (McNeal 1976). Membrane potentials are relative to rest.
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
_SODIUM_PER_US = 1445.0 / _NODE_UF_PER_CM2 / 1000  # conductance per capacitance, 1/µs
_LEAK_PER_US = 128.0 / _NODE_UF_PER_CM2 / 1000
_SODIUM_MV = 115.0
_AXOPLASM_OHM_CM = 54.7  # Sweeney et al. 1987
_BARE_UF_PER_CM2, _BARE_MS_PER_CM2 = 1.0, 1.0  # unmyelinated membrane, textbook values
_RATES_HOLD_MV = 200.0  # gate rates use potentials clipped to ± this value, where gates saturate

_PADDING = 12  # nodes added beyond the last one
_WATCHED = -5  # index of the padding node whose spike shows that the fiber has fired
_FIRED_MV = 80.0
# A fiber below 10 mV cannot fire any more once the m gates have settled (12 µs): its leak current
# exceeds the sodium current, even with all h gates open.
_QUIET_MV, _SETTLED_US = 10.0, 100.0
_FLOOR_MA, _CEILING_MA = 1e-4, 1000.0
# Number of currents tried in each round. The last round finds the threshold within 0.1 %. The first
# round tries many currents, because strong cathodic currents block spikes: some fibers do not fire
# above three times their threshold.
_ROUNDS = (71, 17, 17)
_PATIENCE_US = 20_000.0  # longest simulated time after a pulse; a spike takes 10 µs per node


@dataclass(frozen=True)
class Fiber:
    """Myelinated fiber whose first node is its ending in the skin.

    A "passive" ending is the sealed bare terminal in the receptor, with leak and capacitance but
    without sodium channels. An "active" ending is a sealed complete node. "through" is an ordinary
    node of a fiber that continues.
    """

    diameter_um: float = 3.3  # outer; 3.3 ± 0.5 at the fingertip (Nolano et al. 2003)
    # Distance between nodes: 0.079 ± 0.014 mm at the fingertip (Nolano et al. 2003), 100 diameters
    # in nerve trunks (McNeal 1976)
    internode_mm: float = 0.079
    axon_ratio: float = 0.6  # axon diameter relative to fiber diameter (Sweeney et al. 1987)
    node_um: float = 1.5  # length of a node (Sweeney et al. 1987)
    end: Literal["passive", "active", "through"] = "passive"
    # Membrane area of a passive terminal, which has 1 µF/cm² and 1 mS/cm². Our estimate: 0.5 mm of
    # neurite 2 µm thick, coiled in a corpuscle about 100 µm long and 60 µm wide. The area decides
    # which pulses fire an upright fiber with less current: for 200 µs and a depth of 0.7 mm,
    # anodic pulses if the area is above about 1250 µm², and cathodic pulses if it is below.
    terminal_um2: float = 3000.0

    def __post_init__(self) -> None:
        sizes = (self.diameter_um, self.internode_mm, self.node_um, self.terminal_um2)
        if min(sizes) <= 0 or not 0 < self.axon_ratio <= 1:
            raise ValueError(f"sizes of a fiber must be positive, and axon_ratio at most 1: {self}")
        if self.end not in ("passive", "active", "through"):
            raise ValueError(f"end {self.end!r} is unknown: choose passive, active or through")

    @property
    def coupling_per_us(self) -> float:
        """Axial conductance between nodes divided by node capacitance: d / (4 ρ L c l), 1/µs."""
        axon_over_node = self.diameter_um * self.axon_ratio / self.node_um
        return axon_over_node / (4 * _AXOPLASM_OHM_CM * self.internode_mm * 0.1 * _NODE_UF_PER_CM2)


class Axon:
    """Simulation of a fiber in one or several fields, with many currents at once.

    A time step has three parts (Strang): half a step of the membranes, a step of axial current,
    half a step of the membranes. Each part is solved exactly. Gates are half a step ahead of
    potentials. The fiber continues beyond the last node, in a field without curvature. Arguments
    are those of `threshold_ma`; for C fields, potentials are (C, N). There are P nodes with the
    padding. `push`, (P,) or (C, P), is what 1 mA adds to their membrane potentials in a step, mV.
    """

    def __init__(self, potential_mv_per_ma: ArrayLike, fiber: Fiber, step_us: float) -> None:
        potential = np.asarray(potential_mv_per_ma, np.float64)
        nodes = potential.shape[-1] if potential.ndim else 0
        if potential.ndim not in (1, 2) or nodes < 2 or not np.isfinite(potential).all():
            raise ValueError("potentials must be finite, and given for two nodes or more")
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
        # This leak current makes the resting potential exactly 0 mV. Sweeney's rounded leak
        # potential, −0.01 mV, would not.
        self._leak_current = -self._sodium * m * m * h * _SODIUM_MV
        self.step_us = step_us

    @staticmethod
    def passive_parts(fiber: Fiber, count: int) -> tuple[Array, Array]:
        """Return axial coupling, (P, 2P), and leaks, (P,), 1/µs. The first P columns of the
        coupling are factors of the potentials, the other P are factors of the field."""
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
        """Return the resting state: potentials (A, P) mV, and gates m and h (2, A, P)."""
        size = (count, self._sodium.size)
        gates = np.broadcast_to(self._gates_at_rest[:, :, None], (2, *size))
        return np.zeros(size), gates.copy()

    def advance(self, state: tuple[Array, Array], driven_mv: Array | None) -> tuple[Array, Array]:
        """Return the state after one step. ``driven_mv``, (A, P), is current times `push`; None
        means no current."""
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
    """Return the matrix, (2P, 2P), that applies a step of axial current to potentials and field."""
    axial = Axon.passive_parts(fiber, count)[0]
    step_matrix: Array = expm(np.vstack([axial, np.zeros_like(axial)]) * step_us)
    step_matrix.setflags(write=False)
    return step_matrix


def _gates(v: Array) -> tuple[Array, Array]:
    """Return rates (1/µs) and steady values of the gates m and h, stacked on axis 0 (CRRSS)."""
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
    """Return the threshold current of a rectangular pulse, mA, within 0.1 %.

    The first argument is the extracellular potential at each node, (N,), mV per mA of cathodic
    current. Node 0 is the ending. At the last nodes the potential should be zero, or linear along
    the fiber. The fiber counts as fired if the membrane potential at a padding node, beyond the
    last given node, exceeds 80 mV. Raises DesignError for thresholds outside 0.0001 to 1000 mA.
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
    """Return which of the drives, (A, P), fire the fiber. A drive lasts ``steps`` time steps."""
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
    """Fit Weiss's law (1901), I·w = rheobase × (w + chronaxie), by least relative squares; return
    rheobase (mA) and chronaxie (µs)."""
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
"""Fibers by name: one at the fingertip (Nolano et al. 2003), one in a nerve trunk, and the one of
the MRG model. With a terminal of 1850 µm², the cathodic threshold of an upright fiber 0.7 mm deep
is 1.38 times the anodic one. In macaque RA afferents, it is 1.3 to 1.5 times (Kaczmarek 2000)."""


@dataclass(frozen=True, eq=False)
class DrivingFunction:
    """Linear function of the potentials along a fiber. It predicts whether the fiber fires."""

    internode_mm: float
    end: End  # kind of ending, as in `Fiber`
    along: Array  # (K + 1,) 1/mV: weight of a node, then of its 1st to Kth neighbors on both sides
    near_end: Array  # (H, L) 1/mV: weights of the first H drives, not `along`; empty for "through"
    # A node stops a passing spike if its hyperpolarizing drive is at least `block` times the drive
    # of the node that fired. `block` is infinite if no node stops spikes.
    block: float = np.inf

    def drive(self, potential_mv: Array) -> Array:
        """Return the drives of M nodes, (C, M, E), for the potentials of N nodes, (C, N, E). The
        first potential is that of the ending. A node fires if its drive is at least 1."""
        return self.operator(potential_mv.shape[-2]) @ potential_mv

    def highest(self, potential_mv: Array) -> Array:
        """Return the largest drive, (C,), of nodes whose spikes reach the last node; 0 if all
        spikes are blocked on the way. Potentials are (C, N)."""
        drive = self.drive(potential_mv[..., None])[..., 0]
        return np.asarray(np.where(passes(drive, self.block), drive, 0.0).max(axis=1))

    def operator(self, nodes: int) -> Array:
        """Return the matrix, (M, N) 1/mV, that converts the potentials of N nodes to M drives."""
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
    """Return whether the spike of each node passes all nodes after it, (C, M)."""
    against = np.maximum.accumulate(-drive[:, ::-1], axis=1)[:, ::-1]
    free = np.ones(drive.shape, np.bool_)
    if np.isfinite(block):
        free[:, :-1] = against[:, 1:] < block * drive[:, :-1]
    return free


def bend_operator(end: End, nodes: int) -> Array:
    """Return the matrix of second differences along a fiber, (B, N). An ending has one neighbor,
    so the row of an ending is a first difference."""
    bends = np.diff(np.eye(nodes), 2, axis=0)
    if end == "through":
        return bends
    return np.vstack([np.eye(1, nodes, 1) - np.eye(1, nodes), bends])


@cache
def _shipped() -> dict[str, Any]:
    return dict(json.loads(_SHIPPED.read_text()))


def load_driving(fiber: str, end: End, width_us: float) -> DrivingFunction:
    """Return the driving function of one of `FIBERS`, interpolated over the logarithm of the pulse
    width. Raises DesignError if the fiber, the ending or the width was not fitted."""
    offered = _shipped()
    fitted: dict[str, Any] = offered.get(fiber, {}).get(end, {})
    if not fitted:
        names = tuple(
            f"{name}, {ending_name}" for name, ends in offered.items() for ending_name in ends
        )
        raise DesignError(
            f"there is no driving function of a {fiber!r} fiber with ending {end!r}: choose one of "
            f"{'; '.join(names)}"
        )
    widths = sorted(float(width) for width in fitted)
    if not widths[0] <= width_us <= widths[-1]:
        raise DesignError(
            f"a pulse of {width_us:g} µs is outside the fitted widths of {widths[0]:g} to "
            f"{widths[-1]:g} µs: choose a width in this range"
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
