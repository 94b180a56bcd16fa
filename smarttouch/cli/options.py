"""Options that several commands take, each said once."""

from pathlib import Path
from typing import Annotated

import typer

ProfileOption = Annotated[
    str | None,
    typer.Option(
        "--profile", metavar="NAME|FILE", help="Device and finger; the board's usual if none."
    ),
]
ModeOption = Annotated[
    str, typer.Option("--mode", metavar="RA|SAI|PC|natural", help="What drives which afferents.")
]
ForceOption = Annotated[
    str | None,
    typer.Option(
        "--force",
        metavar="URL",
        help="How hard the finger presses: hx711:PORT, loadcell:PORT, recorded:CSV, fixed:N; "
        "the sensor's or the board's own word if not given.",
    ),
]
IntensityOption = Annotated[
    float | None,
    typer.Option(
        "--intensity",
        metavar="0..1",
        help="Of the strongest. On a real board a run begins at 0, and keys raise it up to this "
        "(1); without a keyboard it must be given, and is reached slowly.",
    ),
]
RateOption = Annotated[
    float | None,
    typer.Option("--rate", metavar="HZ", help="Sequences a second; the profile's if none."),
]
SecondsOption = Annotated[
    float | None, typer.Option("--seconds", metavar="S", help="Longest run, wall time.")
]
ScanOption = Annotated[
    str,
    typer.Option(
        "--scan",
        metavar="points|frame|auto",
        help="One point in each slot, as many as leave one another alone, or so where that needs "
        "no search: RA, on boards that give every electrode its own current.",
    ),
]
FramesOption = Annotated[
    Path | None,
    typer.Option(
        "--frames",
        metavar="FILE|FOLDER",
        help="What the electrodes do: .gif, .json, or PNG in a folder.",
    ),
]
FeltOption = Annotated[
    Path | None,
    typer.Option("--felt", metavar="PNG", help="Draw what is read and what the skin got."),
]
RecordOption = Annotated[
    Path | None, typer.Option("--record", metavar="MCAP", help="Keep the run.")
]
MarkersOption = Annotated[
    bool,
    typer.Option(
        "--markers", help="Tell pulses, frames and events to the Lab Streaming Layer (extra lsl)."
    ),
]
JsonOption = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write the figures of the run.")
]
QuietOption = Annotated[bool, typer.Option("--quiet", help="Show nothing but errors.")]
LanguageOption = Annotated[
    str, typer.Option("--language", metavar="NAMES", help="Of print, for Tesseract, as in eng+deu.")
]
PagesOption = Annotated[
    str | None,
    typer.Option("--pages", metavar="LIST", help="Of a document, as in 1,3-5; all if none."),
]
PasswordOption = Annotated[str | None, typer.Option("--password", help="Of an encrypted PDF.")]
AsOption = Annotated[str, typer.Option("--as", metavar="shapes|braille", help="How it is felt.")]
StyleOption = Annotated[
    str, typer.Option("--style", metavar="plain|thinned|graded", help="Of letter shapes.")
]
TableOption = Annotated[
    str, typer.Option("--table", metavar="NAME", help="Braille code; smarttouch braille --tables.")
]
CellsOption = Annotated[
    str,
    typer.Option(
        "--cells", metavar="line|cell", help="Braille: a moving line, or one cell at a time."
    ),
]
