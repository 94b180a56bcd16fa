"""``smarttouch report``: a file for a bug report."""

from pathlib import Path
from typing import Annotated

import typer


def report(
    recording: Annotated[
        Path | None, typer.Argument(metavar="[MCAP]", help="The run that went wrong.")
    ] = None,
    output: Annotated[Path, typer.Option(metavar="FILE", help="What to write.")] = Path(
        "smarttouch-report.json"
    ),
) -> None:
    """Write a file for a bug report: versions, boards, settings and last events.

    Nothing of participants is in it: no name, note, file name, threshold, current or answer.
    """
    from smarttouch.bug_report import bug_report
    from smarttouch.files import require_folder, write_json

    require_folder(output)
    write_json(output, bug_report(recording))
    print(f"{output}: look through it, and add what you did and what you saw")
