"""``smarttouch finger``: what simulated fingers feel of letters, and a picture of one."""

from typing import Annotated

import typer

from smarttouch.cli.options import AnatomyOption, ArrayOption, JsonOption, QuietOption

_NAMES = {
    "silent_points": "silent points",
    "wrong_class": "spikes of another class",
    "misplaced": "misplaced spikes",
    "median": "error rate at the nerve, median",
    "worst_tenth": "error rate at the nerve, worst tenth",
    "nociceptive": "current over full comfort at which a pain fiber fires (a rough model)",
}


def finger(
    letters: Annotated[
        str | None, typer.Argument(metavar="LETTERS", help="A to Z if none.")
    ] = None,
    profile: ArrayOption = "electric-mouse",
    mode: Annotated[str, typer.Option(metavar="RA|SAI|PC", help="Whose receptors.")] = "RA",
    anatomy: AnatomyOption = "branched",
    fingers: Annotated[
        int, typer.Option(min=1, max=1000, metavar="N", help="So many, by seeds from 1 on.")
    ] = 10,
    plot_file: Annotated[
        str | None, typer.Option("--plot", metavar="PNG", help="Draw the first letter on finger 1.")
    ] = None,
    table: Annotated[
        str | None,
        typer.Option(
            metavar="effects|published",
            help="Print instead what was published beside what fingers show.",
        ),
    ] = None,
    json_file: JsonOption = None,
    quiet: QuietOption = False,
) -> None:
    """Put letters on simulated fingers: which afferents fire, where, and what is read of it."""
    from pathlib import Path

    if table is not None:
        from smarttouch.cli import finger_tables
        from smarttouch.cli.choices import parse_choice

        chosen_table = parse_choice("table", table, finger_tables.NAMES)
        finger_tables.print_comparison(chosen_table, letters, anatomy, fingers, json_file, quiet)
        return

    from smarttouch.afferent import Mode
    from smarttouch.cli.choices import parse_afferent
    from smarttouch.files import require_folder, write_json
    from smarttouch.kernels.bank import load_bank
    from smarttouch.monitor.progress import lines_progress
    from smarttouch.physiology.finger import Finger
    from smarttouch.profile import load_profile
    from smarttouch.psychophysics import letters_felt
    from smarttouch.psychophysics.letters import ALPHABET
    from smarttouch.psychophysics.nociceptive import bystander_margins
    from smarttouch.terminal import print_table

    chosen, driven = load_profile(profile), Mode(parse_afferent(mode).name)
    drawn = ALPHABET if letters is None else letters_felt.require_letters(letters)
    picture = None if plot_file is None else Path(plot_file)
    for output in (json_file, picture):
        require_folder(output)
    bank = load_bank(chosen)
    with lines_progress(quiet, "Feeling letters") as progress:
        found = letters_felt.feel_letters(
            chosen, bank, driven, anatomy, range(1, fingers + 1), drawn, progress
        )
    figures = letters_felt.summary(found)
    at_board = letters_felt.error_at_board(chosen, bank, driven, drawn)
    margin = bystander_margins(chosen, bank, driven, anatomy, range(1, fingers + 1), drawn)
    figures["nociceptive"] = margin["nociceptive"]
    if json_file is not None:
        at_nerve = {each: figures.pop(each) for each in ("median", "worst_tenth")}
        write_json(
            json_file,
            {
                "profile": chosen.name, "mode": driven.value, "anatomy": anatomy,
                "fingers": fingers, "letters": drawn,
                "fired": letters_felt.fired(found),
                **figures, "at_board": at_board, "at_nerve": at_nerve,
            },
        )  # fmt: skip
        figures |= at_nerve
    if picture is not None:
        from smarttouch.plotting.fingers import letter_figure
        from smarttouch.plotting.style import save

        sequence, active = letters_felt.letter_sequence(drawn[0], chosen, bank, driven)
        save(letter_figure(Finger(chosen, 1, anatomy), sequence, active), picture)
    if not quiet:
        rows = [("error rate at the board", f"{at_board:.3f}")]
        rows += [(_NAMES[name], f"{value:.3f}") for name, value in figures.items()]
        print_table(rows, left=1)
