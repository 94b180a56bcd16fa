"""Axons that fire whichever the currents: a proof where that is so, currents where it is not.

An afferent fires where the drive D·w of one of its nodes reaches 1. Where node n is driven so far,
by currents w that sum to zero, of at most c each and p in all on one side, some node i of a set is
driven to t at least:

    minimize t  such that  D_i·w ≤ t,  D_n·w ≥ 1,  w allowed

For prices λ ≥ 0 with Σλ = 1 and any α ≥ 0, t ≥ Σλ_i D_i·w ≥ α − (α D_n − Σλ_i D_i)·w: at least α
less the most that allowed currents make of the bracket, which is known without a solver. From 1 on
one of the set fires. The solver only finds prices and currents; nothing it says has to be believed.
Nodes may be of several fingers: then the currents are the same for all of them.
"""

from typing import NamedTuple

import numpy as np
from scipy import optimize

_ROWS_AT_ONCE = 60
_SURE = 1e-5


class Limits(NamedTuple):
    """Currents that are allowed, mA: of an electrode, and of all cathodes."""

    electrode_ma: float
    total_ma: float

    def most(self, rows):
        """Return the most that allowed currents make of each row, (N,)."""
        ranked = np.sort(np.atleast_2d(rows).astype(np.float64), axis=1)
        share = np.clip(
            self.total_ma - self.electrode_ma * np.arange(ranked.shape[1]), 0, self.electrode_ma
        )
        return np.maximum(ranked[:, ::-1] - ranked, 0) @ share

    def allow(self, current_ma):
        """Return whether they allow these currents."""
        cathodes = np.maximum(current_ma, 0).sum()
        return (
            abs(current_ma.sum()) < _SURE
            and np.abs(current_ma).max() <= self.electrode_ma + _SURE
            and cathodes <= self.total_ma + _SURE
        )


class Proof(NamedTuple):
    """Prices of some nodes, and of a target's: how far one of these is driven where that fires."""

    target: int
    nodes: np.ndarray
    price: np.ndarray
    gain: float

    def bound(self, rows, limits):
        """Return to what one of the nodes is driven at least, of the drive of all, (N, E) 1/mA."""
        assert (self.price >= 0).all()
        assert self.gain >= 0
        mixed = (self.price / self.price.sum()) @ rows[self.nodes].astype(np.float64)
        rest = self.gain * rows[self.target].astype(np.float64) - mixed
        return self.gain - float(limits.most(rest)[0])


def spared(rows, targets, passing, limits, level=1.0):
    """Return currents (E,) mA that fire a target and drive nothing that passes to a level, and [].

    Rows (N, E) are the drive of each node for 1 mA at each electrode: 1 is its threshold; targets
    are nodes of which one is to fire. Where there are no such currents: None, and a proof for each
    target that can fire at all.
    """
    strongest = limits.most(rows[targets])
    order = np.argsort(-strongest)
    there = rows[passing]
    pool: list[int] = []
    proofs = []
    for target in targets[order[strongest[order] >= 1]]:
        aim = rows[target].astype(np.float64)
        given = np.array(pool, np.intp)
        while True:
            current, proof = _solved(there, given, passing, aim, int(target), limits)
            drive = there @ current.astype(np.float32)
            if drive.max() < level - _SURE:
                return current, []
            if proof is not None and proof.bound(rows, limits) >= level:
                proofs.append(proof)
                break
            worst = np.argsort(drive)[-_ROWS_AT_ONCE:]
            fresh = np.setdiff1d(worst[drive[worst] >= level - 2 * _SURE], given)
            if not len(fresh):
                # Neither is sure, to the last digits: nothing is proved.
                return current, []
            given = np.concatenate([given, fresh])
        # What mattered here matters for the next node of the same axon.
        pool = given[proof.price > 0].tolist()
    return None, proofs


def _solved(there, given, passing, aim, target, limits):
    """Return the currents for the nodes given, and the proof that its prices are."""
    count, rows = len(aim), there[given].astype(np.float64)
    above = np.vstack(
        [
            np.c_[rows, -rows, -np.ones(len(rows))],
            np.r_[-aim, aim, 0.0],
            np.r_[np.ones(count), np.zeros(count + 1)],
        ]
    )
    limit = np.r_[np.zeros(len(rows)), -1.0, limits.total_ma]
    balance = np.r_[np.ones(count), -np.ones(count), 0.0]
    bounds = [(0, limits.electrode_ma)] * (2 * count) + [(0, None)]
    cost = np.r_[np.full(2 * count, 1e-6), 1.0]
    found = optimize.linprog(cost, above, limit, balance[None], [0.0], bounds, method="highs-ds")
    assert found.x is not None, found.message
    price = np.maximum(-found.ineqlin.marginals, 0)
    proof = Proof(target, passing[given], price[: len(given)], float(price[len(given)]))
    return found.x[:count] - found.x[count : 2 * count], proof if proof.price.sum() else None
