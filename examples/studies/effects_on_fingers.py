"""Effects that the paper describes (Sections III-B and III-C), on simulated fingers.

``python examples/studies/effects_on_fingers.py paper 10`` prints the effects for 10 fingers of an
anatomy, as the median and the range of the middle 90 % of fingers. Two effects depend on our
assumptions. We doubled the threshold of PC to get the paper's order of sensations (III-B.1);
otherwise PC would fire first. The shift of PC depends on the assumed length of its axons.
"""

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.bank import KernelBank, load_bank
from smarttouch.physiology.afferent_anatomy import Anatomy, load_anatomy
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.spikes import SpikeModel, middle_90
from smarttouch.profile import Profile, load_profile
from smarttouch.views.printable_output import print_table

Array = NDArray[np.float64]
Row = tuple[str, str, str]
"""Effect, value in the paper, and value of simulated fingers."""

STAGES_MA = (0.2, 0.4, 0.6, 1.0)
"""Currents of the central line electrode at which sensations changed (Section III-B.1)."""
CLEAR_MA = 2.4
"""Current that was clearly felt on a disc of 1.0 mm (Section III-C)."""
LOWERED = 20.0
"""Factor between real and modeled thresholds. `Finger` omits nodes that fire only above the allowed
current. Lower thresholds keep these nodes; currents are multiplied by this factor afterwards."""


@dataclass(frozen=True)
class Shift:
    """Displacement, from the electrode, of the receptors whose afferents fire, mm."""

    # x_mm, y_mm: means over the afferents that fire; y is negative toward the fingertip
    x_mm: float
    y_mm: float
    away_mm: float  # root mean square distance
    afferents: float  # number of afferents that fire, mean over electrodes and fingers


def fired(finger: Finger, current_ma: Array) -> NDArray[np.bool_]:
    """Return whether each afferent fires in each slot, (A, S), if there is no noise. ``current_ma``
    has a row for each slot."""
    width_us = np.full(len(current_ma), finger.profile.pulse.width_us)
    return np.asarray(SpikeModel(finger).drive(1000 * current_ma, width_us) >= 1)


def kernel_ma(profile: Profile, bank: KernelBank, afferent: Afferent) -> Array:
    """Return the kernel of each site, scaled to 1 mA at the site, (E, E) mA, positive cathodic."""
    kernels = np.asarray(bank.kernels(afferent), np.float64)
    own = np.abs(np.diag(kernels))
    return np.divide(kernels, own[:, None], out=np.zeros_like(kernels), where=own[:, None] > 0)


def against_all(profile: Profile, cathodic: bool) -> Array:
    """Return a pattern for each electrode, (E, E) mA: the electrode carries 1 mA, which flows back
    through all other electrodes."""
    count = len(profile.electrodes)
    pattern = np.full((count, count), -1 / (count - 1))
    np.fill_diagonal(pattern, 1.0)
    return pattern if cathodic else -pattern


def stages(anatomy: str | Anatomy, seeds: Sequence[int]) -> dict[Afferent, Array]:
    """Return, for each class, the SAI-mode currents at which 1, 2, ... 10 afferents fire, (10,) mA.

    Each value is the median over fingers. If a finger has too few afferents that can fire, its
    current is infinite. The array is the paper's eight lines, and axons run across them (Fig. 7).
    """
    profile = load_profile("line-8")
    base = anatomy if isinstance(anatomy, Anatomy) else load_anatomy(anatomy)
    across = {
        each.name.lower(): base.of(each).model_copy(
            update={"flat_deg": 0.0, "threshold_factor": base.of(each).threshold_factor / LOWERED}
        )
        for each in Afferent
    }
    across_lines = base.model_copy(update=across)
    pattern = kernel_ma(profile, load_bank(profile), Afferent.SAI)[3]
    width_us = np.array([profile.pulse.width_us])
    found: dict[Afferent, list[Array]] = {each: [] for each in Afferent}
    for seed in seeds:
        finger = Finger(profile, seed, across_lines)
        drive = SpikeModel(finger).drive(1000 * pattern[None], width_us)[:, 0]
        for each in Afferent:
            highest = np.sort(drive[finger.classes == each])[::-1][:10]
            with np.errstate(divide="ignore"):
                current_ma = LOWERED / np.maximum(highest, 0)
            found[each].append(np.pad(current_ma, (0, 10 - len(highest)), constant_values=np.inf))
    return {each: np.median(rows, axis=0) for each, rows in found.items()}


