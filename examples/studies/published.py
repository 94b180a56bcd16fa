"""Comparison of published measurements of people and nerves with simulated fingers.

``python examples/studies/published.py 20`` prints published values and those of 20 fingers of each
anatomy. We read at least the abstract of each source; a dash marks a number that we did not find.
The model was fitted to a measurement only if the last column says so.
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, median
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

sys.path.append(str(Path(__file__).parents[1]))
from studies.effects_on_fingers import CLEAR_MA, LOWERED, against_all, inner_sites, kernel_ma

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.kernels.bank import load_bank
from smarttouch.physiology.activating_function import potential_mv
from smarttouch.physiology.afferent_anatomy import load_anatomy
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.membrane import load_driving, weiss_fit
from smarttouch.physiology.spikes import SpikeModel, response_map
from smarttouch.profile import Profile, load_profile
from smarttouch.reading.legibility import (
    letter_sequences,
    letter_templates,
    spikes_and_letter,
)
from smarttouch.reading.letter_shapes import ALPHABET

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

ANATOMIES = ("paper", "branched")
WIDTHS_US = (50.0, 100.0, 200.0, 500.0)
SIZES_MM = (1.0, 4.0)
PULSES, PULSE_HZ = 6, 350.0
COMFORTABLE = 1.5
"""Current, relative to the threshold, at which patterns are recognized well (Kaczmarek)."""
_DIP = 0.8
"""A dip below this share of the weaker peak separates two points (our choice)."""
_BLUR_MM = 0.6  # standard deviation of a receptive field, for resolving two points (our choice)
_ACROSS = 33  # number of samples along the line through two points
_RESAMPLES = 2000  # number of bootstrap samples


@dataclass(frozen=True)
class Experiment:
    """Published measurement, and the range of simulated values that agree with it."""

    key: str  # key of the simulated value in `measured`; empty if it is not simulated
    quantity: str
    published: str  # a dash if we did not find the number
    agrees: tuple[float, float] | None  # lowest and highest value that agree; None if unknown
    source: str
    why: str  # why the simulated value agrees or disagrees


_SOURCES = {
    "tachi": "[Tachi 1977](http://repository.dl.itc.u-tokyo.ac.jp/dspace/handle/2261/6889), arm",
    "rhesus": "[Kaczmarek 2000](https://doi.org/10.1109/86.847828), three RA of macaques",
    "bursts": "[Kaczmarek 1992](https://doi.org/10.1109/10.142645)",
    "geng": "[Geng 2011](https://doi.org/10.1186/1743-0003-8-9), forearm",
    "zhu": "[Zhu 2017](https://doi.org/10.3389/fnins.2017.00250), forearm",
    "tashiro": "Higashiyama and Tashiro, forearm",
    "dölker": "[Dölker 2022](https://doi.org/10.1038/s41598-022-10708-9), upper arm",
    "yem": "Yem and Kajimoto 2017, finger",
    "solomonow": "[Solomonow 1977](https://doi.org/10.1007/BF02409338)",
    "paper": "the paper, III-C",
    "display": "[Kaczmarek](http://kaz.med.wisc.edu/projects_ethaptic.php), fingertip",
}  # fmt: skip
"""Sources by key, with the measured skin or nerves; see also ``docs/references.md``."""
EXPERIMENTS = (
    Experiment("disc", "threshold of a 1 mm disc, anodic, 200 µs, mA", "2.4 clearly felt", (0, 2.4),
               _SOURCES["paper"], "2.4 mA was clearly felt, so the threshold is lower"),
    Experiment("width", "threshold at 1000 µs relative to 100 µs", ".32 (I²T constant)",
               (0.28, 0.35), _SOURCES["tachi"],
               "Weiss's law (chronaxie 151 µs) gives threshold ∝ width^−.34, not width^−.5"),
    Experiment("chronaxie", "chronaxie of RA by its cable model, µs", "151", (136, 166),
               _SOURCES["rhesus"],
               "rabbit nodes at 37 °C react faster; the chronaxie of the spike model is 151 µs"),
    Experiment("polarity", "cathodic over anodic threshold of an RA ending", "1.3–1.5", (1.3, 1.5),
               _SOURCES["rhesus"], "the terminal of the model was fitted to this ratio"),
    Experiment("size", "threshold of a 4 mm disc relative to 1 mm", "above 1", (1.02, np.inf),
               _SOURCES["zhu"], "a large disc has a flatter field; no study used a finger"),
    Experiment("size", "threshold of a 4 mm disc relative to 1 mm",
               "below 1, for sizes of up to 15 mm", (0, 0.98), _SOURCES["tashiro"],
               "the model does not add up the spikes of fibers"),
    Experiment("size", "threshold of a 4 mm disc relative to 1 mm", "1, no influence",
               (0.98, 1.02), _SOURCES["dölker"], ""),
    Experiment("train", f"threshold of {PULSES} pulses relative to one pulse", "below 1",
               (0, 0.999), _SOURCES["geng"],
               "in the model, the threshold falls only because noise differs from pulse to pulse"),
    Experiment("burst", f"spikes from {PULSES} pulses at {PULSE_HZ:g} Hz, relative to one pulse",
               "2 (felt strength)", (1.8, 2.2), _SOURCES["bursts"],
               "the model does not turn spikes into felt strength"),
    Experiment("pair", "threshold of two discs at once, 4 mm apart, relative to one disc",
               "below 1", (0, 0.98), _SOURCES["geng"], "beside a disc, its field changes sign"),
    Experiment("", "threshold of two discs with a delay of 0 to 500 µs", "rises with the delay",
               None, _SOURCES["geng"], "in the model each pulse acts independently"),
    Experiment("anodic", f"SAI share of firing afferents, anodic, {COMFORTABLE:g} × threshold",
               "mainly vibration", (0, 0.3), _SOURCES["yem"],
               ".30 is the share of SAI among all afferents"),
    Experiment("strong", "SAI share of firing afferents, anodic, 3 × threshold", "still low",
               (0, 0.3), _SOURCES["yem"], ""),
    Experiment("cathodic", f"SAI share of firing afferents, cathodic, {COMFORTABLE:g} × threshold",
               "vibration and pressure", (0.3, 0.9), _SOURCES["yem"], "SAI axons are horizontal"),
    Experiment("points_ra", "point pairs 4 mm apart: share that is resolved, RA mode", "–", None,
               _SOURCES["solomonow"], "the abstract states no distance; we chose the criterion"),
    Experiment("points_sai", "point pairs 4 mm apart: share that is resolved, SAI mode", "–", None,
               _SOURCES["solomonow"], ""),
    Experiment("level",
               f"share of letters read: increase from threshold to {COMFORTABLE:g} × threshold",
               "better", (0.02, 1), _SOURCES["display"], "at threshold, many points are silent"),
)  # fmt: skip


class Bench:
    """Profiles, kernels and letters that all simulated fingers share."""

    def __init__(self, letters: str = ALPHABET) -> None:
        self.mouse: Profile = load_profile("electric-mouse")
        ring = load_profile("concentric")
        self.sized: list[Profile] = [
            ring.model_copy(
                update={"array": ring.array.model_copy(update={"sizes_mm": ((mm, 0), (8, 6))})}
            )
            for mm in SIZES_MM
        ]
        self.bank = load_bank(self.mouse)
        self.sites: list[int] = inner_sites(self.mouse)
        self.shown = letter_sequences(letters, self.mouse, self.bank, Mode.RA)
        self.known = letter_templates(self.mouse)


def measured(bench: Bench, anatomy: str, seed: int) -> dict[str, float]:
    """Return the value of each experiment for one finger, by key."""
    finger = Finger(bench.mouse, seed, anatomy)
    model = SpikeModel(finger, seed)
    return {
        **disc_figures(model),
        "size": _size_ratio(bench, anatomy, seed),
        **_of_one_ending(finger),
        **_points(bench, finger),
        **_letters(bench, model),
    }


def disc_figures(model: SpikeModel) -> dict[str, float]:
    """Return the values of experiments with single discs and with pairs of discs on one finger."""
    profile, finger = model.finger.profile, model.finger
    sites = inner_sites(profile)
    poles = against_all(profile, cathodic=False)[sites]
    anodic, cathodic = _drive(model, poles), _drive(model, -poles)
    first_ma = 1 / anodic.max(axis=0)
    wide, narrow = (_drive(model, poles, us).max(axis=0) for us in (1000.0, 100.0))
    found = {
        "disc": median(first_ma),
        "width": median(narrow / wide),
        "train": _train_threshold(model, anodic),
        "burst": _burst_spikes(model, COMFORTABLE * first_ma[0] * poles[:1]),
        "anodic": _sai_share(finger, COMFORTABLE * anodic / anodic.max(axis=0)),
        "strong": _sai_share(finger, 2 * COMFORTABLE * anodic / anodic.max(axis=0)),
        "cathodic": _sai_share(finger, COMFORTABLE * cathodic / cathodic.max(axis=0)),
        "pair": _pair_ratio(model),
    }
    return {key: float(value) for key, value in found.items()}


def _drive(model: SpikeModel, current_ma: Array, width_us: float = 200.0) -> Floats:
    """Return the drive of each afferent in each slot, (A, S). An afferent fires at a drive of 1."""
    drive = model.drive(1000 * current_ma, np.full(len(current_ma), width_us))
    return np.maximum(drive, 1e-9)


def _sai_share(finger: Finger, drive: Floats) -> float:
    fires = drive >= 1
    return float(fires[finger.classes == Afferent.SAI].sum() / fires.sum())


def _train_threshold(model: SpikeModel, drive: Floats) -> float:
    """Return the current at which half of the trains cause a spike, relative to the current at
    which half of the single pulses cause a spike."""
    noise = np.array([one.anatomy.noise for one in model.finger.populations.values()])
    noise = noise[model.finger.classes][:, None]
    levels = np.linspace(0.9, 1.02, 241)
    ratios = []
    for column in (drive / drive.max(axis=0)).T:
        near = column > 0.85
        fires = ndtr((levels * column[near, None] - 1) / noise[near])
        silent = np.prod(1 - fires, axis=0)
        one, train = (levels[int((silent**count <= 0.5).argmax())] for count in (1, PULSES))
        ratios.append(train / one)
    return median(ratios)


def _burst_spikes(model: SpikeModel, current_ma: Array) -> float:
    """Return the number of spikes that a burst causes, relative to that of one pulse."""
    period_us = round(1e6 / PULSE_HZ)

    def spikes(count: int) -> int:
        model.reset()
        width_us = np.full(count, 200)
        slots = SimpleNamespace(
            current_ua=np.repeat(1000 * current_ma, count, axis=0), width_us=width_us,
            discharge_us=period_us - width_us, period_us=count * period_us,
        )  # fmt: skip
        return int(model.fire(slots).fired.sum())

    return spikes(PULSES) / max(1, spikes(1))


def _pair_ratio(model: SpikeModel) -> float:
    """Return the threshold of two discs at once, relative to that of the more sensitive disc."""
    profile = model.finger.profile
    single, place = against_all(profile, cathodic=False), profile.electrodes.position_mm
    sites, away = inner_sites(profile), profile.electrodes.pitch_mm * np.array([2.0, 0.0])
    pairs = [(a, b) for a in sites for b in sites if np.allclose(place[b] - place[a], away)]
    one, other = np.array(pairs).T
    alone = np.maximum(*(_drive(model, single[each]).max(axis=0) for each in (one, other)))
    return median(alone / _drive(model, single[one] + single[other]).max(axis=0))


def _size_ratio(bench: Bench, anatomy: str, seed: int) -> float:
    """Return the threshold of a large disc relative to that of a small disc, each with its more
    sensitive polarity. `LOWERED` describes why thresholds are reduced."""
    base = load_anatomy(anatomy)
    lowered = {
        each.name.lower(): base.of(each).model_copy(
            update={"threshold_factor": base.of(each).threshold_factor / LOWERED}
        )
        for each in Afferent
    }
    own, poles = base.model_copy(update=lowered), np.array([[1.0, -1.0], [-1.0, 1.0]])
    small, large = (
        float(_drive(SpikeModel(Finger(profile, seed, own)), poles).max())
        for profile in bench.sized
    )
    return small / large


def _of_one_ending(finger: Finger) -> dict[str, float]:
    """Return the polarity ratio and the chronaxie of an upright RA fiber below a disc. This fiber
    ends at the same depth as the nearest RA fiber of the finger."""
    profile, anatomy = finger.profile, finger.anatomy.ra
    site = inner_sites(profile)[0]
    ra = finger.populations[Afferent.RA]
    depth_mm = ra.axon_path_mm[finger.receptor_away_mm[ra.owner, site].argmin(), 0, 2]

    def threshold_ma(width_us: float, sign: int) -> float:
        driving = load_driving(anatomy.fiber, anatomy.ending, width_us)
        depth = depth_mm + driving.internode_mm * np.arange(120)
        place = np.broadcast_to(profile.electrodes.position_mm[site], (len(depth), 2))
        potential = potential_mv(profile, np.column_stack([place, depth]))[:, site]
        return float(1 / driving.drive(sign * potential[None, :, None]).max())

    anodic = [threshold_ma(each, -1) for each in WIDTHS_US]
    ratio = threshold_ma(200.0, 1) / threshold_ma(200.0, -1)
    return {"polarity": ratio, "chronaxie": weiss_fit(WIDTHS_US, anodic)[1]}


def resolves_two_points(finger: Finger, current_ma: Array, places_mm: Array) -> bool:
    """Return whether the response to these currents resolves the two points ``places_mm``."""
    fires = _drive(SpikeModel(finger), current_ma) >= 1
    along = np.linspace(-0.25, 1.25, _ACROSS)[:, None]
    line = places_mm[0] + along * (places_mm[1] - places_mm[0])
    felt = response_map(finger, fires.sum(axis=1), line, _BLUR_MM).sum(axis=0)
    third = _ACROSS // 3
    one, other = felt[:third].max(), felt[-third:].max()
    between = felt[third:-third].min()
    return bool(min(one, other) > 0 and between < _DIP * min(one, other))


def _points(bench: Bench, finger: Finger) -> dict[str, float]:
    """Return, by mode, the share of resolved pairs. The points of a pair are two pitches apart."""
    place = bench.mouse.electrodes.position_mm
    row = np.flatnonzero(np.isclose(place[:, 1], place[bench.sites[0], 1]))
    row = row[place[row, 0].argsort()]
    found = {}
    for mode in (Afferent.RA, Afferent.SAI):
        current_ma = CLEAR_MA * kernel_ma(bench.mouse, bench.bank, mode)
        found[f"points_{mode.name.lower()}"] = fmean(
            resolves_two_points(finger, current_ma[list(pair)], place[list(pair)])
            for pair in zip(row, row[2:], strict=False)
        )
    return found


def _letters(bench: Bench, model: SpikeModel) -> dict[str, float]:
    """Return how much the share of letters read increases from threshold to `COMFORTABLE` times
    the threshold."""
    point_ma = CLEAR_MA * kernel_ma(bench.mouse, bench.bank, Afferent.RA)[bench.sites]
    level = median(1 / _drive(model, point_ma).max(axis=0))
    right = np.zeros(2)
    for letter, (slots, _) in bench.shown.items():
        drive = model.drive(slots.current_ua, slots.width_us)
        for index, over in enumerate((1.0, COMFORTABLE)):
            scaled = np.float32(over * level) * drive
            right[index] += spikes_and_letter(model, slots, scaled, bench.known, 3)[1] == letter
    return {"level": (right[1] - right[0]) / len(bench.shown)}


Measured = Mapping[str, Sequence[Mapping[str, float]]]
"""For each anatomy, the result of `measured` for each finger."""


def interval(values: Sequence[float]) -> tuple[float, float, float]:
    """Return the mean of the fingers' values and its 95 % confidence interval, by bootstrap."""
    array = np.asarray(values)
    picks = np.random.default_rng(1).integers(len(array), size=(_RESAMPLES, len(array)))
    low, high = np.quantile(array[picks].mean(axis=1), (0.025, 0.975))
    return float(array.mean()), float(low), float(high)


