"""Kernels of a profile as tables and JSON, and the kinds of kernels compared."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.kernels.bank import KernelBank, design_confined
from smarttouch.kernels.batch_design import Design, Timed, design_sites, part_of
from smarttouch.kernels.design_problem import Kernel, Problem
from smarttouch.kernels.switched_design import design_one_of_n, design_three_state, designer
from smarttouch.kernels.weighted_design import design_any_node, design_kernel
from smarttouch.profile import Profile

VARIANTS: dict[str, Design] = {
    "weighted": design_kernel,
    "robust": design_kernel,
    "three-state": design_three_state,
    "one-against-all": design_one_of_n,
}
_SHARES = {"weighted": 1, "robust": 1, "three-state": 40, "one-against-all": 1}
"""Time that each variant takes, in parts of the sum; progress is counted by it."""


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
    before, whole = 0, sum(_SHARES.values())
    for variant, design in VARIANTS.items():

        def advance(done: int, total: int, before: int = before, variant: str = variant) -> None:
            if progress is not None:
                progress(before * total + _SHARES[variant] * done, whole * total)

        problem = spread if variant == "robust" else nominal
        timed: list[Timed] = design_sites(problem, design, sites, advance)
        for site, (kernel, seconds) in zip(sites, timed, strict=True):
            on_nominal = nominal.judge(kernel.weights, site, kind=kernel.kind, gap=kernel.gap)
            try:
                worst = spread.judge(kernel.weights, site, kind=kernel.kind)
            except DesignError:
                worst = None
            compared.append(SiteKernel(afferent, site, on_nominal, seconds, variant, worst))
        before += _SHARES[variant]
    return compared


Advance = Callable[[int, int], None]  # given how many sites are done, of how many
DESIGNS: dict[str, Callable[[Problem, int], Kernel]] = {
    "robust": design_kernel,
    "three-state": design_three_state,
    "any-node": design_any_node,
}
"""Designs beside that of the profile's own board."""


@dataclass(frozen=True)
class WordTable:
    """Table of words, with its title above and a note below."""

    title: str
    heading: list[str]  # empty where columns have no names
    rows: list[list[str]]
    note: str


def kernels_of_bank(
    profile: Profile, bank: KernelBank, modes: Sequence[Afferent], sites: Sequence[int]
) -> list[SiteKernel]:
    """Return kernels as a bank has them."""
    kind = profile.output.kind
    return [
        SiteKernel(mode, site, bank.kernel(mode, site, kind), float(bank.seconds[mode][site]))
        for mode in modes
        for site in sites
    ]


def kernels_designed(
    profile: Profile,
    modes: Sequence[Afferent],
    sites: Sequence[int],
    kind: str | None,
    robust: bool,
    progress: Advance | None,
) -> list[SiteKernel]:
    """Return kernels designed now: one of `DESIGNS`, or as the board needs them."""
    if kind is None and profile.kernels.neighbors is not None:
        return kernels_of_bank(profile, design_confined(profile, sites, progress), modes, sites)
    design_one = DESIGNS[kind] if kind in DESIGNS else designer(profile)
    found = []
    for index, mode in enumerate(modes):
        problem = Problem(profile, mode, spread=robust)
        timed = design_sites(problem, design_one, sites, part_of(progress, index, len(modes)))
        found += [SiteKernel(mode, site, *each) for site, each in zip(sites, timed, strict=True)]
    return found


def kernels_compared(
    profile: Profile, modes: Sequence[Afferent], sites: Sequence[int], progress: Advance | None
) -> list[SiteKernel]:
    """Return kernels of all kinds, with their figures on the worst finger."""
    return [
        each
        for index, mode in enumerate(modes)
        for each in compare(profile, mode, sites, part_of(progress, index, len(modes)))
    ]


def middle_kernels(
    profile: Profile, kernels: Sequence[SiteKernel]
) -> tuple[int, dict[Afferent, Kernel]]:
    """Return the site nearest to the middle, and its kernel of each class."""
    sites = sorted({each.site for each in kernels})
    away_mm = np.linalg.norm(profile.electrodes.position_mm[sites], axis=1)
    site = sites[int(away_mm.argmin())]
    found: dict[Afferent, Kernel] = {}
    for each in kernels:
        if each.site == site:
            # Where kinds are compared, the first one, the weighted, is taken.
            found.setdefault(each.afferent, each.kernel)
    return site, found


def as_json(profile: Profile, kernels: Sequence[SiteKernel]) -> dict[str, Any]:
    """Return kernels as a JSON object; weights in mA, positive cathodic."""
    return {
        "profile": profile.name,
        "positive": "cathodic",
        "weights_unit": "mA for an activating function of 1 V/mm² at the target",
        "kernels": [_one_as_json(profile, each) for each in kernels],
    }


