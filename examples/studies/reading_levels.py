"""Levels at which fingers read letters best, and what ``calibrate level`` finds of them.

``python examples/studies/reading_levels.py 20 fingers.jsonl`` makes the table of
``docs/validation/finger.md`` on 20 fingers of each anatomy (ten minutes of processor time).
It keeps each finger's letters in the file, and goes on there.
"""

import itertools
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import CalibrationError
from smarttouch.experiments.calibration.level_procedure import LEVELS, LevelProcedure
from smarttouch.experiments.psychophysics.polarity import POLARITY_TRIALS
from smarttouch.experiments.psychophysics.tasks import middle_discs
from smarttouch.kernels.bank import load_bank
from smarttouch.kernels.disc_banks import lone_discs
from smarttouch.physiology.anatomy import load_anatomy
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.spikes import SpikeModel
from smarttouch.profile import Profile, load_profile
from smarttouch.reading.letter_responses import (
    letter_sequences,
    letter_templates,
    spikes_and_letter,
)
from smarttouch.reading.letter_shapes import ALPHABET

ANATOMIES = ("paper", "branched")
GAIN_SPREAD, DEPTH_MM, TURN_DEG, AWAY_MM = 0.2, 0.1, 20.0, 1.0
"""How fingers differ: standard deviation of the logarithm of all thresholds, largest error of
depths, standard deviation of the direction of flat axons, and largest shift of a placement."""
PERIODS = 3
"""Periods of a letter: more change hardly a letter, as one afferent's noise is small."""
SLOPE = 0.1
"""Standard deviation of *felt*, in natural logarithms of current."""


@dataclass(frozen=True)
class ReadFinger:
    """What one finger reads, at each of ten placements."""

    anatomy: str
    seed: int
    # (2, D) mA: thresholds of the tested discs at the first placement, anodic and cathodic
    first_ma: list[list[float]]
    read_as: list[
        list[str]
    ]  # for each placement and level, what the alphabet is read as; . is none

    @property
    def errors(self) -> NDArray[np.float64]:
        """Share of letters read wrongly at each level, (L,), over all placements."""
        truth = np.array([*ALPHABET])
        wrong = [[np.mean(np.array([*line]) != truth) for line in one] for one in self.read_as]
        return np.asarray(np.mean(wrong, axis=0))


def drawn_finger(profile: Profile, anatomy: str, seed: int) -> Finger:
    """Return a finger that differs from the anatomy in gain, depth and direction."""
    random = np.random.default_rng([seed, ANATOMIES.index(anatomy)])
    gain, deeper_mm, turn_deg = (
        float(np.exp(GAIN_SPREAD * random.standard_normal())),
        random.uniform(-DEPTH_MM, DEPTH_MM),
        random.normal(0, TURN_DEG),
    )
    usual = load_anatomy(anatomy)
    own = {}
    for each in Afferent:
        one = usual.of(each)
        changed = {
            "threshold_factor": gain * one.threshold_factor,
            "flat_deg": one.flat_deg + turn_deg,
            "depth_mm": getattr(profile.skin, f"{each.name.lower()}_depth_mm") + deeper_mm,
        }
        own[each.name.lower()] = one.model_copy(update=changed)
    return Finger(profile, seed, usual.model_copy(update=own))


def placed(finger: Finger, right_mm: float, down_mm: float) -> Finger:
    """Return the same finger, elsewhere under the array."""
    other, shift_mm = Finger(finger.profile, finger.seed, finger.anatomy), (right_mm, down_mm)
    for each, one in other.populations.items():
        path_mm = one.axon_path_mm.copy()
        path_mm[..., :2] += shift_mm
        moved = replace(one, receptor_mm=one.receptor_mm + shift_mm, axon_path_mm=path_mm)
        other.populations[each] = moved
    return other


def read_finger(profile: Profile, anatomy: str, seed: int, placements: int = 10) -> ReadFinger:
    """Return the letters that a finger reads in RA mode at each placement and level."""
    bank = load_bank(profile)
    shown, known = letter_sequences(ALPHABET, profile, bank, Mode.RA), letter_templates(profile)
    sites, discs = middle_discs(profile), lone_discs(profile, bank)
    poles = np.concatenate([discs.kernels(each)[sites] for each in (Afferent.PC, Afferent.SAI)])
    finger, random = drawn_finger(profile, anatomy, seed), np.random.default_rng([seed, 7])
    read_as, first_ma = [], np.zeros(0)
    for number in range(placements):
        away = random.uniform(-AWAY_MM, AWAY_MM, 2) * (number > 0)
        model = SpikeModel(placed(finger, *away), seed)
        if not number:
            drive = model.drive(1000 * poles, np.full(len(poles), profile.pulse.width_us))
            first_ma = 1 / np.maximum(drive.max(axis=0), 1e-3)
        lines = [""] * len(LEVELS)
        for slots, _ in shown.values():
            above = model.drive(slots.current_ua, slots.width_us)
            for index, level in enumerate(LEVELS):
                scaled = above * np.float32(level)
                lines[index] += spikes_and_letter(model, slots, scaled, known, PERIODS)[1] or "."
        read_as.append(lines)
    return ReadFinger(anatomy, seed, first_ma.reshape(2, -1).tolist(), read_as)


