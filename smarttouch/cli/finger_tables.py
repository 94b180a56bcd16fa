"""Tables of ``smarttouch finger``: the paper's effects, and published measurements."""

from collections.abc import Callable, Sequence
from pathlib import Path

NAMES = ("effects", "published")


def print_comparison(
    name: str,
    letters: str | None,
    anatomy: str,
    fingers: int,
    json_file: Path | None,
    quiet: bool,
) -> None:
    """Print one of `NAMES` beside the figures of fingers with seeds from 1 on; write it to JSON."""
    from smarttouch.files import require_folder, write_json
    from smarttouch.monitor.progress import lines_progress
    from smarttouch.terminal import print_table

    require_folder(json_file)
    seeds = range(1, fingers + 1)
    rows: Sequence[Sequence[str]]
    with lines_progress(quiet, "Feeling") as progress:
        if name == "effects":
            from smarttouch.psychophysics.paper_effects import effects

            heading = ["effect", "paper", "fingers"]
            rows = effects(anatomy, seeds, progress)
        else:
            heading = ["measurement", "published", "source", "fingers"]
            rows = _published(letters, anatomy, seeds, progress)
    if json_file is not None:
        table = [dict(zip(heading, row, strict=True)) for row in rows]
        write_json(json_file, {"anatomy": anatomy, "fingers": fingers, name: table})
    if not quiet:
        print_table(rows, heading, left=len(heading))


def _published(
    letters: str | None, anatomy: str, seeds: Sequence[int], progress: Callable[[int, int], None]
) -> list[tuple[str, ...]]:
    from smarttouch.physiology.finger import Finger
    from smarttouch.profile import load_profile
    from smarttouch.psychophysics.letters import ALPHABET
    from smarttouch.psychophysics.letters_felt import require_letters
    from smarttouch.psychophysics.published import published
    from smarttouch.vibrotactile.touchsim import touchsim_rows

    drawn = ALPHABET if letters is None else require_letters(letters)
    fingers = [Finger(load_profile("electric-mouse"), seed, anatomy) for seed in seeds]
    return [*published(anatomy, seeds, drawn, progress), *touchsim_rows(fingers)]