def shift(
    fingers: Sequence[Finger], current_ma: Array, sites: Sequence[int], classes: Sequence[Afferent]
) -> Shift:
    """Return how far receptors are displaced from the site whose currents fire their afferents.
    Only afferents of the given classes count. ``current_ma``, (E, E), has a row for each site."""
    away, tried = [np.zeros((0, 2))], 0
    for finger in fingers:
        answers = fired(finger, current_ma[list(sites)])
        mine = np.isin(finger.classes, [int(each) for each in classes])
        for column, site in enumerate(sites):
            who = answers[:, column] & mine
            away.append(finger.receptor_mm[who] - finger.profile.electrodes.position_mm[site])
            tried += 1
    all_away = np.concatenate(away)
    if not len(all_away):
        return Shift(np.nan, np.nan, np.nan, 0.0)
    x_mm, y_mm = all_away.mean(axis=0)
    rms = float(np.sqrt((all_away**2).sum(axis=1).mean()))
    return Shift(float(x_mm), float(y_mm), rms, len(all_away) / tried)


def inner_sites(profile: Profile) -> list[int]:
    """Return the electrodes within the central half of an array's width and of its height."""
    reach = np.abs(profile.electrodes.position_mm).max(axis=0) / 2 + 1e-9
    within = (np.abs(profile.electrodes.position_mm) <= reach).all(axis=1)
    return [int(each) for each in np.flatnonzero(within)]


def reached(
    profile: Profile, center_ma: float, anatomy: str | Anatomy, seeds: Sequence[int]
) -> Array:
    """Return how many RA, SAI and PC fire under a concentric electrode, (3,), mean over fingers."""
    pattern = np.array([[center_ma, -center_ma]])
    rows = []
    for seed in seeds:
        finger = Finger(profile, seed, anatomy)
        rows.append(np.bincount(finger.classes[fired(finger, pattern)[:, 0]], minlength=3))
    return np.asarray(np.mean(rows, axis=0))


def effects(
    anatomy: str | Anatomy,
    seeds: Sequence[int],  # seeds of the fingers
) -> list[Row]:
    """Return a table of the paper's effects, with the values of simulated fingers."""
    base = anatomy if isinstance(anatomy, Anatomy) else load_anatomy(anatomy)
    mouse = load_profile("electric-mouse")
    bank, sites = load_bank(mouse), inner_sites(mouse)
    parts = (_stage_rows, _blur_rows, _shift_rows, _selective_rows, _concentric_rows)
    rows: list[Row] = []
    fingers = [Finger(mouse, seed, base) for seed in seeds]
    for part in parts:
        rows += part(base, fingers, bank, sites)
    return rows


def spread(values: Iterable[float], digits: int = 1) -> str:
    """Return, as text, the median over fingers and the range of the middle 90 % of fingers."""
    middle, low, high = (f"{each:.{digits}f}" for each in middle_90(values))
    return f"{middle} ({low}–{high})"


def _counts(rows: Sequence[Array]) -> str:
    """Return the `spread` of the counts by class. ``rows`` has a row, (3,), for each finger."""
    columns = zip(Afferent, np.transpose(rows), strict=True)
    return ", ".join(f"{each.name} {spread(column)}" for each, column in columns)


