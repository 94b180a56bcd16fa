"""``smarttouch live``, ``mouse``, ``color`` and ``stop``: current in the skin, and its end."""

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from smarttouch.cli.options import ModeOption, RateOption, takes_options
from smarttouch.cli.run_options import RunOptionGroup
from smarttouch.cli.source_options import or_standard_input
from smarttouch.views.keys_and_signals import drives_a_board

if TYPE_CHECKING:
    from smarttouch.base.afferent import Afferent
    from smarttouch.instruments.receptor_responses import ReceptorResponse
    from smarttouch.instruments.skin_trace import Trace


@drives_a_board
@takes_options()
def live(
    run: RunOptionGroup,
    source: Annotated[
        str | None,
        typer.Argument(
            callback=or_standard_input,
            metavar="SOURCE",
            help="A file, words, or a source by its URL: page:, text:, camera:, video:, frames:, "
            "serial-array:, brltty:, draw:, osc:, lsl:, socket:, mcap:, recording:. Options "
            "follow: scan.png?dpi=300&speed_mm_s=40. A sample page is shown without one.",
        ),
    ] = None,
    mode: ModeOption = "RA",
    rate_hz: RateOption = None,
    seed: Annotated[
        int | None, typer.Option(metavar="N", min=0, help="Seed of all simulated noise.")
    ] = None,
    light_on_dark: Annotated[
        bool,
        typer.Option("--light-on-dark", show_default=False, help="Print is lighter than paper."),
    ] = False,
) -> None:
    """Show on the finger what a source sees, until it ends, a key or Ctrl-C."""
    from smarttouch.base.afferent import Mode
    from smarttouch.base.files import data_folder
    from smarttouch.cli.options import parse_mode
    from smarttouch.instruments.pushed_stimuli import PushedStimuli
    from smarttouch.sources import open_source

    chosen = run.load_profile()
    url = source or f"page:{data_folder('sample_images') / 'page.png'}"
    with open_source(url, chosen, light_on_dark=light_on_dark, seed=seed) as opened:
        color = mode.lower() == Mode.COLOR and isinstance(opened, PushedStimuli)
        driven = Mode.COLOR if color else parse_mode(mode)
        config = run.config(driven, rate_hz=rate_hz, light_on_dark=light_on_dark, seed=seed or 0)
        run.start(opened, chosen, config, keys=opened.keys, keys_help=opened.keys_help)


@drives_a_board
@takes_options(scan="points")
def mouse(
    run: RunOptionGroup,
    texture: Annotated[
        str,
        typer.Option(
            metavar="WHAT",
            help="grating:4mm,30deg, text:WORDS, an image (ink is high) or a height map (16 bits "
            "or .npy: bright is high). Options follow: wood.png?dpi=300&tiled; also width_mm, "
            "grain_mm, light_on_dark.",
        ),
    ] = "grating:4mm",
    motion: Annotated[
        str,
        typer.Option(
            metavar="URL",
            help="sweep: (a virtual hand), sweep:ROUNDS?speed_mm_s=40&seed=1, "
            "evdev:DEVICE?cpi=800&grab (a mouse), window: (the pointer), path:CSV, or a source "
            "that knows its pose, e.g. camera:0.",
        ),
    ] = "sweep:",
    mode: Annotated[
        str, typer.Option("--mode", metavar="CLASS", help="Class that answers: RA, SAI or PC.")
    ] = "RA",
    rate_hz: Annotated[
        float, typer.Option("--rate", metavar="HZ", help="Frames per second.")
    ] = 100.0,
) -> None:
    """Feel a texture that stays in place while the hand moves.

    Each electrode pulses when a ridge passes under it, and not at rest.
    """
    from smarttouch.cli.options import parse_mode
    from smarttouch.imaging.array_window import profile_for_reading, reading_force_n
    from smarttouch.instruments.electric_mouse import MouseSource, open_motion_over
    from smarttouch.instruments.relief import open_texture

    own, driven = run.load_profile(), parse_mode(mode)
    chosen = profile_for_reading(own)
    surface = open_texture(texture)
    with open_motion_over(surface, motion, own) as moves:
        source = MouseSource(
            surface, moves, chosen, driven, rate_hz, press_n=reading_force_n(chosen)
        )
        source.url = texture
        run.start(source, chosen, run.config(driven))


