"""Kernels for boards that switch one source instead of weighting many."""

from collections.abc import Callable

import numpy as np

from smarttouch.afferent import Afferent
from smarttouch.kernels.assignment import best_assignment
from smarttouch.kernels.design import design_kernel
from smarttouch.kernels.problem import Kernel, Kind, Problem
from smarttouch.profile import Profile


def polarity(profile: Profile, afferent: Afferent) -> str:
    """Return the pole over the target of a mode (Fig. 10): cathodic over flat axons (SAI, PC),
    anodic over rising ones (RA), but cathodic over those too if their ending can fire."""
    anodic = afferent is Afferent.RA and profile.skin.ra_ending == "passive"
    return "anodic" if anodic else "cathodic"


def possible_modes(profile: Profile) -> list[Afferent]:
    """Return the modes that a profile's board can make."""
    offered = profile.output.polarities if profile.output.kind != "weighted" else ()
    return [each for each in Afferent if not offered or polarity(profile, each) in offered]


def kind_of(profile: Profile) -> Kind:
    """Return the kind of kernel of a profile's board."""
    kind = profile.output.kind
    return "one-of-n" if kind == "one-against-all" else kind


def designer(profile: Profile) -> Callable[[Problem, int], Kernel]:
    """Return the function that designs kernels for a profile's kind of board."""
    designers: dict[Kind, Callable[[Problem, int], Kernel]] = {
        "weighted": design_kernel,
        "three-state": design_three_state,
        "one-of-n": design_one_of_n,
    }
    return designers[kind_of(profile)]


def design_three_state(problem: Problem, site: int) -> Kernel:
    """Choose cathode, anode or insulated for every electrode (paper, Fig. 19).

    The source's current divides among the electrodes of a pole by their admittance, equally unless
    ``output.impedance_kohm`` is given. The objective is that of `design_kernel`. `Kernel.gap` is 0
    where all assignments were ruled out, else the distance to the best weighted kernel, which no
    switched one can beat.
    """
    problem.check_site(site)
    share, gap = best_assignment(problem, site)
    return problem.judge(share, site, kind="three-state", gap=gap)


def design_one_of_n(problem: Problem, site: int) -> Kernel:
    """Return the only pattern of such a board: one electrode against all others.

    It connects masked electrodes too, but their share of the current is unknown and not counted.
    """
    problem.check_site(site)
    admittance = problem.profile.admittance
    others = problem.driven[problem.driven != site]
    pole = -1.0 if polarity(problem.profile, problem.afferent) == "anodic" else 1.0
    weights = np.zeros(problem.electrodes)
    weights[others] = -pole * admittance[others] / admittance[others].sum()
    weights[site] = pole
    return problem.judge(weights, site, kind="one-of-n")
