"""What conducts below the dermis: polarity and letters, from fat alone to no border at all.

``python examples/studies/below_the_skin.py 20`` takes twenty fingers of each anatomy, and prints
medians with the middle 90 % of the fingers.
"""

import sys
from itertools import product
from pathlib import Path
from statistics import fmean

import numpy as np

sys.path.append(str(Path(__file__).parents[1]))
from studies.finger_effects import against_all, inner_sites, spread

from smarttouch.base.afferent import Afferent
from smarttouch.base.terminal import print_table
from smarttouch.experiments.study_plan import Grid, rows_of_finger
from smarttouch.lab import Study
from smarttouch.physiology.anatomy import Anatomy, load_anatomy
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.spikes import SpikeModel
from smarttouch.profile import Profile

BELOW_S_PER_M = (0.022, 0.05, 0.1, 0.2, 0.43)


def with_below(name: str, conductivity: float) -> Anatomy:
    """Return a layered anatomy with a conductivity between dermis and bone."""
    anatomy = load_anatomy(f"{name}-layered")
    layers = list(anatomy.layers)
    layers[2] = layers[2].model_copy(update={"conductivity_s_per_m": conductivity})
    return anatomy.model_copy(update={"layers": tuple(layers)})


def first_ma(finger: Finger, cathodic: bool) -> float:
    """Return the median over inner electrodes of the current of one against all others at which
    the first RA fires, mA."""
    profile = finger.profile
    current_ma = against_all(profile, cathodic)[inner_sites(profile)]
    width_us = np.full(len(current_ma), profile.pulse.width_us)
    drive = SpikeModel(finger).drive(1000 * current_ma, width_us)
    return float(np.median(1 / drive[finger.classes == Afferent.RA].max(axis=0)))


def polarity(profile: Profile, anatomy: Anatomy, fingers: int) -> str:
    """Return RA's cathodic over anodic threshold over fingers, in words."""
    every = [Finger(profile, seed, anatomy) for seed in range(1, fingers + 1)]
    return spread((first_ma(each, True) / first_ma(each, False) for each in every), 2)


def main(fingers: int) -> None:
    """Print a row for each anatomy and conductivity."""
    study = Study(title="x", modes=("RA", "SAI"), levels=("own",))
    grid = Grid(study, Path())
    (shown,), (profile,) = ([grid.shown(each) for each in grid.profiles], grid.profiles.values())
    lines = []
    for name in ("paper", "branched"):
        cases = {f"{each:g}": with_below(name, each) for each in BELOW_S_PER_M}
        for below, anatomy in {"half space": load_anatomy(name), **cases}.items():
            line = [name, below, polarity(profile, anatomy, fingers)]
            every = [
                rows_of_finger(profile, anatomy, name, seed, shown)
                for seed in range(1, fingers + 1)
            ]
            for mode, figure in product(study.modes, ("error", "wrong_class")):
                means = (
                    fmean(getattr(row, figure) for row in rows if row.mode == mode)
                    for rows in every
                )
                line.append(spread(means, 2))
            lines.append(line)
    heading = ["anatomy", "below, S/m", "cathodic / anodic", "RA errors", "wrong", "SAI errors"]
    print_table(lines, [*heading, "wrong"], left=2)


if __name__ == "__main__":
    main(int(sys.argv[1]))
