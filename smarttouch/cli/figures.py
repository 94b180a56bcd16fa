"""``smarttouch figures``: the paper's figures redrawn, and those of a user's own array."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from smarttouch import terminal
from smarttouch.cli.options import ArrayOption
from smarttouch.files import make_folder, write_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figures(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Where to; made if missing.")],
    profile: ArrayOption = "electric-mouse",
    site: Annotated[
        int | None, typer.Option(metavar="N", help="Whose kernels; the middle one if none.")
    ] = None,
    kind: Annotated[str, typer.Option("--format", metavar="png|pdf|svg")] = "png",
) -> None:
    """Redraw the paper's Fig. 2, 5, 8, 9 and 10; draw kernels, activation, shared slots, fibers."""
    import numpy as np

    from smarttouch.cli.choices import require_site
    from smarttouch.errors import SmartTouchError, not_offered
    from smarttouch.kernels.bank import load_bank
    from smarttouch.kernels.switching import kind_of
    from smarttouch.monitor.progress import bank_progress
    from smarttouch.physiology import af_error
    from smarttouch.plotting import colors, fibers, frames, kernels, paper, style
    from smarttouch.profile import load_profile
    from smarttouch.terminal import print_table

    if kind not in style.FORMATS:
        raise not_offered("kind", kind, style.FORMATS)
    chosen, line = load_profile(profile), load_profile("line-7")
    if site is None:
        site = int(np.linalg.norm(chosen.electrodes.position_mm, axis=1).argmin())
    require_site(chosen, site)
    style.new_figure(1, 1)
    try:
        make_folder(folder)
    except OSError as error:
        message = f"cannot make the folder {folder}: {error.strerror}"
        raise SmartTouchError(message, about="folder", problem="unwritable", value=folder) from None
    with bank_progress(quiet=False) as progress:
        bank = load_bank(chosen, progress)
    own = {each: bank.kernel(each, site, kind_of(chosen)) for each in sorted(bank.weights)}
    console = terminal.console(stderr=True)
    drawings: dict[str, Callable[[], Figure]] = {
        "fig-2": colors.thresholds_figure,
        "fig-5": lambda: paper.figure_5(line),
        "fig-8": lambda: paper.figure_8(line),
        "fig-9": lambda: paper.figure_9(line),
        "fig-10": lambda: paper.figure_10(line),
        f"kernels-{chosen.name}": lambda: kernels.kernel_figure(chosen, own, site),
        f"strength-duration-{chosen.name}": lambda: fibers.strength_duration_figure(chosen),
    }
    if frames.drawable(chosen):
        drawings["frames"] = lambda: frames.frame_figure(chosen, bank)
    for name, draw in drawings.items():
        with console.status(f"drawing {name}"):
            style.save(draw(), folder / f"{name}.{kind}")
        print(folder / f"{name}.{kind}")
    with console.status("looking for the thresholds of fibers"):
        table = af_error.af_error_table(chosen)
    name = f"af-against-cable-{chosen.name}"
    style.save(fibers.af_error_figure(table), folder / f"{name}.{kind}")
    print(folder / f"{name}.{kind}")
    write_bytes(folder / f"{name}.csv", af_error.as_csv(table).encode())
    print(folder / f"{name}.csv")
    heading, *rows = af_error.ratio_rows(table)
    print_table(
        rows,
        heading,
        title="Threshold by the AF over that of the cable model, by depth in mm",
        note="1 is right; below 1 the AF thinks the fiber easier to fire than it is. All "
        "predictions follow from one threshold, that of the flat fiber under a cathode at 0.9 mm.",
        ruled=True,
        left=2,
    )