@drives_a_board
@takes_options(scan="points")
def color(
    run: RunOptionGroup,
    source: Annotated[
        str,
        typer.Argument(
            metavar="SPEC|CSV",
            help="What the skin is to feel, as in tone:30Hz,8um+press:0.5N (also noise:60-400Hz,3um"
            " and sweep:5-500Hz,5um, a part of the time as in tone:250Hz,2um@0.5-1), or a file "
            "with time_s and displacement_um or force_n, or frequency_hz and amplitude_um.",
        ),
    ],
    sites: Annotated[
        str | None,
        typer.Option(
            metavar="LIST",
            help="Electrodes that pulse, e.g. 27,28,35-36, or all.",
        ),
    ] = None,
    split_only: Annotated[
        bool, typer.Option("--split-only", help="Say what each class answers; no board.")
    ] = False,
    seed: Annotated[
        int, typer.Option(metavar="N", min=0, help="Of noise, and of phases a spectrum has not.")
    ] = 0,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="PNG", help="Draw the trace, the answers and the pulses."),
    ] = None,
) -> None:
    """Split a vibration into what RA, SAI and PC answer, and let the finger feel it mixed again.

    It lasts 2 s, or as long as its file; intensity rises in the first half second.
    """
    from smarttouch.base.afferent import Afferent
    from smarttouch.base.files import require_folder
    from smarttouch.base.terminal import print_table
    from smarttouch.imaging.array_window import reading_force_n
    from smarttouch.instruments.color_mix import mix_answers, parse_places
    from smarttouch.instruments.color_source import (
        ColorSource,
        as_figures,
        draw_mixture,
        mixture_rows,
        notes,
        pacinian_crosstalk,
    )
    from smarttouch.instruments.receptor_responses import split_trace
    from smarttouch.instruments.skin_trace import is_spec, open_trace
    from smarttouch.kernels.bank import load_bank
    from smarttouch.views.progress import bank_progress

    require_folder(plot)
    if plot is not None:
        from smarttouch.views import figure_style

        figure_style.require_drawable(plot)
    json_file = run.json_file
    trace = open_trace(source, 2.0 if run.seconds is None else run.seconds, seed)
    chosen = run.load_profile()
    answers = split_trace(
        trace, sai_full_n=chosen.force.full_n, sai_rate_hz=chosen.pulse.sai_rate_hz
    )
    if split_only:
        _show_answers(run, trace, answers, source, plot)
        return
    with bank_progress(run.quiet) as progress:
        bank = load_bank(chosen, progress)
    places = parse_places(chosen, sites, None)
    shaken = run.vibrators is not None
    timing = run.display(chosen).board.timing
    mixture = mix_answers(answers, trace.duration_s, chosen, bank, places, timing, shaken)
    seconds = None if is_spec(source) else run.seconds
    config = run.config(mixture.mode, seconds=seconds, seed=seed)
    vibration = ColorSource(source, chosen, mixture, reading_force_n(chosen))
    vibration.url = source
    vibration.notes += notes(mixture, answers)
    crosstalk = None
    if mixture.pulses(Afferent.PC):
        crosstalk = pacinian_crosstalk(chosen, bank, mixture.sites)
        vibration.notes.append(str(crosstalk))
    run.start(vibration, chosen, config)
    if json_file is not None:
        _add(json_file, as_figures(answers, mixture, vibration, crosstalk))
    if plot is not None:
        figure_style.save(draw_mixture(trace, answers, mixture), plot)
    if not run.quiet:
        print_table(
            mixture_rows(answers, mixture, vibration),
            ("class", "drive", "share", "fires at", "pulses", "at", "off by, ms"),
            title=f"{source}, at {len(mixture.sites)} sites",
            note="Pulses: sent to each site, and how many a second. Off by: from their own time, "
            "p50 / max.",
        )


def _show_answers(
    run: RunOptionGroup,
    trace: "Trace",
    answers: "dict[Afferent, ReceptorResponse]",
    source: str,
    plot: Path | None,
) -> None:
    """Draw, write and print the response of each class, as far as the options ask for it."""
    from smarttouch.base.files import write_json
    from smarttouch.base.terminal import print_table
    from smarttouch.instruments.color_source import answer_rows, as_figures, draw_mixture
    from smarttouch.views import figure_style

    if plot is not None:
        figure_style.save(draw_mixture(trace, answers), plot)
    if run.json_file is not None:
        write_json(run.json_file, as_figures(answers))
    if not run.quiet:
        print_table(
            answer_rows(answers),
            ("class", "drive", "peak", "fires at", "share"),
            title=source,
            note="Drive: from threshold (0) to full (1), mean over the trace. Fires at: its "
            "afferents, while they do. Share: of the drive of all.",
        )


def _add(path: Path, figures: dict[str, object]) -> None:
    """Add the figures of the colors to those of the run."""
    from smarttouch.base.errors import SmartTouchError
    from smarttouch.base.files import parse_json, read_bytes, write_json

    write_json(path, parse_json(read_bytes(path, SmartTouchError)) | {"color": figures})


def stop(
    url: Annotated[
        str | None,
        typer.Argument(metavar="BOARD", help="A board that is put at zero, by its URL, as well."),
    ] = None,
) -> None:
    """End every run of this user with all electrodes at zero, and wait for it.

    Runs that are still starting are canceled, too.
    """
    from smarttouch.boards.announced import stop_all

    asked = stop_all()
    typer.echo(f"{asked} stopped." if asked else "Nothing runs.")
    if url is not None:
        # A board is at zero once it was opened and closed: by a program that was not stopped.
        looks = [sys.executable, "-m", "smarttouch", "devices", "show", url]
        if subprocess.run(looks, stdout=subprocess.DEVNULL, check=False).returncode:
            raise typer.Exit(2)
        typer.echo(f"All electrodes of {url} are at zero.")
