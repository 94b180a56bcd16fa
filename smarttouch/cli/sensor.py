"""``smarttouch sensor``: one sensor or load cell, looked at or played."""

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smarttouch import terminal
from smarttouch.emulator.commands import emulate_sensor

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np
    from numpy.typing import NDArray

    from smarttouch.profile import Profile
    from smarttouch.sources.frame import Frame

sensor = typer.Typer(help="Look at one sensor or load cell, or play one.", no_args_is_help=True)
sensor.command("emulate")(emulate_sensor)

_ASKED_HZ = 100.0

_ProfileName = Annotated[
    str | None,
    typer.Option("--profile", metavar="NAME|FILE", help="Device and finger; electric-mouse."),
]


@sensor.command()
def show(
    url: Annotated[
        str,
        typer.Argument(
            metavar="URL",
            help="camera:N, video:FILE, serial-array:PORT, ...; with --force hx711:PORT, ...",
        ),
    ],
    seconds: Annotated[float, typer.Option(metavar="S", help="How long to look.")] = 2.0,
    force: Annotated[
        bool, typer.Option("--force", help="It is a source of finger force, not of frames.")
    ] = False,
    save: Annotated[Path | None, typer.Option(metavar="PNG", help="Keep the last frame.")] = None,
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Of a camera's frames, 640x480.")
    ] = None,
    exposure: Annotated[
        float | None, typer.Option(help="Of a camera, in its driver's own unit.")
    ] = None,
    baud: Annotated[int | None, typer.Option(help="Of a serial array.")] = None,
    profile: _ProfileName = None,
) -> None:
    """Say what comes from a sensor: frames, rate, size, force, and what went wrong."""
    from smarttouch.cli.files import parse_size, require_folder
    from smarttouch.errors import SmartTouchError
    from smarttouch.profile import DEFAULT_PROFILE, load_profile

    if not 0 < seconds <= 3600:
        message = f"--seconds {seconds:g} must be above 0 and at most 3600"
        raise SmartTouchError(message, about="--seconds", value=seconds, allowed=(0, 3600))
    require_folder(save)
    chosen = load_profile(profile or DEFAULT_PROFILE)
    if not force:
        options = {"size": parse_size(size), "exposure": exposure, "baud": baud}
        _show_frames(url, chosen, seconds, save, options)
        return
    if (save, size, exposure, baud) != (None, None, None, None):
        raise SmartTouchError(
            "--save, --size, --exposure and --baud are for frames: leave out --force, or them "
            "(the speed of a load cell's line: hx711:PORT?baud=115200)",
            about="--force",
            problem="conflict",
        )
    _show_force(url, chosen, seconds)


def _show_frames(
    url: str,
    profile: "Profile",
    seconds: float,
    save: Path | None,
    options: dict[str, Any],
) -> None:
    import numpy as np

    from smarttouch.sources import open_sensor

    forces: list[float] = []
    ages_ms: list[float] = []
    last: Frame | None = None
    source = open_sensor(url, profile, **options)
    with source:
        for time_ns in _ticks(seconds):
            frame = source.read(time_ns)
            if frame is None:
                break
            last = frame
            forces.append(frame.force_n)
            ages_ms.append(frame.age_ns / 1e6)
    lasted_s = max(last.time_ns / 1e9, 1 / _ASKED_HZ) if last is not None else seconds
    rows = [
        ("sensor", source.title),
        ("frames", f"{source.frames}, {source.frames / lasted_s:.1f} a second"),
        ("read", f"{source.frames - source.dropped_frames}, asked {_ASKED_HZ:g} times a second"),
        ("passed over", str(source.dropped_frames)),
    ]
    if last is not None:
        height, width = last.image.shape
        grey = f"grey {last.image.min()} to {last.image.max()}, mean {last.image.mean():.0f}"
        rows.append(("size", f"{width} x {height}, {grey}"))
        rows.append(("age", f"{np.median(ages_ms):.1f} ms, at most {max(ages_ms):.1f}"))
        moved = f"x {last.pose.x_mm:.2f} mm, y {last.pose.y_mm:.2f} mm"
        rows.append(("at", moved + (", stale" if last.stale else "")))
    rows.append(("force", _range(np.array(forces))))
    _print_table(rows, source.notes)
    if save is not None and last is not None:
        _save(save, last)


def _show_force(url: str, profile: "Profile", seconds: float) -> None:
    import numpy as np

    from smarttouch.sources.forces.force import open_force

    with open_force(url, profile) as source:
        forces = np.array([source.read(time_ns) for time_ns in _ticks(seconds)])
    unknown = int(np.isnan(forces).sum())
    rows = [
        ("force of", source.title),
        ("force", _range(forces)),
        ("unknown", f"{unknown} of {len(forces)} times asked"),
    ]
    _print_table(rows, source.notes)


def _ticks(seconds: float) -> "Iterator[int]":
    """Yield nanoseconds since the first answer, at absolute deadlines."""
    import time

    yield 0
    start_ns = time.perf_counter_ns()
    for count in range(1, round(seconds * _ASKED_HZ) + 1):
        due_ns = round(count * 1e9 / _ASKED_HZ)
        time.sleep(max(0, start_ns + due_ns - time.perf_counter_ns()) / 1e9)
        yield due_ns


def _range(forces_n: "NDArray[np.float64]") -> str:
    import numpy as np

    known = forces_n[np.isfinite(forces_n)]
    if not known.size:
        return "not known"
    return f"{known.min():.3f} to {known.max():.3f} N, mean {known.mean():.3f}"


def _print_table(rows: list[tuple[str, str]], notes: list[str]) -> None:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, show_header=False)
    for each in (*rows, *(("note", note) for note in notes)):
        table.add_row(*each)
    terminal.console().print(table)


def _save(path: Path, frame: "Frame") -> None:
    from PIL import Image

    from smarttouch.files import write_bytes

    content = BytesIO()
    Image.fromarray(frame.image).save(content, format="PNG")
    write_bytes(path, content.getvalue())
    typer.echo(f"The last frame is in {path}.")
