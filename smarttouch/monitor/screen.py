"""The terminal while a finger reads: source, electrodes, pressure, rate, limits."""

import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.columns import Columns
from rich.console import Group
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from smarttouch import terminal
from smarttouch.events import Advice, Event
from smarttouch.profile import Profile
from smarttouch.running.listener import Listener, RunContext
from smarttouch.running.report import summary_lines
from smarttouch.running.step import StepResult

_IMAGE_ROWS = 16
_REFRESH_PER_S = 10
_KEYS = (
    "+ −  intensity    0  none    space  pause    m  mode    q, Esc, Ctrl-C  end, all electrodes "
    "at zero"
)


class Screen(Listener):
    """Shows a run as it goes, from a thread of its own, and sums it up.

    On anything but a terminal only notes and the summary are printed; when quiet, nothing.

    Parameters
    ----------
    url : str
        Of the board.
    quiet : bool
        Show nothing.
    keys_help : str
        Words on keys of the source.
    """

    def __init__(self, url: str, quiet: bool, keys_help: str = "") -> None:
        super().__init__()
        self._url, self._quiet = url, quiet
        self._console = terminal.console()
        self._latest: StepResult | None = None
        self._event = ""
        self._keys = keys_help + _KEYS
        self._live: Live | None = None

    def prepare(self, run: RunContext) -> None:
        """Begin to show it."""
        self._source, self._profile, self._controls = run.source, run.profile, run.controls
        self._board, self._statistics = run.board, run.statistics
        self._layout = _ArrayLayout(run.profile)
        self._full_ma = float(run.profile.full_ma.max())
        if self._quiet or not self._console.is_terminal:
            return
        # Drawing must not hold the loop up for a whole default interval of 5 ms.
        self._interval = sys.getswitchinterval()
        sys.setswitchinterval(0.0005)
        self._live = Live(
            console=self._console,
            get_renderable=self._render,
            refresh_per_second=_REFRESH_PER_S,
            transient=True,
        )
        self._live.start()

    def step(self, result: StepResult) -> None:
        """Keep the newest; the screen's own thread draws it when it gets to it."""
        self._latest = result

    def event(self, event: Event) -> None:
        """Show the newest event; advice stays."""
        self._event = f"{event.time_ns / 1e9:.1f} s: {event}"
        if isinstance(event, Advice) and not self._quiet:
            console = terminal.console(stderr=True) if self._live is None else self._console
            console.print(str(event), soft_wrap=True, highlight=False, markup=False)

    def finish(self, run: RunContext) -> None:
        """Leave the terminal to what is printed from now on."""
        self.close()

    def close(self) -> None:
        """Leave the terminal as it was."""
        live, self._live = self._live, None
        if live is not None:
            live.stop()
            sys.setswitchinterval(self._interval)

    def _render(self) -> Group | Text:
        sent = self._latest
        if sent is None:
            return Text("waiting for the first frame")
        title = "asked for" if sent.step.input.image is None else "source sees"
        given = Panel(_given(sent, self._layout), title=title, expand=False)
        electrodes = Panel(
            self._layout.draw(sent.felt_ma / self._full_ma),
            title=f"{sent.step.mode} electrodes",
            expand=False,
        )
        return Group(
            Text(f"{self._source.title}  →  {self._profile.title}  →  {self._url}", style="bold"),
            Columns([given, electrodes, Panel(self._numbers(sent), title="now", expand=False)]),
            Text(self._keys if sys.stdin.isatty() else "", style="dim"),
            Text(self._event, style="dim"),
        )

    def _numbers(self, sent: StepResult) -> Table:
        frame, sequence, statistics = sent.step.input, sent.step.sequence, self._statistics
        limits, force = self._profile.limits, self._profile.force
        peak_ma = float(np.abs(sequence.current_ua.astype(np.int32)).max(initial=0)) / 1000
        charge_uc = peak_ma * float(sequence.width_us.max(initial=0)) / 1000
        pose, wish = frame.pose, self._controls.state(frame.time_ns)
        dropped = self._source.dropped_frames + statistics.seen - statistics.felt
        length = "" if self._source.duration_s is None else f" of {self._source.duration_s:.0f}"
        rows = (
            ("time", f"{frame.time_ns / 1e9:5.1f}{length} s"),
            ("finger", f"x {pose.x_mm:5.1f}  y {pose.y_mm:5.1f} mm"),
            ("pressure", f"{bar(frame.force_n / force.full_n)} {frame.force_n:.2f} N"),
            ("asked for", f"{bar(wish.level)} {wish.level:.2f}{' paused' * wish.paused}"),
            ("intensity", f"{bar(sequence.intensity)} {sequence.intensity:.2f}"),
            (
                "rate",
                f"{sequence.rate_hz:.0f} Hz, {sequence.slots} slots of {sequence.points} points",
            ),
            ("beside", _beside(sequence.proof.shared if sequence.proof else None)),
            ("frames", f"{statistics.felt} felt, {dropped} dropped of {self._source.frames}"),
            ("latency", f"{frame.age_ns / 1e6 + sent.latency_us / 1e3:.1f} ms, image to last byte"),
            ("own work", f"{sent.work_us:.0f} µs, {statistics.work_share:.1%} of the scans"),
            (
                "current",
                f"{bar(peak_ma / limits.current_ma)} {peak_ma:.2f}/{limits.current_ma} mA",
            ),
            (
                "charge",
                f"{bar(charge_uc / limits.charge_uc)} {charge_uc:.2f}/{limits.charge_uc} µC",
            ),
            (
                "session",
                f"{self._board.dose.seconds:.0f}/{limits.session_s:.0f} s, "
                f"{self._board.dose.most_mc:.1f}/{limits.session_mc:.0f} mC",
            ),
            ("board", f"{self._board.acknowledged} of {statistics.frames} acknowledged"),
        )
        table = Table.grid(padding=(0, 1))
        for name, value in rows:
            table.add_row(Text(name, style="dim"), Text(value))
        return table

    def summarize(self, figures: dict[str, Any], notes: list[str], files: list[Path]) -> None:
        """Print how the run went."""
        lines = summary_lines(figures, acknowledges=self._board.capabilities.acknowledges)
        wrote = (f"wrote {path}" for path in files)
        for line in (lines[0], *(f"  {each}" for each in (*lines[1:], *notes, *wrote))):
            self._console.print(line, soft_wrap=True, highlight=False)


