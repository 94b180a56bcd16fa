"""Levels found by simulated people with lapses: the study in short."""

import numpy as np
from studies.reading_levels import ReadFinger, level_rows, read_finger, table

from smarttouch.experiments.calibration.level_procedure import LEVELS
from smarttouch.reading.letter_shapes import ALPHABET


def test_a_finger_reads_more_the_stronger_and_its_level_is_found(profile):
    finger = read_finger(profile, "paper", 102, placements=1)
    assert (np.diff(finger.errors) <= 0.05).all()
    assert finger.errors[0] > 0.9
    assert finger.errors[-1] < 0.1
    anodic_ma, cathodic_ma = np.median(finger.first_ma, axis=1)
    assert cathodic_ma < anodic_ma
    (row,) = level_rows(profile, [finger])
    assert row.lost <= 0.04
    assert row.answers <= 60


def made(anatomy, seed, anodic_ma, cathodic_ma, best):
    """Return a finger that reads all at its best level and three above, and otherwise less."""
    at = int(np.flatnonzero(best == LEVELS)[0])
    read = ["." * 26] * (at - 1) + [ALPHABET[:13] + "." * 13] + [ALPHABET] * 4
    read += [ALPHABET[:20] + "." * 6] * (len(LEVELS) - len(read))
    first_ma = [[anodic_ma] * 16, [cathodic_ma] * 16]
    return ReadFinger(anatomy, seed, first_ma, [read[: len(LEVELS)]])


def test_people_with_lapses_end_near_their_best_level(profile):
    fingers = [made("branched", seed, 0.62, 0.84, 0.4) for seed in range(5)]
    fingers += [made("paper", seed, 1.7, 1.2, 1.0) for seed in range(5)]
    rows = level_rows(profile, fingers)
    assert sum(row.lost <= 0.03 for row in rows) >= 9
    assert sum(row.said == row.anatomy for row in rows) >= 9
    assert len(list(table(rows))) == 4
