"""Published measurements beside those of simulated fingers.

Only figures of the literature that we are sure of are listed; a dash means that we have none.
"""

from collections.abc import Callable, Sequence
from statistics import fmean, median
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from studies.finger_effects import CLEAR_MA, against_all, inner_sites, kernel_ma
from studies.receptor_spikes import touchsim_rows

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.kernels.bank import load_bank
from smarttouch.physiology.activating_function import potential_mv
from smarttouch.physiology.anatomy import Anatomy, load_anatomy
from smarttouch.physiology.driving_function import load_driving
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.membrane import weiss_fit
from smarttouch.physiology.response import response_map
from smarttouch.physiology.spikes import SpikeModel
from smarttouch.profile import Profile, load_profile
from smarttouch.reading.letter_responses import respond_to_letters
from smarttouch.reading.letter_shapes import ALPHABET

Array = NDArray[np.float64]

WIDTHS_US = (50.0, 100.0, 200.0, 500.0)
_DIP = 0.8
"""Level between two places, over the lower of both, below which they are resolved. Ours."""
_BLUR_MM = 0.6
"""Standard deviation of a receptive field in that. Ours."""
_ACROSS = 33


class PublishedRow(NamedTuple):
    """A measurement: what, what was published, by whom, and what the fingers say."""

    quantity: str
    published: str
    source: str
    finger: str