def _beside(shared: tuple[float, float] | None) -> str:
    """Return what points that share slots do beside what they are for."""
    if not shared:
        return "no points share a slot"
    return f"other classes {shared[0]:.2f}, elsewhere {shared[1]:.2f} of the points"


def bar(part: float, width: int = 10) -> str:
    filled = round(max(0.0, min(1.0, part)) * width)
    return "█" * filled + "░" * (width - filled)


def _given(sent: StepResult, layout: "_ArrayLayout") -> Text:
    """Draw the image that was read; where there is none, what each electrode is to do."""
    image = sent.step.input.image
    if image is not None:
        return _grey(image)
    return layout.draw(sent.step.tactile.activation.max(axis=0))


def _grey(image: NDArray[np.uint8]) -> Text:
    """Draw an image in half blocks, two rows of pixels to a line."""
    height, width = image.shape
    columns = max(2, min(64, round(2 * _IMAGE_ROWS * width / height)))
    small = cv2.resize(image, (columns, 2 * _IMAGE_ROWS), interpolation=cv2.INTER_AREA)
    text = Text()
    for upper, lower in zip(small[::2], small[1::2], strict=True):
        for above, below in zip(upper.tolist(), lower.tolist(), strict=True):
            style = f"rgb({above},{above},{above}) on rgb({below},{below},{below})"
            text.append("▀", style=style)
        text.append("\n")
    text.right_crop(1)
    return text


class _ArrayLayout:
    """Place of each electrode on a canvas of characters, whatever its array."""

    def __init__(self, profile: Profile) -> None:
        position = profile.electrodes.position_mm
        step_x, step_y = _finest(position[:, 0]), _finest(position[:, 1])
        self._column = np.rint((position[:, 0] - position[:, 0].min()) / step_x).astype(int)
        self._row = np.rint((position[:, 1] - position[:, 1].min()) / step_y).astype(int)
        self._width = 3 if step_x >= step_y else 2

    def draw(self, parts: NDArray[np.float32]) -> Text:
        """Draw electrodes by the part that each has of the strongest, (E,)."""
        cells = [
            [(" " * self._width, "")] * (int(self._column.max()) + 1)
            for _ in range(int(self._row.max()) + 1)
        ]
        for row, column, part in zip(
            self._row.tolist(), self._column.tolist(), parts.clip(0, 1).tolist(), strict=True
        ):
            mark = "·" if part == 0 else "○◔◑◕●"[min(4, int(part * 5))]
            glow = round(90 + 165 * part)
            style = "grey42" if part == 0 else f"rgb({glow},{round(glow * 0.75)},40)"
            cells[row][column] = (mark.ljust(self._width), style)
        text = Text()
        for line in cells:
            for mark, style in line:
                text.append(mark, style=style)
            text.append("\n")
        text.right_crop(1)
        return text


def _finest(values: NDArray[np.float64]) -> float:
    steps = np.diff(np.unique(values.round(6)))
    return float(steps.min()) if steps.size else 1.0
