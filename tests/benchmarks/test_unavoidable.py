"""Part of the points at which no currents fire what they should without driving others as far.

``pytest tests/benchmarks/test_unavoidable.py --benchmark-only -n0`` prints it for several levels of
that drive, each with a proof or with currents that show the opposite.
"""

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.finger_design import FingerSample
from smarttouch.physiology.finger import Finger

from ..reference.unavoidable import Limits, spared

SITES = (27, 18, 0)
LEVELS = (1.0, 0.5)


@pytest.mark.parametrize(("anatomy", "judged", "together"), [
    ("paper", 4, 1), ("paper", 1, 3), ("branched", 2, 1),
])  # fmt: skip
@pytest.mark.parametrize("afferent", [Afferent.RA, Afferent.SAI])
def test_what_no_currents_spare(row, quick, profile, afferent, anatomy, judged, together):
    limits = Limits(profile.limits.current_ma, profile.limits.total_ma)
    if quick and (anatomy, together) != ("paper", 1):
        pytest.skip("quick: one finger of the paper's anatomy")
    fingers, sites, levels = (1, SITES[:1], LEVELS[:1]) if quick else (judged, SITES, LEVELS)
    unavoidable, points = dict.fromkeys(levels, 0), 0
    for first in range(fingers):
        # One pattern of currents is to spare the axons of all of these.
        seeds = range(1 + first * together, 1 + (first + 1) * together)
        sample = FingerSample.of([Finger(profile, seed, anatomy) for seed in seeds])
        rows = sample.rows
        owner = np.repeat(
            np.arange(len(sample.starts)), np.diff(np.append(sample.starts, len(rows)))
        )
        for site in sites:
            place_mm = profile.electrodes.position_mm[site]
            away_mm = np.linalg.norm(sample.receptor_mm - place_mm, axis=1)
            own = sample.classes == afferent
            near = own & (away_mm <= profile.electrodes.pitch_mm / 2) & (sample.finger == 0)
            amiss = ~own | (away_mm > profile.electrodes.pitch_mm)
            targets, passing = (np.flatnonzero(each[owner]) for each in (near, amiss))
            if not (limits.most(rows[targets]) >= 1).any():
                continue
            points += 1
            for level in levels:
                current_ma, proofs = spared(rows, targets, passing, limits, level)
                if current_ma is not None:
                    assert limits.allow(current_ma)
                    assert (rows[targets] @ current_ma).max() >= 1 - 1e-4
                    assert (rows[passing] @ current_ma).max() <= level + 1e-4
                    continue
                assert proofs
                assert all(proof.bound(rows, limits) >= level for proof in proofs)
                unavoidable[level] += 1
    assert points
    row(
        "Points at which something amiss is driven to a level, whichever the currents",
        {
            "anatomy": anatomy,
            "class": afferent.name,
            "fingers spared": together,
            "points": points,
            **{f"{level:g}": unavoidable[level] for level in levels},
        },
    )
