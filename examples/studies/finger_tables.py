"""Print what the paper or the literature measured beside what simulated fingers show.

``python examples/studies/finger_tables.py effects`` (Section III-B of the paper), or ``published``;
``--help`` lists the options.
"""

import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

sys.path.append(str(Path(__file__).parents[1]))
from studies.finger_effects import effects
from studies.published import published

from smarttouch.base.files import require_folder, write_json
from smarttouch.base.terminal import print_table
from smarttouch.reading.letter_shapes import ALPHABET
from smarttouch.views.progress import lines_progress


def main(
    table: Literal["effects", "published"],
    anatomy: str = "branched",
    fingers: Annotated[int, typer.Option(min=1, help="Fingers with seeds from 1 on.")] = 10,
    letters: Annotated[str, typer.Option(help="Read by the fingers.")] = ALPHABET,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the table here.")] = None,
) -> None:
    """Print a table of what was published and of what simulated fingers show."""
    require_folder(json_file)
    seeds = range(1, fingers + 1)
    with lines_progress(False, "Fingers") as progress:
        if table == "effects":
            heading = ["effect", "paper", "fingers"]
            rows = effects(anatomy, seeds, progress)
        else:
            heading = ["measurement", "published", "source", "fingers"]
            rows = published(anatomy, seeds, letters, progress)
    if json_file is not None:
        shown = [dict(zip(heading, row, strict=True)) for row in rows]
        write_json(json_file, {"anatomy": anatomy, "fingers": fingers, table: shown})
    print_table(rows, heading, left=len(heading))


if __name__ == "__main__":
    typer.run(main)
