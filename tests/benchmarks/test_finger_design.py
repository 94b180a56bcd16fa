"""Growth of a design on fingers with their number, and what fingers not designed on get of it.

``pytest tests/benchmarks/test_finger_design.py --benchmark-only -n0``; times are of the processor.
"""

import time

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.finger_design import FingerDesign, FingerSample
from smarttouch.kernels.finger_kernels import FIRST_SEED
from smarttouch.physiology.finger import Finger

SITES = np.array([27, 18])
MIRROR = np.arange(64).reshape(8, 8)[:, ::-1].ravel()


@pytest.mark.parametrize("fingers", [10, 30, 100])
def test_design_grows_with_fingers(row, quick, profile, bank, fingers):
    if quick and fingers > 10:
        pytest.skip("quick: one finger stands for ten")
    count, judges = (1, 1) if quick else (fingers, 30)
    start_ma = np.asarray(bank.kernels(Afferent.SAI) * profile.full_ma[:, None], np.float64)
    most_ma = float(np.abs(start_ma).sum(axis=1).max() / 2)
    began = time.process_time()
    sample = drawn(profile, FIRST_SEED, count, most_ma)
    drawn_s = time.process_time() - began
    design = FingerDesign(profile, Afferent.SAI, sample, start_ma, MIRROR)
    current_ma = design.designed(SITES)
    designed_s = time.process_time() - began - drawn_s
    assert np.abs(current_ma.sum(axis=1)).max() < 1e-6
    judged = drawn(profile, 1, judges, most_ma)
    wrong, silent = zip(
        *(felt(profile, judged, each) for each in (start_ma[SITES], current_ma)), strict=True
    )
    row(
        "Designed on fingers, judged on others",
        {
            "fingers": count,
            "nodes": len(sample.rows),
            "rows of a site": round(np.mean(list(design.rows.values()))),
            "drawn, s": f"{drawn_s:.1f}",
            "designed, s": f"{designed_s:.1f}",
            "wrong, before": f"{wrong[0]:.3f}",
            "wrong": f"{wrong[1]:.3f}",
            "silent, before": f"{silent[0]:.3f}",
            "silent": f"{silent[1]:.3f}",
        },
    )


def drawn(profile, first, count, most_ma):
    fingers = [Finger(profile, first + index, "paper") for index in range(count)]
    return FingerSample.of(fingers, float(profile.full_ma.max()), most_ma)


def felt(profile, sample, current_ma):
    """Return the part of other classes, and of silent points, where each site fires alone."""
    fires = sample.drives(current_ma)[0] >= 1
    own = sample.classes == Afferent.SAI
    place_mm = profile.electrodes.position_mm[SITES]
    away_mm = np.linalg.norm(sample.receptor_mm[:, None] - place_mm, axis=2)
    right = fires & own[:, None] & (away_mm <= profile.electrodes.pitch_mm / 2)
    silent = [~right[sample.finger == index].any(axis=0) for index in range(sample.fingers)]
    return 1 - fires[own].sum() / fires.sum(), np.mean(silent)