def calibrated(
    profile: Profile, finger: ReadFinger, lapse: float = 0.1, repeat: int = 0
) -> LevelProcedure:
    """Return the procedure after all answers of a simulated person, at the first placement, of
    which the part ``lapse`` has nothing to do with what was shown."""
    random = np.random.default_rng([finger.seed, 1, repeat])
    procedure = LevelProcedure(profile, seed=finger.seed + 1000 * repeat)
    while not procedure.done:
        shown = procedure.next()
        letter = procedure.letter_of(shown)
        if letter is None:
            disc = shown.repetition % len(finger.first_ma[0])
            away = np.log(shown.comparison / finger.first_ma[shown.index][disc]) / SLOPE
            right = bool(random.standard_normal() < away)
            guessed = bool(random.random() < 0.5)
        else:
            line = finger.read_as[0][int(np.argmin(np.abs(LEVELS - shown.comparison)))]
            right = line[ALPHABET.index(letter)] == letter
            guessed = bool(random.random() < 1 / len(ALPHABET))
        procedure.answer(guessed if random.random() < lapse else right)
    return procedure


@dataclass(frozen=True)
class LevelRow:
    """Share of letters that a finger loses by a level, over its best."""

    anatomy: str
    lost: float  # by the level found
    lost_at_full: float
    said: str  # anatomy that was found
    answers: int


def level_rows(
    profile: Profile, fingers: Sequence[ReadFinger], repeats: int = 1, lapse: float = 0.1
) -> list[LevelRow]:
    """Return what fingers lose after `calibrated` procedures, each with answers of its own."""
    rows = []
    for finger, repeat in itertools.product(fingers, range(repeats)):
        lost = finger.errors - finger.errors.min()
        try:
            found = calibrated(profile, finger, lapse, repeat).found
        except CalibrationError:
            # No level: thresholds seemed beyond the range of the test.
            rows.append(LevelRow(finger.anatomy, 1.0, float(lost[-1]), "", 2 * POLARITY_TRIALS))
            continue
        at = int(np.argmin(np.abs(LEVELS - found.level)))
        rows.append(
            LevelRow(finger.anatomy, float(lost[at]), float(lost[-1]), found.anatomy, found.answers)
        )
    return rows


def table(rows: Sequence[LevelRow]) -> Iterator[str]:
    """Yield a line for each anatomy, as in the documentation."""
    yield "| anatomy | within .03 | lost: median, worst | at full comfort | anatomy | answers |"
    yield "|---|---|---|---|---|---|"
    for anatomy in ANATOMIES:
        mine = [row for row in rows if row.anatomy == anatomy]
        near = sum(row.lost <= 0.03 for row in mine)
        right = sum(row.said == anatomy for row in mine)
        lost, full, answers = (
            sorted(getattr(row, name) for row in mine)
            for name in ("lost", "lost_at_full", "answers")
        )
        yield (
            f"| {anatomy} | {near} of {len(mine)} | {median(lost):.3f}, {lost[-1]:.3f} | "
            f"{median(full):.3f}, {full[-1]:.3f} | {right} right | {answers[0]} to {answers[-1]}, "
            f"median {median(answers):g} |"
        )


def main(count: int, path: Path) -> None:
    """Print the table for fingers from a file, which are added to it as far as they are missing."""
    profile = load_profile("electric-mouse")
    lines = path.read_text().splitlines() if path.exists() else []
    fingers = [ReadFinger(**json.loads(line)) for line in lines]
    known = {(each.anatomy, each.seed) for each in fingers}
    for seed, anatomy in itertools.product(range(_FIRST_SEED, _FIRST_SEED + count), ANATOMIES):
        if (anatomy, seed) not in known:
            fingers.append(read_finger(profile, anatomy, seed))
            with path.open("a") as file:
                file.write(json.dumps(asdict(fingers[-1])) + "\n")
    for repeats in (1, 20):
        print(f"{repeats} times each:", *table(level_rows(profile, fingers, repeats)), sep="\n")


_FIRST_SEED = 101
"""First of the fingers that are judged; those below were what priors were made of."""

if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]))
