"""From slots to the drive of every afferent of a finger.

Processor time, as docs/validation/finger.md has it: ``pytest tests/benchmarks/test_finger.py
--benchmark-only -n0 --benchmark-timer=time.process_time --benchmark-columns=min,median``.
"""

from functools import cache

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.physiology.anatomy import load_anatomy
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.spikes import SpikeModel
from smarttouch.profile import DEFAULT_PROFILE, load_profile

SLOTS = (1, 16, 64)
TIMES = (0.33, 1.3, 5.4)
"""Densities, relative to a finger's: some 300, 1,200 and 5,000 afferents."""


@pytest.mark.parametrize("known", [True, False], ids=["known", "new"])
@pytest.mark.parametrize("slots", SLOTS)
@pytest.mark.parametrize("times", TIMES)
@pytest.mark.parametrize("anatomy", ["paper", "branched"])
def test_drive_of_a_frame(benchmark, quick, bank, anatomy, times, slots, known):
    """Points of an RA frame, each its kernel, again; or sums of two kernels never seen before."""
    if quick and (times, slots) != (TIMES[1], SLOTS[1]):
        pytest.skip("one finger and one frame only")
    model = SpikeModel(a_finger(anatomy, times))
    kernels = 2400 * bank.kernels(Afferent.RA)[:slots]
    benchmark.extra_info["afferents"], benchmark.extra_info["nodes"] = (
        len(each) for each in (model.finger.classes, model.finger.rows[0])
    )
    width, random = np.full(slots, 200), np.random.default_rng(1)

    def frame():
        part = random.uniform(0.7, 1.0, (2, slots, 1))
        other = part[1] * np.roll(kernels, random.integers(1, 63), axis=1)
        slots_ua = kernels if known else part[0] * kernels + other
        return (np.rint(slots_ua), width, True), {}

    model.drive(np.rint(kernels), width, firing=True)
    benchmark.pedantic(model.drive, setup=frame, rounds=20)


@cache
def a_finger(anatomy, times):
    """Return a finger, drawn once."""
    return Finger(load_profile(DEFAULT_PROFILE), 1, scaled(anatomy, times))


def scaled(name, times):
    """Return an anatomy so many times as dense."""
    anatomy = load_anatomy(name)
    denser = {
        each: getattr(anatomy, each).model_copy(
            update={"density_per_cm2": times * getattr(anatomy, each).density_per_cm2}
        )
        for each in ("ra", "sai", "pc")
    }
    return anatomy.model_copy(update=denser)