def _one_as_json(profile: Profile, of: SiteKernel) -> dict[str, Any]:
    kernel, (x_mm, y_mm) = of.kernel, profile.electrodes.position_mm[of.site]
    table: dict[str, Any] = {
        "mode": of.afferent.name,
        "site": of.site,
        "x_mm": float(x_mm),
        "y_mm": float(y_mm),
        "weights": kernel.weights.tolist(),
        "worst_other": float(kernel.off_target),
        "worst_other_class": kernel.off_target_class.name,
        "own_spill": float(kernel.spill),
        "sum": float(kernel.weights.sum()),
        "total_current": float(np.abs(kernel.weights).sum()),
        "activated_node": kernel.node,
        "kind": kernel.kind,
        "optimal": kernel.gap == 0,
        "gap": float(kernel.gap),
        "seconds": float(of.seconds),
    }
    if of.variant:
        worst = of.worst_finger
        table |= {
            "variant": of.variant,
            "worst_other_over_spread": worst and float(worst.off_target),
            "own_spill_over_spread": worst and float(worst.spill),
        }
    return table


def site_table(profile: Profile, kernels: Sequence[SiteKernel]) -> WordTable:
    """Return one row for each site, with what its kernel of each mode reaches."""
    modes = sorted({each.afferent for each in kernels})
    heading = ["site", "x mm", "y mm"]
    for mode in modes:
        heading += [f"{mode.name} other", "spill"] if len(modes) > 1 else [
            "worst other", "of", "own spill", "total |w|/peak", "gap",
        ]  # fmt: skip
    rows: dict[int, list[str]] = {}
    for each in kernels:
        x, y = profile.electrodes.position_mm[each.site]
        row = rows.setdefault(each.site, [str(each.site), f"{x:.2f}", f"{y:.2f}"])
        kernel = each.kernel
        row += [f"{kernel.off_target:.4f}", f"{kernel.spill:.3f}"]
        if len(modes) == 1:
            total = abs(kernel.peak_normalized).sum()
            row.insert(-1, kernel.off_target_class.name)
            row += [f"{total:.2f}", _gap(kernel.gap)]
    names = " and ".join(mode.name for mode in modes)
    note = (
        "Worst other and own spill are activations of the target's own: above 1 another class "
        "fires first."
    )
    return WordTable(
        f"{names} kernels of {profile.name}: {profile.title}", heading, list(rows.values()), note
    )


def weight_table(profile: Profile, of: SiteKernel) -> tuple[WordTable, list[list[bool]]]:
    """Return a kernel's weights laid out as its array, and which cell is its own site."""
    kernel, position = of.kernel, profile.electrodes.position_mm
    weights = kernel.peak_normalized
    lines = []
    for y in sorted({round(float(each), 6) for each in position[:, 1]}):
        line = [index for index in range(len(position)) if abs(position[index, 1] - y) < 1e-5]
        lines.append(sorted(line, key=lambda index: position[index, 0]))
    certain = f"within {kernel.gap:.1%} of the best possible" if kernel.gap else "proven optimal"
    table = WordTable(
        f"{of.afferent.name} kernel ({kernel.kind}) at site {of.site} of {profile.name}, "
        "positive cathodic",
        [],
        [[f"{weights[index]:+.3f}" for index in line] for line in lines],
        f"worst other {kernel.off_target:.4f} ({kernel.off_target_class.name}), own spill "
        f"{kernel.spill:.3f}, sum {weights.sum():+.1e}, node {kernel.node}; {certain}",
    )
    return table, [[index == of.site for index in line] for line in lines]


def comparison_table(profile: Profile, kernels: Sequence[SiteKernel]) -> WordTable:
    """Return what each kind of kernel reaches, the worst of all its sites."""
    groups: dict[tuple[Afferent, str], list[SiteKernel]] = {}
    for each in kernels:
        groups.setdefault((each.afferent, each.variant), []).append(each)
    rows = []
    for (mode, variant), group in groups.items():
        best = [each.kernel.off_target for each in groups[mode, "weighted"]]
        losses = [each.kernel.off_target / b - 1 for each, b in zip(group, best, strict=True)]
        worst = [each.worst_finger for each in group if each.worst_finger is not None]
        on_worst = ["does not fire", "–"]
        if len(worst) == len(group):
            on_worst = [f"{max(each.off_target for each in worst):.4f}"]
            on_worst.append(f"{max(each.spill for each in worst):.3f}")
        rows.append(
            [
                mode.name,
                variant,
                f"{max(each.kernel.off_target for each in group):.4f}",
                f"{max(each.kernel.spill for each in group):.3f}",
                f"{max(losses):+.1%}" if variant != "weighted" else "",
                *on_worst,
                _gap(max(each.kernel.gap for each in group)),
            ]
        )
    sites = len({each.site for each in kernels})
    where = f"site {kernels[0].site}" if sites == 1 else f"the worst of {sites} sites"
    return WordTable(
        f"Kinds of kernels on {profile.name}, {where}",
        ["mode", "kernel", "other", "spill", "loss", "other *", "spill *", "gap"],
        rows,
        "Other: largest AF of another class, of the target's. Loss: by how much it exceeds the "
        "weighted kernel's. *: on the worst finger of the profile's skin.spread. Gap: how much "
        "better a switching could be at most.",
    )


def _gap(gap: float) -> str:
    return f"{gap:.1%}" if gap else "proven"
