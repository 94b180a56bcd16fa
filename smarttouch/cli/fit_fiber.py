"""``smarttouch fit-fiber``: driving functions fitted to a cable model, and their errors."""

from typing import Annotated

import typer

from smarttouch.cli.options import ArrayOption, JsonOption, QuietOption


def fit_fiber(
    fiber: Annotated[
        str,
        typer.Argument(metavar="fingertip|trunk|mrg", help="mrg needs PyFibers and NEURON."),
    ] = "fingertip",
    profile: ArrayOption = "electric-mouse",
    json_file: JsonOption = None,
    quiet: QuietOption = False,
) -> None:
    """Fit what fires a fiber, and compare with its cable model on kernels not fitted to.

    The MRG model takes an hour or two; if interrupted, it goes on where it was the next time.
    """
    import platformdirs

    from smarttouch.cli.choices import parse_choice
    from smarttouch.files import require_folder, write_json
    from smarttouch.kernels.bank import load_bank
    from smarttouch.kernels.fiber_fits import as_json, error_rows
    from smarttouch.kernels.fiber_fits import fit_fiber as fit
    from smarttouch.monitor.progress import lines_progress
    from smarttouch.physiology.driving import FIBERS
    from smarttouch.profile import load_profile
    from smarttouch.terminal import print_table

    chosen, name = load_profile(profile), parse_choice("fiber", fiber, tuple(FIBERS))
    require_folder(json_file)
    keep = platformdirs.user_cache_path("smarttouch") / "fibers"
    with lines_progress(quiet, "Fitting") as progress:
        fits = fit(chosen, load_bank(chosen), name, progress=progress, keep=keep)
    if json_file is not None:
        write_json(json_file, as_json(fits))
    if not quiet:
        heading, *rows = error_rows(fits)
        print_table(
            rows,
            heading,
            title="Errors of predicted thresholds in %, on kernels not fitted to",
            note="AF: the activating function with the threshold that suits the fitted cases.",
            ruled=True,
            left=2,
        )
