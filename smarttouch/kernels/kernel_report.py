"""Kernels of a profile as tables and JSON."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.bank import design_confined, find_bank, load_bank
from smarttouch.kernels.batch_design import design_sites, part_of
from smarttouch.kernels.design_problem import Kernel, Problem
from smarttouch.kernels.minmax_design import design_any_node
from smarttouch.kernels.switched_design import designer
from smarttouch.profile import Profile


@dataclass(frozen=True, eq=False)
class SiteKernel:
    """Kernel of one site in a report."""

    afferent: Afferent
    site: int
    kernel: Kernel
    seconds: float  # design time


Advance = Callable[[int, int], None]  # called with the number of finished sites and of all sites


@dataclass(frozen=True)
class WordTable:
    """Table of text with a title and a note."""

    title: str
    heading: list[str]  # empty if columns have no names
    rows: list[list[str]]
    note: str


def find_kernels(
    profile: Profile,
    modes: Sequence[Afferent],
    site: int | None,
    any_node: bool,
    progress: Advance | None,
) -> list[SiteKernel]:
    """Return kernels at one site or at all sites, from a bank or designed now. The target is the
    node under the electrode or, with ``any_node``, the best node of its axon."""
    sites = profile.driven.tolist() if site is None else [site]
    if not any_node:
        # For a single site do not design a complete bank.
        bank = load_bank(profile, progress) if site is None else find_bank(profile)
        if bank is None and profile.kernels.neighbors is not None:
            bank = design_confined(profile, sites, progress)
        if bank is not None:
            kind = profile.output.kind
            return [
                SiteKernel(
                    mode, number, bank.kernel(mode, number, kind), float(bank.seconds[mode][number])
                )
                for mode in modes
                for number in sites
            ]
    design_one = design_any_node if any_node else designer(profile)
    kernels = []
    for index, mode in enumerate(modes):
        problem = Problem(profile, mode)
        timed = design_sites(problem, design_one, sites, part_of(progress, index, len(modes)))
        kernels += [
            SiteKernel(mode, designed_site, *timed_kernel)
            for designed_site, timed_kernel in zip(sites, timed, strict=True)
        ]
    return kernels


def middle_kernels(
    profile: Profile, kernels: Sequence[SiteKernel]
) -> tuple[int, dict[Afferent, Kernel]]:
    """Return the site nearest to the middle of the array, and its kernels by class."""
    sites = sorted({site_kernel.site for site_kernel in kernels})
    away_mm = np.linalg.norm(profile.electrodes.position_mm[sites], axis=1)
    site = sites[int(away_mm.argmin())]
    nearest: dict[Afferent, Kernel] = {}
    for site_kernel in kernels:
        if site_kernel.site == site:
            nearest[site_kernel.afferent] = site_kernel.kernel
    return site, nearest


def as_json(profile: Profile, kernels: Sequence[SiteKernel]) -> dict[str, Any]:
    """Return kernels as a JSON object; positive weights are cathodic."""
    return {
        "profile": profile.name,
        "positive": "cathodic",
        "weights_unit": "mA for an activating function of 1 V/mm² at the target",
        "kernels": [_one_as_json(profile, kernel) for kernel in kernels],
    }


def _one_as_json(profile: Profile, of: SiteKernel) -> dict[str, Any]:
    kernel, (x_mm, y_mm) = of.kernel, profile.electrodes.position_mm[of.site]
    return {
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


def site_table(profile: Profile, kernels: Sequence[SiteKernel]) -> WordTable:
    """Return a table of selectivity, with a row for each site and columns for each mode."""
    modes = sorted({site_kernel.afferent for site_kernel in kernels})
    heading = ["site", "x mm", "y mm"]
    for mode in modes:
        heading += [f"{mode.name} off-target", "spill"] if len(modes) > 1 else [
            "off-target", "of", "spill", "total |w|/peak", "gap",
        ]  # fmt: skip
    rows: dict[int, list[str]] = {}
    for site_kernel in kernels:
        x, y = profile.electrodes.position_mm[site_kernel.site]
        row = rows.setdefault(site_kernel.site, [str(site_kernel.site), f"{x:.2f}", f"{y:.2f}"])
        kernel = site_kernel.kernel
        row += [f"{kernel.off_target:.4f}", f"{kernel.spill:.3f}"]
        if len(modes) == 1:
            total = abs(kernel.peak_normalized).sum()
            row.insert(-1, kernel.off_target_class.name)
            row += [f"{total:.2f}", _gap(kernel.gap)]
    names = " and ".join(mode.name for mode in modes)
    note = (
        "Off-target and spill are relative to the target: above 1, another class or another "
        "place fires before the target."
    )
    return WordTable(
        f"{names} kernels of {profile.name}: {profile.title}", heading, list(rows.values()), note
    )


def weight_table(profile: Profile, of: SiteKernel) -> tuple[WordTable, list[list[bool]]]:
    """Return a kernel's weights in the layout of the array, and a mask that marks the site."""
    kernel, position = of.kernel, profile.electrodes.position_mm
    weights = kernel.peak_normalized
    lines = []
    for y in sorted({round(float(y_mm), 6) for y_mm in position[:, 1]}):
        line = [index for index in range(len(position)) if abs(position[index, 1] - y) < 1e-5]
        lines.append(sorted(line, key=lambda index: position[index, 0]))
    certain = f"at most {kernel.gap:.1%} worse than the optimum" if kernel.gap else "proven optimal"
    table = WordTable(
        f"{of.afferent.name} kernel ({kernel.kind}) at site {of.site} of {profile.name}; "
        "positive currents are cathodic",
        [],
        [[f"{weights[index]:+.3f}" for index in line] for line in lines],
        f"off-target {kernel.off_target:.4f} ({kernel.off_target_class.name}), spill "
        f"{kernel.spill:.3f}, sum {weights.sum():+.1e}, node {kernel.node}; {certain}",
    )
    return table, [[index == of.site for index in line] for line in lines]


def _gap(gap: float) -> str:
    return f"{gap:.1%}" if gap else "proven"
