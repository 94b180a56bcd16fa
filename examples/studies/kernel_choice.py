"""Which kernels fire their own class alone, in whom, and after the finger has moved.

``python examples/studies/kernel_choice.py 40 kernels.npz`` makes the tables of
``docs/validation/kernels.md`` on 40 fingers of each anatomy that no kernel was designed on. Kernels
designed on fingers are kept in the file.
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

sys.path.append(str(Path(__file__).parents[1]))
from studies.finger_effects import against_all, inner_sites
from studies.published import ANATOMIES, interval
from studies.reading_levels import placed

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.kernels.bank import kernels_at_nodes, load_bank
from smarttouch.kernels.design_problem import Problem
from smarttouch.kernels.finger_kernels import FingerKernels
from smarttouch.kernels.weighted_design import design_kernel
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.spikes import SlotCurrents, SpikeModel
from smarttouch.profile import Profile, load_profile
from smarttouch.profile.device import FINGER_PAD
from smarttouch.reading.letter_responses import (
    letter_sequences,
    letter_templates,
    spikes_and_letter,
)
from smarttouch.reading.letter_shapes import ALPHABET

Array = NDArray[np.float64]
Kernels = dict[str, dict[Afferent, Array]]
"""Currents of each site at full comfort, (S, E) mA, by kind and class."""

LEVELS = np.arange(0.1, 1.01, 0.05)
MOVED_MM, OFF = 0.25, 0.1
"""How far a finger slides, and how far off its current is, each way."""
TRIES, FEW_LEVELS = 10, np.array([0.3, 0.45, 0.6, 0.8, 1.0])
"""Answers of a person at a site, and levels to pick from."""
CLASSES = (Afferent.RA, Afferent.SAI)
LETTER_LEVELS = (0.7, 1.0)
_WHOLE = "both, all sites"
DESIGNED_ON = {"on paper": ("paper",), "on branched": ("branched",), "on both": ANATOMIES}


def kernels_offered(profile: Profile, sites: Sequence[int], count: int) -> Kernels:
    """Return all kinds of kernels that the package offers for a board of weighted sources;
    ``count`` fingers are designed on."""
    full_ma, bank, at = profile.full_ma, load_bank(profile), np.array(sites)
    offered = {"nodes": {}, "one against all": {}, "nodes in layers": {}}
    for each in Afferent:
        disc = against_all(profile, each is not Afferent.RA)
        offered["nodes"][each] = bank.kernels(each)[at] * full_ma[at, None]
        offered["one against all"][each] = disc[at] * full_ma[at, None]
    layers = {"medium": "layered", "layers": FINGER_PAD, "conductivity_s_per_m": None}
    in_layers = profile.model_copy(update={"skin": profile.skin.model_copy(update=layers)})
    for each in CLASSES:
        problem = Problem(in_layers, each)
        own = np.array([design_kernel(problem, site).peak_normalized for site in sites])
        offered["nodes in layers"][each] = own * full_ma[at, None]
    for name, anatomies in DESIGNED_ON.items():
        design = on_fingers(profile, anatomies, count)
        offered[name] = {
            each: np.array([kernel.weights for kernel, _ in design.kernels(each, sites)])
            * full_ma[at, None]
            for each in CLASSES
        }
    return offered


def on_fingers(profile: Profile, anatomies: Sequence[str], count: int) -> FingerKernels:
    """Return the designer of kernels on ``count`` fingers of some anatomies."""
    aim = {"objective": "finger", "anatomy": anatomies, "fingers": count}
    profile = profile.model_copy(update={"kernels": aim})
    return FingerKernels(profile, kernels_at_nodes(profile))


class Reached(NamedTuple):
    """What one point drives most in a finger, at full comfort."""

    own: Array  # (S,) its class, with a receptor within half a pitch
    other: Array  # (S,) another class

    def alone(self, level: Array) -> NDArray[np.bool_]:
        """Return whether its own class fires, and no other does."""
        return (self.own * level >= 1) & (self.other * level < 1)

    def silent(self, level: Array) -> NDArray[np.bool_]:
        return self.own * level < 1

    def wrong(self, level: Array) -> NDArray[np.bool_]:
        return self.other * level >= 1


def reached(finger: Finger, kernels: Kernels, sites: Sequence[int]) -> dict[str, dict]:
    """Return a `Reached` of each kind and class of kernels on one finger."""
    model, found = SpikeModel(finger), {}
    near = finger.receptor_away_mm[:, sites] <= finger.profile.electrodes.pitch_mm / 2
    for name, by_class in kernels.items():
        found[name] = {}
        for each, current_ma in by_class.items():
            width_us = np.full(len(current_ma), finger.profile.pulse.width_us)
            drive = model.drive(1000 * current_ma, width_us)
            own = (finger.classes == each)[:, None]
            found[name][each] = Reached(
                np.where(own & near, drive, 0).max(axis=0), np.where(own, 0, drive).max(axis=0)
            )
    return found


Fingers = Sequence[tuple[dict, dict, dict]]
"""What is reached in each finger: in place, after it moved, and with layers of skin."""
Judged = Mapping[str, Fingers]


def judged(profile: Profile, kernels: Kernels, sites: Sequence[int], count: int) -> Judged:
    """Return what kernels reach in fingers that none was designed on."""
    found = {}
    for anatomy in ANATOMIES:
        found[anatomy] = []
        for seed in range(1, count + 1):
            finger, angle = Finger(profile, seed, anatomy), seed * np.pi / 2
            moved = placed(finger, MOVED_MM * np.cos(angle), MOVED_MM * np.sin(angle))
            layered = Finger(profile, seed, f"{anatomy}-layered")
            found[anatomy].append(
                tuple(reached(one, kernels, sites) for one in (finger, moved, layered))
            )
    return found


class Share(NamedTuple):
    """Shares of points of one kind of kernels in one anatomy, at its best level."""

    level: float
    # of each finger
    alone: list[float]
    moved: list[float]
    off: list[float]  # alone where all currents are a tenth lower or higher, the worse of both
    layers: list[float]  # alone in skin of layers, at the best level there
    silent: list[float]
    wrong: list[float]

    @property
    def least(self) -> float:
        return float(min(map(np.mean, self[1:5])))


def share_of(fingers: Fingers, name: str, each: Afferent) -> Share:
    """Return the shares of a kind of kernels over fingers, at the level that leaves most alone."""
    still, moved, layered = ([one[index][name][each] for one in fingers] for index in range(3))

    def alone(level: float, where: list[Reached]) -> list[float]:
        return [float(one.alone(level).mean()) for one in where]

    level = max(LEVELS, key=lambda at: np.mean(alone(at, still)))
    off = [alone(level * (1 + sign * OFF), still) for sign in (-1, 1)]
    silent, wrong = (
        [float(getattr(one, what)(level).mean()) for one in still] for what in ("silent", "wrong")
    )
    layers = [alone(at, layered) for at in LEVELS]
    return Share(
        level, alone(level, still), alone(level, moved), min(off, key=np.mean),
        max(layers, key=np.mean), silent, wrong,
    )  # fmt: skip


def choice_rows(found: Judged, kernels: Kernels) -> Iterator[str]:
    """Yield a line for each class and kind of kernels, each anatomy at its own best level."""
    headings = ("alone", "moved", "± 10 %", "layers", "silent", "wrong", "least of all")
    yield f"| class | kernels | anatomy, level | {' | '.join(headings)} |"
    yield "|" + "---|" * 10
    for each in Afferent:
        for name in (one for one in kernels if each in kernels[one]):
            shares = {anatomy: share_of(them, name, each) for anatomy, them in found.items()}
            least = min(one.least for one in shares.values())
            for anatomy, one in shares.items():
                shown = " | ".join(map(_shown, one[1:]))
                last = f"{least:.2f}" if anatomy == ANATOMIES[-1] else ""
                yield (f"| {each.name} | {name} | {anatomy}, {one.level:.2f} | {shown} | {last} |")


def picked_rows(found: Judged, kernels: Kernels) -> Iterator[str]:
    """Yield what is left of a choice of kernels and level at each site once the finger has moved.

    Either that of most margin of all, or the first that is alone of ten tried at random.
    """
    headings = ("nodes", "best kind", "ten tries", "most margin")
    yield f"| class | anatomy | {' | moved | '.join(headings)} | moved |"
    yield "|" + "---|" * 10
    for each in CLASSES:
        names = [name for name in kernels if each in kernels[name]]
        for anatomy, fingers in found.items():
            kinds = {name: share_of(fingers, name, each) for name in names}
            best = max(kinds.values(), key=lambda one: np.mean(one.alone))
            shown = [*(kinds["nodes"][1:3]), *(best[1:3])]
            for tries in (TRIES, None):
                picks = [_picked(*one[:2], names, each, tries) for one in fingers]
                shown += [[one[index] for one in picks] for index in (0, 1)]
            yield f"| {each.name} | {anatomy} | {' | '.join(map(_shown, shown))} |"


def _picked(
    still: dict, moved: dict, names: list[str], each: Afferent, tries: int | None
) -> tuple[float, float]:
    """Return the share of points alone, in place and moved, with kind and level picked in place."""
    where = [np.stack([part[name][each] for name in names], axis=1) for part in (still, moved)]
    levels = (LEVELS if tries is None else FEW_LEVELS)[:, None, None]
    # (own or other, levels and kinds, sites), in place and moved
    own, other = (where[0][part] * levels for part in (0, 1))
    count = len(levels) * len(names)
    alone = [((one[0] * levels >= 1) & (one[1] * levels < 1)).reshape(count, -1) for one in where]
    if tries is None:
        margin = np.minimum(own, 1 / np.maximum(other, 1e-9)).reshape(count, -1)
        pick = margin.argmax(axis=0)
    else:
        order = np.random.default_rng(1).permuted(
            np.tile(np.arange(count), (alone[0].shape[1], 1)), axis=1
        )[:, :tries]
        sites = np.arange(len(order))
        pick = order[sites, np.take_along_axis(alone[0].T, order, axis=1).argmax(axis=1)]
    before, after = (one[pick, np.arange(one.shape[1])].mean() for one in alone)
    return float(before), float(after)


def _shown(values: Sequence[float]) -> str:
    return "{:.2f} ({:.2f}–{:.2f})".format(*interval(values))


def letter_rows(
    profile: Profile, weights: Array, seeds: Sequence[int], letters: str = ALPHABET
) -> Iterator[str]:
    """Yield the share of letters that is read wrongly in SAI mode, from all spikes and from those
    of SAI alone; weights are kernels on fingers, (E, E), parts of full current."""
    bank, known, sai = load_bank(profile), letter_templates(profile), Afferent.SAI
    others = replace(bank, weights=bank.weights | {sai: weights}, absolute=True)
    banks = {"nodes": bank, "on both": others}
    shown = {name: letter_sequences(letters, profile, one, Mode.SAI, "points")
             for name, one in banks.items()}  # fmt: skip
    yield "| kernels, level | paper: all spikes | SAI alone | branched: all spikes | SAI alone |"
    yield "|" + "---|" * 5
    wrong: dict[tuple[str, float], list[list[float]]] = {}
    for anatomy in ANATOMIES:
        models = [SpikeModel(Finger(profile, seed, anatomy), seed) for seed in seeds]
        for name, level in product(banks, LETTER_LEVELS):
            meant, sent = zip(*shown[name].items(), strict=True)
            read = [[_read(one, slots, level, known) for slots, _ in sent] for one in models]
            # (fingers, 2): from all spikes, and from those of SAI
            shares = (np.array(read) != np.array(meant)[:, None]).mean(axis=1)
            wrong.setdefault((name, level), []).extend(shares.T.tolist())
    for (name, level), shares in wrong.items():
        yield f"| {name}, {level:g} | {' | '.join(map(_shown, shares))} |"


def _read(model: SpikeModel, slots: SlotCurrents, level: float, known: Mapping) -> list[str]:
    """Return what is read from all spikes, and from those of SAI alone."""
    drive = np.float32(level) * model.drive(slots.current_ua, slots.width_us)
    own = drive * (model.finger.classes == Afferent.SAI)[:, None]
    return [spikes_and_letter(model, slots, one, known, 2)[1] for one in (drive, own)]


def main(count: int, path: Path) -> None:
    """Print the tables; kernels come from a file if it is there."""
    profile = load_profile("electric-mouse")
    sites = inner_sites(profile)
    if not path.exists():
        made = kernels_offered(profile, sites, 10)
        timed = on_fingers(profile, ANATOMIES, 10).kernels(Afferent.SAI, profile.driven.tolist())
        made[_WHOLE] = {Afferent.SAI: np.array([kernel.weights for kernel, _ in timed])}
        np.savez(path, **{f"{name}/{each.name}": ma
                          for name, own in made.items() for each, ma in own.items()})  # fmt: skip
    kernels: Kernels = {}
    with np.load(path) as stored:
        for key in stored.files:
            name, _, afferent = key.partition("/")
            kernels.setdefault(name, {})[Afferent[afferent]] = stored[key]
    whole = kernels.pop(_WHOLE)[Afferent.SAI]
    found = judged(profile, kernels, sites, count)
    print(*choice_rows(found, kernels), "", *picked_rows(found, kernels), sep="\n")
    print("", *letter_rows(profile, whole, range(1, count + 1)), sep="\n")


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]))
