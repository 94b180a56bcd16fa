"""``smarttouch design``: the kernels of a profile, as tables, JSON and pictures."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from smarttouch.cli.kernels import Shown
    from smarttouch.kernels.bank import KernelBank
    from smarttouch.kernels.problem import Kernel
    from smarttouch.primary import Primary
    from smarttouch.profile import Profile


def design(
    profile: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="Device and finger; see: smarttouch profiles")
    ] = "electric-mouse",
    mode: Annotated[
        str | None, typer.Option(metavar="RA|SAI|PC", help="Which afferents to reach; all if none.")
    ] = None,
    site: Annotated[
        int | None, typer.Option(metavar="N", help="One site, with all its weights.")
    ] = None,
    robust: Annotated[
        bool, typer.Option("--robust", help="Best on the worst finger of the profile's spread.")
    ] = False,
    three_state: Annotated[
        bool, typer.Option("--three-state", help="Cathode, anode or insulated, from one source.")
    ] = False,
    any_node: Annotated[
        bool, typer.Option("--any-node", help="Brute force over the activated node.")
    ] = False,
    compare: Annotated[
        bool, typer.Option("--compare", help="All kinds of kernels, nominal and worst finger.")
    ] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the kernels.")
    ] = None,
    plot_file: Annotated[
        Path | None,
        typer.Option("--plot", metavar="PNG", help="Draw one site (the middle one if no --site)."),
    ] = None,
    bank_file: Annotated[
        Path | None,
        typer.Option("--bank", metavar="NPZ", help="Design anew, and write the kernel bank."),
    ] = None,
) -> None:
    """Show the kernels of a profile: current patterns that reach one class of afferents."""
    from smarttouch.cli import kernels
    from smarttouch.cli.files import parse_primary, require_folder, require_site, write_json
    from smarttouch.cli.progress import bank_progress
    from smarttouch.errors import DesignError, SmartTouchError
    from smarttouch.kernels.bank import find_bank, load_bank, make_bank
    from smarttouch.kernels.switching import possible_modes
    from smarttouch.profile import load_profile

    primary = None if mode is None else parse_primary(mode)
    chosen = load_profile(profile)
    for output in (json_file, plot_file, bank_file):
        require_folder(output)
    special = [
        name
        for name, asked in (
            ("--robust", robust and not three_state), ("--three-state", three_state),
            ("--any-node", any_node), ("--compare", compare), ("--bank", bank_file is not None),
        )
        if asked
    ]  # fmt: skip
    if len(special) > 1:
        message = f"{' and '.join(special)} do not go together: give one of them"
        raise SmartTouchError(message, about=special[0], problem="conflict", value=tuple(special))
    if site is not None:
        require_site(chosen, site)
    modes = possible_modes(chosen)
    if primary is not None:
        if primary not in modes and not special:
            offered = tuple(each.name for each in modes)
            raise DesignError(
                f"mode {primary.name} is not possible with the board of {profile}: it offers "
                f"{', '.join(offered) or 'none'}",
                about="--mode",
                problem="impossible",
                value=primary.name,
                allowed=offered,
            )
        modes = [primary]
    sites = chosen.driven.tolist() if site is None else [site]
    with bank_progress(quiet=False) as progress:
        if compare:
            shown = _compared(chosen, modes, sites, progress)
        elif bank_file is not None:
            shown = _from_bank(chosen, make_bank(bank_file, chosen, progress), modes, sites)
        elif special:
            shown = _designed(chosen, modes, sites, special[0], robust, progress)
        else:
            # One site of a large array is not worth its whole bank.
            bank = load_bank(chosen, progress) if site is None else find_bank(chosen)
            if bank is not None:
                shown = _from_bank(chosen, bank, modes, sites)
            else:
                shown = _designed(chosen, modes, sites, None, False, progress)
    if compare:
        kernels.print_comparison(chosen, shown)
    elif site is None:
        kernels.print_sites(chosen, shown)
    else:
        for each in shown:
            kernels.print_kernel(chosen, each)
    if json_file is not None:
        write_json(json_file, kernels.as_json(chosen, shown))
    if plot_file is not None:
        _plot(chosen, shown, plot_file)


def _from_bank(
    profile: "Profile",
    bank: "KernelBank",
    modes: Sequence["Primary"],
    sites: Sequence[int],
) -> list["Shown"]:
    from smarttouch.cli.kernels import Shown
    from smarttouch.kernels.switching import kind_of

    kind = kind_of(profile)
    return [
        Shown(mode, site, bank.kernel(mode, site, kind), float(bank.seconds[mode][site]))
        for mode in modes
        for site in sites
    ]


def _designed(
    profile: "Profile",
    modes: Sequence["Primary"],
    sites: Sequence[int],
    asked: str | None,
    robust: bool,
    progress: Any,
) -> list["Shown"]:
    from smarttouch.cli.kernels import Shown
    from smarttouch.kernels.batch import design_sites
    from smarttouch.kernels.design import design_any_node, design_kernel
    from smarttouch.kernels.problem import Problem
    from smarttouch.kernels.switching import design_three_state, designer

    design_one = {
        None: designer(profile),
        "--robust": design_kernel,
        "--three-state": design_three_state,
        "--any-node": design_any_node,
    }[asked]
    shown = []
    for index, mode in enumerate(modes):

        def advance(done: int, total: int, index: int = index) -> None:
            progress(index * total + done, len(modes) * total)

        problem = Problem(profile, mode, spread=robust)
        timed = design_sites(problem, design_one, sites, advance)
        shown += [Shown(mode, site, *each) for site, each in zip(sites, timed, strict=True)]
    return shown


def _compared(
    profile: "Profile", modes: Sequence["Primary"], sites: Sequence[int], progress: Any
) -> list["Shown"]:
    from smarttouch.cli.kernels import Shown
    from smarttouch.kernels.comparison import compare

    shown = []
    for index, mode in enumerate(modes):

        def advance(done: int, total: int, index: int = index) -> None:
            progress(index * total + done, len(modes) * total)

        shown += [
            Shown(mode, each.site, each.kernel, each.seconds, each.variant, each.worst_finger)
            for each in compare(profile, mode, sites, advance)
        ]
    return shown


def _plot(profile: "Profile", shown: Sequence["Shown"], path: Path) -> None:
    import numpy as np

    from smarttouch.plotting.kernels import kernel_figure
    from smarttouch.plotting.style import save

    sites = sorted({each.site for each in shown})
    away = np.linalg.norm(profile.electrodes.position_mm[sites], axis=1)
    site = sites[int(away.argmin())]
    drawn: dict[Primary, Kernel] = {}
    for each in shown:
        if each.site == site:
            # Where kinds are compared, the first one, the weighted, is drawn.
            drawn.setdefault(each.primary, each.kernel)
    save(kernel_figure(profile, drawn, site), path)
