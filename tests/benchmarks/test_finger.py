"""From slots to the drive of every afferent of a finger, and from a seed to a finger."""

import numpy as np
import pytest

from smarttouch.physiology.anatomy import load_anatomy
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.spikes import SpikeModel

SLOTS = (1, 16, 64)


@pytest.mark.parametrize("anatomy", ["paper", "branched"])
@pytest.mark.parametrize("times", [0.33, 1.3])
def test_a_finger_is_drawn(benchmark, profile, anatomy, times):
    wanted = scaled(anatomy, times)
    benchmark.pedantic(lambda: Finger(profile, 1, wanted).rows, rounds=3)


@pytest.mark.parametrize("slots", SLOTS)
@pytest.mark.parametrize("anatomy", ["paper", "branched"])
@pytest.mark.parametrize("times", [0.33, 1.3, 5.4])
def test_drive_of_a_frame(benchmark, profile, anatomy, times, slots):
    """Some 300, 1,200 and 5,000 afferents."""
    model = SpikeModel(Finger(profile, 1, scaled(anatomy, times)))
    current_ua = np.random.default_rng(1).integers(-2400, 2400, (slots, len(profile.electrodes)))
    benchmark.extra_info["afferents"] = len(model.finger.classes)
    benchmark(model.drive, current_ua, np.full(slots, 200))


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