def _stage_rows(
    anatomy: Anatomy, fingers: Sequence[Finger], bank: KernelBank, sites: Sequence[int]
) -> list[Row]:
    every = [stages(anatomy, [one.seed]) for one in fingers]
    first_ma = {each: np.array([found[each][0] for found in every]) for each in Afferent}
    order = sorted(first_ma, key=lambda each: float(np.median(first_ma[each])))
    least_ma = first_ma[order[0]]
    shown = ", ".join(f"{each.name} {spread(first_ma[each] / least_ma)}" for each in order[1:])
    return [
        (
            "SAI mode on lines: threshold of each class, relative to the lowest",
            "pressure 1, vibration 1.5, pressure masked 2.5",
            f"{order[0].name} 1, {shown}",
        ),
        ("SAI mode on lines: lowest threshold, mA", f"{STAGES_MA[0]:g}", spread(least_ma)),
    ]


def _blur_rows(
    anatomy: Anatomy, fingers: Sequence[Finger], bank: KernelBank, sites: Sequence[int]
) -> list[Row]:
    away = {}
    for name, cathodic in (("anodic", False), ("cathodic", True)):
        current_ma = CLEAR_MA * against_all(fingers[0].profile, cathodic)
        found = [shift([one], current_ma, sites, list(Afferent)) for one in fingers]
        away[name] = f"{name} {spread(each.away_mm for each in found)}"
    return [
        (
            f"one electrode, {CLEAR_MA:g} mA: RMS distance to active receptors, mm",
            "anodic acute, cathodic blurred",
            ", ".join(away.values()),
        )
    ]


def _shift_rows(
    anatomy: Anatomy, fingers: Sequence[Finger], bank: KernelBank, sites: Sequence[int]
) -> list[Row]:
    rows = []
    profile = fingers[0].profile
    current_ma = CLEAR_MA * kernel_ma(profile, bank, Afferent.PC)
    for flat_mm in sorted({3.0, 5.0, anatomy.pc.flat_mm}):
        none = {"density_per_cm2": 0.0}
        alone = {
            "ra": anatomy.ra.model_copy(update=none),
            "sai": anatomy.sai.model_copy(update=none),
            # Simulate ten times as many PC as a fingertip has, so that their mean is precise.
            "pc": anatomy.pc.model_copy(update={"flat_mm": flat_mm, "density_per_cm2": 210.0}),
        }
        mine = anatomy.model_copy(update=alone)
        found = [
            shift([Finger(profile, one.seed, mine)], current_ma, sites, [Afferent.PC])
            for one in fingers
        ]
        rows.append(
            (
                f"PC mode, axons of {flat_mm:g} mm: shift toward the fingertip, mm",
                "1 to 3",
                spread(-each.y_mm for each in found),
            )
        )
    return rows


def _selective_rows(
    anatomy: Anatomy, fingers: Sequence[Finger], bank: KernelBank, sites: Sequence[int]
) -> list[Row]:
    rows = []
    for mode, paper in (
        (Afferent.RA, "only RA"),
        (Afferent.SAI, "only SAI, in a narrow range of currents"),
        (Afferent.PC, "PC, and the RA above them"),
    ):
        current_ma = CLEAR_MA * kernel_ma(fingers[0].profile, bank, mode)[list(sites)]
        counts = [
            np.bincount(one.classes, fired(one, current_ma).mean(axis=1), len(Afferent))
            for one in fingers
        ]
        label = f"{mode.name} mode, {CLEAR_MA:g} mA at a point: afferents that fire"
        rows.append((label, paper, _counts(counts)))
    return rows


def _concentric_rows(
    anatomy: Anatomy, fingers: Sequence[Finger], bank: KernelBank, sites: Sequence[int]
) -> list[Row]:
    rows, profile = [], load_profile("concentric")
    for name, current_ma, paper in (
        ("anodic", -CLEAR_MA, "RA, no PC"),
        ("cathodic", CLEAR_MA, "–"),
    ):
        counts = [reached(profile, current_ma, anatomy, [one.seed]) for one in fingers]
        label = f"disc of 1 mm in a ring of 6 to 8 mm, {CLEAR_MA:g} mA {name}: afferents that fire"
        rows.append((label, paper, _counts(counts)))
    return rows


if __name__ == "__main__":
    print_table(
        [*effects(sys.argv[1], range(1, int(sys.argv[2]) + 1))],
        ["effect", "paper", "fingers"],
        left=3,
    )
