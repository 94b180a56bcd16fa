"""``smarttouch design`` and ``profiles``: show kernels; list, show and create profiles."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smarttouch.cli.options import (
    ArrayOption,
    Commands,
    JsonOption,
    argument,
    option,
    output_file,
    parse_afferent,
    require_site,
)
from smarttouch.views.printable_output import print_table

if TYPE_CHECKING:
    from smarttouch.kernels.kernel_report import WordTable


def design(
    site: Annotated[
        int | None, argument("Show all weights of this site (default: list all sites).", "SITE")
    ] = None,
    profile: ArrayOption = "electric-mouse",
    mode: Annotated[
        str | None,
        option("Choose the class to stimulate: RA, SAI or PC (default: all).", "RA|SAI|PC"),
    ] = None,
    any_node: Annotated[
        bool, option("Search the whole axon for the best target node.", None, "--any-node")
    ] = False,
    json_file: JsonOption = None,
    plot_file: Annotated[
        Path | None,
        output_file("Draw the kernels of the site (default: of the middle site).", "PNG", "--plot"),
    ] = None,
) -> None:
    """Show kernels: currents that stimulate one class.

    The kernels of a new profile are designed once and stored for later runs.
    """
    from smarttouch.base.files import write_json
    from smarttouch.kernels import kernel_report
    from smarttouch.kernels.switched_design import possible_modes
    from smarttouch.profile import load_profile
    from smarttouch.views.progress import bank_progress

    afferent = None if mode is None else parse_afferent(mode)
    chosen = load_profile(profile)
    if site is not None:
        require_site(chosen, site)
    modes = possible_modes(chosen) if afferent is None else [afferent]
    with bank_progress() as progress:
        shown = kernel_report.find_kernels(chosen, modes, site, any_node, progress)
    if site is None:
        _print(kernel_report.site_table(chosen, shown))
    else:
        for kernel in shown:
            _print(*kernel_report.weight_table(chosen, kernel))
    if json_file is not None:
        write_json(json_file, kernel_report.as_json(chosen, shown))
    if plot_file is not None:
        from smarttouch.views.figure_style import save
        from smarttouch.views.kernel_figures import kernel_figure

        middle, drawn = kernel_report.middle_kernels(chosen, shown)
        save(kernel_figure(chosen, drawn, middle), plot_file)


def _print(table: "WordTable", marked: Sequence[Sequence[bool]] = ()) -> None:
    from rich.text import Text

    rows: list[list[Any]] = [list(row) for row in table.rows]
    for row, marks in zip(rows, marked, strict=False):
        row[:] = [Text(cell, "bold reverse" * mark) for cell, mark in zip(row, marks, strict=True)]
    print(table.title)
    print_table(rows, table.heading, left=0)
    print(table.note)


profiles: Commands = Commands(
    help="List the shipped profiles, show one, and make your own.", invoke_without_command=True
)

_Name = Annotated[str, argument("Name of a shipped profile, or a profile file.", "NAME|FILE")]


@profiles.callback()
def list_profiles(context: typer.Context) -> None:
    if context.invoked_subcommand is not None:
        return
    from smarttouch.profile import DEFAULT_PROFILE, list_profiles, load_profile

    rows = []
    for name in list_profiles():
        profile = load_profile(name)
        star = " (default)" if name == DEFAULT_PROFILE else ""
        pulse = profile.pulse
        board = f"{profile.output.kind}, {pulse.width_us} µs, {pulse.rate_hz:g} Hz"
        rows.append((name + star, profile.title, board))
    print_table(
        rows,
        ("name", "description", "board"),
        left=3,
    )
    print(
        "Make your own with 'smarttouch profiles new FILE --like NAME', and use it with --profile."
    )


@profiles.command()
def show(
    name: _Name = "",
    kicad: Annotated[
        Path | None, option("Also write the array as a KiCad board into this folder.", "DIR")
    ] = None,
    svg: Annotated[Path | None, output_file("Also draw the array in true size.", "SVG")] = None,
    levels: Annotated[
        Path | None, output_file("Also draw the comfortable current over time.", "PNG")
    ] = None,
) -> None:
    """Print all values of a profile, including defaults and calibrations."""
    from smarttouch.base.errors import ProfileError
    from smarttouch.base.files import write_bytes
    from smarttouch.kernels import array_circuit_board
    from smarttouch.profile import DEFAULT_PROFILE, load_profile
    from smarttouch.profile.toml_files import as_toml

    chosen = load_profile(name or DEFAULT_PROFILE)
    if svg is not None:
        write_bytes(svg, array_circuit_board.drawing(chosen))
    if kicad is not None:
        array_circuit_board.write_kicad(chosen, kicad)
    if levels is not None:
        from smarttouch.profile.settled_levels import read_levels
        from smarttouch.views.figure_style import new_figure, plain, save

        if not (log := read_levels(chosen)):
            raise ProfileError(
                f"no comfort level is logged for {chosen.name}: hold an intensity for 10 s in a run"
            )
        figure = new_figure(6, 3)
        plain(axes := figure.subplots(), chosen.name, "time, UTC", "comfortable current, mA")
        for mode in dict.fromkeys(settled.mode for settled in log):
            kept = [(settled.time, settled.current_ma) for settled in log if settled.mode == mode]
            axes.plot(*zip(*kept, strict=True), "o-", label=mode)
        axes.legend(fontsize=7)
        save(figure, levels)
    typer.echo(as_toml(chosen), nl=False)


@profiles.command()
def new(
    files: Annotated[
        list[Path],
        argument(
            "The profile to write. For a new array, give two files: a CSV table of its electrodes "
            "(columns x_mm, y_mm and optionally diameter_mm), then the profile.",
            "[TABLE.csv] FILE.toml",
        ),
    ],
    grid: Annotated[str, option("Use a grid instead of a table.", "ROWSxCOLUMNS")] = "",
    pitch_mm: Annotated[float, option("Set the pitch of the grid.", "MM", "--pitch")] = 2.0,
    like: Annotated[str, option("Start from this profile.", "NAME|FILE")] = "electric-mouse",
    overwrite: Annotated[bool, option("Replace the file.", None, "--overwrite")] = False,
) -> None:
    """Write a new profile: a copy of another profile, or a profile for another array."""
    from smarttouch.base.errors import ProfileError
    from smarttouch.base.files import write_bytes
    from smarttouch.experiments.contact_and_force_calibration import ProfileFile
    from smarttouch.profile.electrodes import grid_of
    from smarttouch.profile.toml_files import as_toml

    *tables, file = files
    if len(tables) + bool(grid) > 1:
        raise ProfileError(
            "several arrays: give one table or --grid. To copy --like, give neither", key="table"
        )
    copied = ProfileFile(like, file, overwrite)
    if not tables and not grid:
        copied.write()
        typer.echo(f"written: {copied.output}")
        return
    table = grid_of(grid, pitch_mm) if grid else tables[0]
    title = table.stem if isinstance(table, Path) else str(table)
    changed = copied.profile.with_electrodes(table, f"{title}, otherwise like {like}")
    write_bytes(file, as_toml(changed).encode(), ProfileError)
    kind = changed.output.kind
    typer.echo(f"written: {file}, {len(changed.electrodes)} electrodes, output.kind = {kind}")
