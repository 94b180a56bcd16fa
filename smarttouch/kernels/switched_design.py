"""Kernels for boards that switch one current source: each electrode is cathode, anode or insulated.

The current divides among the electrodes of a pole by their admittance. One of the two poles is
always a single electrode. Several electrodes at both poles would not allow more current: one would
carry all current if the others of its pole lost contact.
"""

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.design_problem import Kernel, KernelKind, Problem, limits_ma
from smarttouch.kernels.minmax_design import design_kernel as design_weighted
from smarttouch.profile import Profile

_RING_PITCHES = 1.5  # radius of a ring: eight neighbors on a square grid, six on a hexagonal one


def polarity(profile: Profile, afferent: Afferent) -> str:
    """Return the polarity of the electrode over a target (Fig. 10). It is anodic for upright axons
    (RA) with a passive ending. It is cathodic for upright axons whose ending can fire, and for
    horizontal axons (SAI, PC)."""
    anodic = afferent is Afferent.RA and profile.skin.ra_ending == "passive"
    return "anodic" if anodic else "cathodic"


def possible_modes(profile: Profile) -> list[Afferent]:
    offered = profile.output.polarities if profile.output.kind != "weighted" else ()
    return [
        afferent for afferent in Afferent if not offered or polarity(profile, afferent) in offered
    ]


def designer(profile: Profile) -> Callable[[Problem, int], Kernel]:
    """Return the design function for the profile's kind of board."""
    designers: dict[KernelKind, Callable[[Problem, int], Kernel]] = {
        "weighted": design_weighted,
        "three-state": design_three_state,
        "one-against-all": design_one_of_n,
    }
    return designers[profile.output.kind]


def design_kernel(
    profile: Profile,
    afferent: Afferent | str,
    site: int,
    model: Literal["activating", "paper"] = "activating",
) -> Kernel:
    """Design the kernel of one site for the profile's kind of board.

    Parameters
    ----------
    profile : Profile
    afferent : Afferent or str
        Afferent class: RA, SAI or PC.
    site : int
        Electrode over the target.
    model : {"activating", "paper"}
        "paper" is the paper's linear program (Eq. 16 to 18), which does not bound spill. It is for
        boards with a current source for each electrode.

    Raises
    ------
    DesignError
        If no kernel exists.

    Examples
    --------
    >>> import smarttouch as st
    >>> kernel = st.design_kernel(st.load_profile("line-8"), "RA", 3)
    >>> bool(kernel.off_target < 0.3)
    True
    """
    afferent = afferent if isinstance(afferent, Afferent) else Afferent[afferent]
    problem = Problem(profile, afferent)
    if model == "paper":
        return design_weighted(problem, site, spill=None)
    return designer(profile)(problem, site)


def design_three_state(problem: Problem, site: int) -> Kernel:
    """Return the better of two kernels: one electrode against its ring, or against all others.

    A ring consists of the electrodes within `_RING_PITCHES` or, if there are none, of the nearest
    ones; electrodes outside the ring are insulated (paper, Fig. 19). A kernel that keeps the limits
    is better than one that does not; otherwise the more selective kernel is better.
    """
    problem.check_site(site)
    away_mm = problem.profile.electrodes.distance_mm[site]
    others = problem.driven[problem.driven != site]
    reach_mm = max(_RING_PITCHES * problem.profile.electrodes.pitch_mm, away_mm[others].min())
    ring = others[away_mm[others] <= reach_mm + 1e-9]
    kernels = (_against(problem, site, poles, "three-state") for poles in (ring, others))
    _, limit_ma = limits_ma(problem.profile)

    def rank(kernel: Kernel) -> tuple[bool, float]:
        carried_ma = problem.full_ma(site) * np.abs(kernel.peak_normalized)
        over = bool((carried_ma > limit_ma)[others].any())
        return over, max(kernel.off_target, kernel.spill)

    return min(kernels, key=rank)


def design_one_of_n(problem: Problem, site: int) -> Kernel:
    """Return the kernel of a board that drives one electrode against all others. Such a board also
    connects masked electrodes; their share of the current is unknown and ignored."""
    problem.check_site(site)
    return _against(problem, site, problem.driven[problem.driven != site], "one-against-all")


def _against(problem: Problem, site: int, others: NDArray[np.intp], kind: KernelKind) -> Kernel:
    """Return the kernel of a site's electrode against ``others``, which share the current in
    proportion to their admittance."""
    admittance = problem.profile.admittance
    pole = -1.0 if polarity(problem.profile, problem.afferent) == "anodic" else 1.0
    weights = np.zeros(problem.electrodes)
    weights[others] = -pole * admittance[others] / admittance[others].sum()
    weights[site] = pole
    return problem.judge(weights, site, kind=kind)
