"""``smarttouch design``: the kernels of a profile, as a table and as JSON."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from smarttouch.modes.bank import KernelBank
    from smarttouch.primary import Primary
    from smarttouch.profile import Profile


def design(
    profile: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="Device and finger; see: smarttouch profiles")
    ] = "electric-mouse",
    mode: Annotated[str, typer.Option(metavar="RA|SAI", help="Which afferents to reach.")] = "RA",
    site: Annotated[
        int | None, typer.Option(metavar="N", help="One site, with all its weights.")
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the kernels.")
    ] = None,
    bank_file: Annotated[
        Path | None,
        typer.Option("--bank", metavar="NPZ", help="Design anew, and write the kernel bank."),
    ] = None,
) -> None:
    """Show the kernels of a profile: current patterns that reach one class of afferents."""
    from smarttouch.cli.files import parse_mode, require_folder, write_json
    from smarttouch.cli.progress import bank_progress
    from smarttouch.errors import DesignError
    from smarttouch.modes.bank import design_bank, load_bank, write_bank
    from smarttouch.profile import load_profile

    primary = parse_mode(mode)
    chosen = load_profile(profile)
    for output in (json_file, bank_file):
        require_folder(output)
    count = len(chosen.electrodes)
    if site is not None and not 0 <= site < count:
        raise DesignError(f"site {site} is out of range: {profile} has sites 0 to {count - 1}")
    with bank_progress(quiet=False) as progress:
        if bank_file is None:
            bank = load_bank(chosen, progress)
        else:
            bank = design_bank(chosen, progress)
            write_bank(bank_file, chosen, bank)
    bank.kernels(primary)
    if site is None:
        _print_sites(chosen, bank, primary)
    else:
        _print_kernel(chosen, bank, primary, site)
    if json_file is not None:
        sites = range(count) if site is None else [site]
        write_json(json_file, _table(chosen, bank, primary, sites))


def _table(profile: "Profile", bank: "KernelBank", primary: "Primary", sites: Any) -> Any:
    return {
        "profile": profile.name,
        "mode": primary.name,
        "positive": "cathodic",
        "sites": [
            {
                "site": site,
                "x_mm": float(profile.electrodes.position_mm[site, 0]),
                "y_mm": float(profile.electrodes.position_mm[site, 1]),
                "worst_other": float(bank.worst_other[primary][site]),
                "own_spill": float(bank.own_spill[primary][site]),
                "sum": float(bank.weights[primary][site].sum(dtype=float)),
                "weights": [float(weight) for weight in bank.weights[primary][site]],
            }
            for site in sites
        ],
    }


def _print_sites(profile: "Profile", bank: "KernelBank", primary: "Primary") -> None:
    import numpy as np
    from rich.console import Console
    from rich.table import Table

    table = Table(
        title=f"{primary.name} kernels of {profile.name}: {profile.title}", title_justify="left"
    )
    for heading in ("site", "x mm", "y mm", "worst other", "own spill", "total |w|"):
        table.add_column(heading, justify="right")
    for site, (x, y) in enumerate(profile.electrodes.position_mm):
        table.add_row(
            str(site),
            f"{x:.2f}",
            f"{y:.2f}",
            f"{bank.worst_other[primary][site]:.4f}",
            f"{bank.own_spill[primary][site]:.3f}",
            f"{np.abs(bank.weights[primary][site]).sum():.2f}",
        )
    console = Console()
    console.print(table)
    console.print(
        "Worst other and own spill are activations of the target's own; "
        "--site N shows the weights.",
        style="dim",
    )


def _print_kernel(profile: "Profile", bank: "KernelBank", primary: "Primary", site: int) -> None:
    from rich.console import Console
    from rich.table import Table

    weights = bank.weights[primary][site]
    position = profile.electrodes.position_mm
    rows = sorted({round(float(y), 6) for y in position[:, 1]})
    table = Table(
        title=f"{primary.name} kernel at site {site} of {profile.name}, positive cathodic",
        title_justify="left",
        show_header=False,
    )
    for row in rows:
        in_row = [index for index in range(len(position)) if abs(position[index, 1] - row) < 1e-5]
        in_row.sort(key=lambda index: position[index, 0])
        style = {site: "bold reverse"}
        table.add_row(
            *(
                f"[{style[index]}]{weights[index]:+.3f}[/]"
                if index in style
                else f"{weights[index]:+.3f}"
                for index in in_row
            )
        )
    console = Console()
    console.print(table)
    console.print(
        f"worst other {bank.worst_other[primary][site]:.4f}, "
        f"own spill {bank.own_spill[primary][site]:.3f}, sum {weights.sum(dtype=float):+.1e}"
    )