def published(
    anatomy: str,
    seeds: Sequence[int],
    letters: str = ALPHABET,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> list[PublishedRow]:
    """Return the table; parameters are those of `finger_effects.effects`, and letters to read."""
    is_like = load_anatomy(anatomy)
    mouse = load_profile("electric-mouse")
    fingers = [Finger(mouse, seed, is_like) for seed in seeds]
    rows: list[PublishedRow] = []
    parts: tuple[Callable[[], list[PublishedRow]], ...] = (
        lambda: threshold_rows(fingers),
        lambda: [polarity_row(mouse, is_like), chronaxie_row(mouse, is_like)],
        lambda: gap_rows(fingers),
        lambda: [letters_row("electric-mouse", "8 × 8", anatomy, seeds, letters)],
        lambda: [letters_row("optacon-24x6", "24 × 6", anatomy, seeds, letters)],
        lambda: [PublishedRow(*row) for row in touchsim_rows(fingers)],
    )
    for done, part in enumerate(parts):
        rows += part()
        progress(done + 1, len(parts))
    return rows


def threshold_rows(fingers: Sequence[Finger]) -> list[PublishedRow]:
    """Return absolute thresholds of a disc against all others, and their spread over electrodes."""
    profile = fingers[0].profile
    sites = inner_sites(profile)
    rows = []
    for name, cathodic, said, by in (
        ("anodic", False, f"{CLEAR_MA:g} clearly felt", "the paper, Section III-C"),
        ("cathodic", True, "–", ""),
    ):
        current_ma = against_all(profile, cathodic)[sites]
        width_us = np.full(len(sites), profile.pulse.width_us)
        first = np.array(
            [
                1 / np.maximum(SpikeModel(one).drive(1000 * current_ma, width_us).max(axis=0), 1e-9)
                for one in fingers
            ]
        )
        low, middle, high = np.quantile(first, (0.1, 0.5, 0.9))
        rows.append(
            PublishedRow(f"threshold of a 1 mm disc, {name}, 200 µs, mA", said, by, f"{middle:.2f}")
        )
        rows.append(
            PublishedRow(
                f"its spread between electrodes, 90 % over 10 %, {name}",
                "–",
                "",
                f"{high / low:.1f}",
            )
        )
    return rows


def ending_ma(profile: Profile, anatomy: Anatomy, width_us: float, cathodic: bool) -> float:
    """Return the threshold of an upright RA ending under the middle of one disc, mA.

    The disc is one of a profile's, without return electrodes, at the profile's depth of RA.
    """
    is_like = anatomy.ra
    driving = load_driving(is_like.fiber, is_like.ending, width_us)
    depth = (is_like.depth_mm or profile.skin.ra_depth_mm) + driving.internode_mm * np.arange(120)
    site = inner_sites(profile)[0]
    place = np.broadcast_to(profile.electrodes.position_mm[site], (len(depth), 2))
    potential = potential_mv(profile, np.column_stack([place, depth]))[:, site]
    drive = driving.drive((1 if cathodic else -1) * potential[None, :, None])
    return float(is_like.threshold_factor / drive.max())


def polarity_row(profile: Profile, anatomy: Anatomy) -> PublishedRow:
    """Return the ratio of cathodic to anodic thresholds of RA."""
    width_us = profile.pulse.width_us
    cathodic, anodic = (ending_ma(profile, anatomy, width_us, each) for each in (True, False))
    return PublishedRow(
        "cathodic over anodic threshold of RA (the terminal was fitted to it)",
        "1.3–1.5",
        "Kaczmarek 2000, macaque",
        f"{cathodic / anodic:.2f}",
    )


def chronaxie_row(profile: Profile, anatomy: Anatomy) -> PublishedRow:
    """Return the chronaxie of RA, by its fiber and as spikes have it."""
    ma = [ending_ma(profile, anatomy, each, cathodic=False) for each in WIDTHS_US]
    _, chronaxie_us = weiss_fit(WIDTHS_US, ma)
    return PublishedRow(
        "chronaxie of RA, µs",
        "151",
        "Kaczmarek 2000, macaque",
        f"{chronaxie_us:.0f} by its fiber; {anatomy.ra.chronaxie_us:.0f} put in where widths vary",
    )


def resolves_two_points(finger: Finger, current_ma: Array, places_mm: Array) -> bool:
    """Return whether the map of spikes from slots, (S, E) mA, dips between two places, (2, 2)
    mm."""
    width_us = np.full(len(current_ma), finger.profile.pulse.width_us)
    fires = SpikeModel(finger).drive(1000 * current_ma, width_us) >= 1
    along = np.linspace(-0.25, 1.25, _ACROSS)[:, None]
    line = places_mm[0] + along * (places_mm[1] - places_mm[0])
    felt = response_map(finger, fires.sum(axis=1), line, _BLUR_MM).sum(axis=0)
    third = _ACROSS // 3
    one, other = felt[:third].max(), felt[-third:].max()
    between = felt[third:-third].min()
    return bool(min(one, other) > 0 and between < _DIP * min(one, other))


def gap_rows(fingers: Sequence[Finger]) -> list[PublishedRow]:
    """Return the part of fingers that resolve two points, or a gap in a bar."""
    profile = fingers[0].profile
    bank = load_bank(profile)
    position = profile.electrodes.position_mm
    row = np.flatnonzero(np.isclose(position[:, 1], position[inner_sites(profile)[0], 1]))
    row = row[position[row, 0].argsort()]
    rows = []
    for mode in (Afferent.RA, Afferent.SAI):
        current_ma = CLEAR_MA * kernel_ma(profile, bank, mode)
        parts = []
        for apart in (1, 2, 3):
            pairs = [(row[i], row[i + apart]) for i in range(len(row) - apart)]
            share = fmean(
                resolves_two_points(one, current_ma[list(pair)], position[list(pair)])
                for one in fingers
                for pair in pairs
            )
            parts.append(f"{apart * profile.electrodes.pitch_mm:g} mm {share:.0%}")
        rows.append(
            PublishedRow(
                f"two points told apart, {mode.name} mode", "–", "electrotactile", ", ".join(parts)
            )
        )
        gaps = range(2, len(row) - 2)
        share = fmean(
            resolves_two_points(one, current_ma[np.delete(row, i)], position[row[[i - 1, i + 1]]])
            for one in fingers
            for i in gaps
        )
        rows.append(
            PublishedRow(
                f"gap of one electrode in a bar, {mode.name} mode",
                "0.87 mm at 75 %",
                "mechanical, Johnson and Phillips 1981",
                f"{2 * profile.electrodes.pitch_mm:g} mm {share:.0%}",
            )
        )
    return rows


def letters_row(
    name: str, size: str, anatomy: str, seeds: Sequence[int], letters: str = ALPHABET
) -> PublishedRow:
    """Return the part of letters that is read from the spikes in RA mode."""
    profile = load_profile(name)
    found = respond_to_letters(profile, load_bank(profile), Mode.RA, anatomy, seeds, letters)
    right = 1 - median(
        fmean(each.read_as != each.letter for each in found if each.seed == seed) for seed in seeds
    )
    return PublishedRow(
        f"letters on {size} read from the spikes, RA mode (a correlation, no person)",
        "–",
        "",
        f"{right:.0%}",
    )