def table(found: Measured) -> Iterator[str]:
    """Yield the lines of a Markdown table with a row for each experiment."""
    yield "| measurement | published | source | paper's anatomy | branched | agree | why |"
    yield "|---|---|---|---|---|---|---|"
    for each in EXPERIMENTS:
        ours, agree = ["–"] * 2, ["–"] * 2
        for index, fingers in enumerate(found.values()):
            if not each.key:
                continue
            mean, low, high = interval([one[each.key] for one in fingers])
            ours[index] = f"{mean:.3g} ({low:.3g}–{high:.3g})"
            if each.agrees is not None:
                # The mean agrees if its interval overlaps the range of agreement.
                agree[index] = "yes" if low <= each.agrees[1] and high >= each.agrees[0] else "no"
        both = agree[0] if agree[0] == agree[1] else ", ".join(agree)
        yield f"| {each.quantity} | {each.published} | {each.source} | " + (
            f"{ours[0]} | {ours[1]} | {both} | {each.why} |"
        )


def main(count: int) -> None:
    """Print the table for fingers with the seeds 1 to ``count``."""
    bench, seeds = Bench(), range(1, count + 1)
    found = {each: [measured(bench, each, seed) for seed in seeds] for each in ANATOMIES}
    print(*table(found), sep="\n")


if __name__ == "__main__":
    main(int(sys.argv[1]))
