"""Kernels as tables to read and as JSON."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from smarttouch import terminal

if TYPE_CHECKING:
    from rich.table import Table

    from smarttouch.kernels.problem import Kernel
    from smarttouch.primary import Primary
    from smarttouch.profile import Profile


@dataclass(frozen=True, eq=False)
class Shown:
    """A kernel with what is told about it; the last two only where kinds are compared."""

    primary: "Primary"
    site: int
    kernel: "Kernel"
    seconds: float
    variant: str = ""
    worst_finger: "Kernel | None" = None


def as_json(profile: "Profile", shown: Sequence[Shown]) -> dict[str, Any]:
    """Return kernels as a JSON object; weights in mA per V/mm², cathodic positive."""
    return {
        "profile": profile.name,
        "positive": "cathodic",
        "weights_unit": "mA for an activating function of 1 V/mm² at the target",
        "kernels": [_one_as_json(profile, each) for each in shown],
    }


def _one_as_json(profile: "Profile", shown: Shown) -> dict[str, Any]:
    import numpy as np

    kernel, (x_mm, y_mm) = shown.kernel, profile.electrodes.position_mm[shown.site]
    table: dict[str, Any] = {
        "mode": shown.primary.name,
        "site": shown.site,
        "x_mm": float(x_mm),
        "y_mm": float(y_mm),
        "weights": kernel.weights.tolist(),
        "worst_other": float(kernel.worst_other),
        "worst_other_class": kernel.worst_other_class.name,
        "own_spill": float(kernel.own_spill),
        "sum": float(kernel.weights.sum()),
        "total_current": float(np.abs(kernel.weights).sum()),
        "activated_node": kernel.node,
        "kind": kernel.kind,
        "optimal": kernel.gap == 0,
        "gap": float(kernel.gap),
        "seconds": float(shown.seconds),
    }
    if shown.variant:
        worst = shown.worst_finger
        table |= {
            "variant": shown.variant,
            "worst_other_over_spread": worst and float(worst.worst_other),
            "own_spill_over_spread": worst and float(worst.own_spill),
        }
    return table


def print_sites(profile: "Profile", shown: Sequence[Shown]) -> None:
    """Print one row for each site, with what its kernel of each mode reaches."""
    modes = sorted({each.primary for each in shown})
    heading = ["site", "x mm", "y mm"]
    for mode in modes:
        heading += [f"{mode.name} other", "spill"] if len(modes) > 1 else [
            "worst other", "of", "own spill", "total |w|/peak", "gap",
        ]  # fmt: skip
    rows: dict[int, list[str]] = {}
    for each in shown:
        x, y = profile.electrodes.position_mm[each.site]
        row = rows.setdefault(each.site, [str(each.site), f"{x:.2f}", f"{y:.2f}"])
        kernel = each.kernel
        row += [f"{kernel.worst_other:.4f}", f"{kernel.own_spill:.3f}"]
        if len(modes) == 1:
            total = abs(kernel.peak_normalized).sum()
            row.insert(-1, kernel.worst_other_class.name)
            row += [f"{total:.2f}", f"{kernel.gap:.1%}" if kernel.gap else "proven"]
    names = " and ".join(mode.name for mode in modes)
    _print(
        _table(f"{names} kernels of {profile.name}: {profile.title}", heading, rows.values()),
        "Worst other and own spill are activations of the target's own: above 1 another class "
        "fires first. --site N shows weights.",
    )


def print_kernel(profile: "Profile", shown: Shown) -> None:
    """Print the weights of one kernel where they lie on the array, the largest magnitude 1."""
    from rich.text import Text

    kernel, position = shown.kernel, profile.electrodes.position_mm
    weights = kernel.peak_normalized
    rows = []
    for y in sorted({round(float(each), 6) for each in position[:, 1]}):
        in_row = [index for index in range(len(position)) if abs(position[index, 1] - y) < 1e-5]
        in_row.sort(key=lambda index: position[index, 0])
        cells = [f"{weights[index]:+.3f}" for index in in_row]
        rows.append(
            [
                Text(cell, "bold reverse") if index == shown.site else Text(cell)
                for index, cell in zip(in_row, cells, strict=True)
            ]
        )
    title = (
        f"{shown.primary.name} kernel ({kernel.kind}) at site {shown.site} of {profile.name}, "
        "positive cathodic"
    )
    certain = f"within {kernel.gap:.1%} of the best possible" if kernel.gap else "proven optimal"
    _print(
        _table(title, None, rows),
        f"worst other {kernel.worst_other:.4f} ({kernel.worst_other_class.name}), own spill "
        f"{kernel.own_spill:.3f}, sum {weights.sum():+.1e}, node {kernel.node}; {certain}",
    )


def print_comparison(profile: "Profile", shown: Sequence[Shown]) -> None:
    """Print what each kind of kernel reaches, the worst of all sites asked for."""
    heading = ["mode", "kernel", "other", "spill", "loss", "other *", "spill *", "gap"]
    groups: dict[tuple[Primary, str], list[Shown]] = {}
    for each in shown:
        groups.setdefault((each.primary, each.variant), []).append(each)
    rows = []
    for (mode, variant), group in groups.items():
        best = [each.kernel.worst_other for each in groups[mode, "weighted"]]
        losses = [each.kernel.worst_other / b - 1 for each, b in zip(group, best, strict=True)]
        worst = [each.worst_finger for each in group if each.worst_finger is not None]
        on_worst = ["does not fire", "–"]
        if len(worst) == len(group):
            on_worst = [f"{max(each.worst_other for each in worst):.4f}"]
            on_worst.append(f"{max(each.own_spill for each in worst):.3f}")
        gap = max(each.kernel.gap for each in group)
        rows.append(
            [
                mode.name,
                variant,
                f"{max(each.kernel.worst_other for each in group):.4f}",
                f"{max(each.kernel.own_spill for each in group):.3f}",
                f"{max(losses):+.1%}" if variant != "weighted" else "",
                *on_worst,
                f"{gap:.1%}" if gap else "proven",
            ]
        )
    sites = len({each.site for each in shown})
    where = f"site {shown[0].site}" if sites == 1 else f"the worst of {sites} sites"
    _print(
        _table(f"Kinds of kernels on {profile.name}, {where}", heading, rows),
        "Other: largest AF of another class, of the target's. Loss: by how much it exceeds the "
        "weighted kernel's. *: on the worst finger of the profile's skin.spread. Gap: how much "
        "better a switching could be at most.",
    )


def _table(title: str, heading: Sequence[str] | None, rows: Any) -> "Table":
    from rich.table import Table

    table = Table(title=title, title_justify="left", show_header=heading is not None)
    for name in heading or ():
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    return table


def _print(table: "Table", note: str) -> None:
    console = terminal.console()
    console.print(table)
    console.print(note, style="dim")
