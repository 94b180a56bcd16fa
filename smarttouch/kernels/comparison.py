"""Comparison of the kinds of kernels, on the nominal finger and on the worst of a spread."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from smarttouch.afferent import Afferent
from smarttouch.errors import DesignError
from smarttouch.kernels.batch import Design, Timed, design_sites, part_of
from smarttouch.kernels.design import design_kernel
from smarttouch.kernels.problem import Kernel, Problem
from smarttouch.kernels.switching import design_one_of_n, design_three_state
from smarttouch.profile import Profile

VARIANTS: dict[str, Design] = {
    "weighted": design_kernel,
    "robust": design_kernel,
    "three-state": design_three_state,
    "one-of-n": design_one_of_n,
}


@dataclass(frozen=True, eq=False)
class SiteKernel:
    """One kernel of a report; the last two fields only where kinds are compared."""

    afferent: Afferent
    site: int
    kernel: Kernel
    seconds: float  # time of its design
    variant: str = ""  # one of `VARIANTS`
    worst_finger: Kernel | None = None  # None where it does not activate its target on one finger


def compare(
    profile: Profile,
    afferent: Afferent,
    sites: Sequence[int],
    progress: Callable[[int, int], None] | None = None,
) -> list[SiteKernel]:
    """Design every variant for every site of a class, and evaluate each on both fingers."""
    nominal, spread = Problem(profile, afferent), Problem(profile, afferent, spread=True)
    compared = []
    for index, (variant, design) in enumerate(VARIANTS.items()):
        advance = part_of(progress, index, len(VARIANTS))
        problem = spread if variant == "robust" else nominal
        timed: list[Timed] = design_sites(problem, design, sites, advance)
        for site, (kernel, seconds) in zip(sites, timed, strict=True):
            on_nominal = nominal.judge(kernel.weights, site, kind=kernel.kind, gap=kernel.gap)
            try:
                worst = spread.judge(kernel.weights, site, kind=kernel.kind)
            except DesignError:
                worst = None
            compared.append(SiteKernel(afferent, site, on_nominal, seconds, variant, worst))
    return compared
