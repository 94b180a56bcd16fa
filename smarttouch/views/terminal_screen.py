"""Terminal screens of a run, for users and for participants of experiments."""

import sys
import textwrap
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cached_property, partial
from itertools import zip_longest
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, TextIO, cast

import numpy as np
from rich.cells import cell_len, set_cell_size
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.live import Live
from rich.panel import Panel
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from smarttouch.base.errors import SmartTouchError
from smarttouch.base.events import Advice, Event
from smarttouch.running.step_records import FirstPulse, Listener, RunContext, StepResult
from smarttouch.views import printable_output
from smarttouch.views.character_pictures import MOST_ROWS, ArrayPicture, Row, image_rows
from smarttouch.views.keys_and_signals import Output, Terminal

_REFRESH_S = 0.2
_LEAST_REST = 20  # after a redraw, pause at least this many times as long as the redraw took
_KEYS = "+ − intensity    0 off    space pause    m mode    q, Esc end"
_ROOMY = 20  # in a terminal of at least this many rows, an event may take two rows
_LEAST_PICTURE = 9  # numbers are shown only if pictures and titles keep this many rows
_NAME = 9
_CLOSES_WITHIN_S = 1.0  # longest wait for the terminal at the end

Rows = tuple[tuple[str, str], ...]


class Screen(Listener):
    """Terminal view of a run, with keys and a summary. A separate thread draws, so that pulses and
    keys do not wait for the terminal. With ``plain``, or without a terminal, the view prints a line
    for each event and each new title of the source. ``keys_of`` returns the receiver of keys."""

    def __init__(
        self,
        url: str,
        keys_help: str = "",
        plain: bool = False,
        keys_of: Callable[[RunContext], Callable[[str], None]] | None = None,
    ) -> None:
        super().__init__()
        self._url = url
        self._console = printable_output.console()
        self._errors = printable_output.console(stderr=True)
        self._plain = plain or not printable_output.draws()
        self._title = ""
        self._early: list[str] | None = []  # lines to print once the board is open
        self._latest: StepResult | None = None
        self._pulse: FirstPulse | None = None
        self._event = ""
        self._keys, self._keys_of = keys_help + _KEYS, keys_of
        self._live: Live | None = None
        self._acts: SimpleQueue[Callable[[], object]] = SimpleQueue()
        self._outputs = [Output(self._console.file), Output(self._errors.file)]
        self._console.file, self._errors.file = (cast(TextIO, each) for each in self._outputs)
        self._terminal: Terminal | None = None
        self._failure: BaseException | None = None  # drawing error; the run's thread raises it
        self._drawn: object = None
        self._rests_until_s = 0.0

    def prepare(self, run: RunContext) -> None:
        self._source, self._profile, self._controls = run.source, run.profile, run.controls
        self._board, self._statistics = run.board, run.statistics
        self._full_ma = float(run.profile.full_ma.max())
        if not self._plain:
            # With Python's default switch interval, drawing could delay the run loop by 5 ms.
            self._interval = sys.getswitchinterval()
            sys.setswitchinterval(0.0005)
            self._live = Live(
                console=self._console, get_renderable=self._render, auto_refresh=False,
                transient=True,
            )  # fmt: skip
            self._acts.put(partial(self._live.start, refresh=True))
        on_key = None if self._keys_of is None else self._keys_of(run)
        self._terminal = Terminal(on_key, self._outputs, self._draw)
        self._terminal.open()

    @cached_property
    def _array(self) -> ArrayPicture:
        return ArrayPicture(self._profile)

    def start(self, run: RunContext) -> None:
        """In plain mode, print the title, the keys, and all earlier events."""
        if self._plain:
            self._title = run.source.title
            self._print(f"{self._title}, {run.profile.title}, {self._url}")
            if sys.stdin.isatty():
                keys = (" ".join(key.split()) for key in self._keys.split("    "))
                self._print(f"keys: {', '.join(keys)}")
            early, self._early = self._early or [], None
            for line in early:
                self._print(line)

    def step(self, result: StepResult) -> None:
        """Store the newest step for the screen's thread."""
        self._latest, self._pulse = result, result.first_pulse or self._pulse
        title = self._source.title
        if self._plain and title != self._title:
            self._title = title
            self._print(f"{result.step.input.time_ns / 1e9:.1f} s: {title}")

    def event(self, event: Event) -> None:
        """Show the newest event. Advice is printed, so that it stays in the terminal."""
        self._event = f"{event.time_ns / 1e9:.1f} s: {event}"
        if isinstance(event, Advice):
            console = self._errors if self._live is None else self._console
            self._later(
                partial(console.print, str(event), soft_wrap=True, highlight=False, markup=False)
            )
        elif self._plain and self._early is not None:
            self._early.append(self._event)
        elif self._plain:
            self._print(self._event)

    def finish(self, run: RunContext) -> None:
        self.close()
        self._raise_failure()

    def close(self) -> None:
        """End drawing and restore the terminal, even if the terminal no longer accepts output."""
        live, self._live = self._live, None
        if live is not None:
            self._acts.put(live.stop)
            sys.setswitchinterval(self._interval)
        shown, self._terminal = self._terminal, None
        if shown is not None:
            shown.close(_CLOSES_WITHIN_S)
        else:
            self._draw()

    def _later(self, act: Callable[[], object]) -> None:
        """Queue an action for the screen's thread."""
        self._raise_failure()
        self._acts.put(act)

    def _raise_failure(self) -> None:
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def _draw(self) -> None:
        """Run queued actions, and redraw after changes. Redraw only when the terminal has accepted
        all earlier output. After a slow redraw, pause longer."""
        began_s, live = time.monotonic(), self._live
        try:
            with suppress(Empty):
                while True:
                    self._acts.get_nowait()()
            ready = not self._outputs[0].waiting and began_s >= self._rests_until_s
            if live is not None and ready:
                now = self._latest, self._event, self._console.size, self._controls.state(0)
                if now != self._drawn:
                    live.refresh()
                self._drawn, now_s = now, time.monotonic()
                self._rests_until_s = now_s + max(_REFRESH_S, _LEAST_REST * (now_s - began_s))
            if (failure := self._outputs[0].failure) is not None:
                self._outputs[0].failure = None
                # Raise the same error as a direct write to standard output.
                raise printable_output.write_failure(failure, "standard output")
        except (OSError, SmartTouchError) as failure:
            self._failure = self._failure or failure

    def _print(self, line: str) -> None:
        self._later(partial(self._print_now, line))

    def _print_now(self, line: str) -> None:
        """Print a line. On a terminal, a long line is wrapped between words."""
        line, is_plain = line.replace("\n", " "), not self._console.is_terminal
        self._console.print(line, soft_wrap=is_plain, highlight=False, markup=False)

    def _render(self) -> RenderableType:
        """Draw the whole screen, in a constant number of rows that fits the terminal."""
        sent = self._latest
        if sent is None:
            return Text("waiting for the first frame")
        width, height = self._console.size
        event_rows = 2 if height >= _ROOMY else 1
        event = textwrap.wrap(self._event, width, max_lines=event_rows, placeholder=" …")
        texts = (*self._keys_lines(width), *event, *[""] * (event_rows - len(event)))
        # Leave the last row free, so that printing does not scroll.
        left = height - 4 - len(texts)
        numbers = self._numbers(sent)
        rows = max(0, min(-(-len(numbers) // 2), left - _LEAST_PICTURE))
        return _Rows(
            width,
            [
                [(f"{self._source.title}  →  {self._profile.title}  →  {self._url}", "bold")],
                *_columns(self._gauges(sent, width // 2 - 1), width),
                *([(text, "dim")] for text in texts),
                *self._pictures(sent, width, max(2, min(left - rows, 1 + MOST_ROWS))),
                *_columns(numbers[: 2 * rows], width),
            ],
        )

    def _keys_lines(self, width: int) -> list[str]:
        if not sys.stdin.isatty():
            return []
        # Do not break between a key and its description.
        groups = (group.replace(" ", "\xa0") for group in self._keys.split("    "))
        lines = textwrap.wrap("   ".join(groups), width)
        return [line.replace("\xa0", " ") for line in lines]

    def _pictures(self, sent: StepResult, width: int, rows: int) -> list[Row]:
        image, half = sent.step.input.image, max(2, (width - 3) // 2)
        electrodes, rows = sent.delivered_ma / self._full_ma, rows - 1
        if image is None:
            title = "requested"
            asked = sent.step.tactile.activation.max(axis=0)
            pictured = self._array.draw(asked, half, rows)
        else:
            title = "source image"
            pictured = image_rows(image, half, rows, color=not self._console.no_color)
        wide = max(len(title), *(sum(len(words) for words, _ in row) for row in pictured))
        beside = max(2, width - 3 - wide)
        merged = self._array.merged(beside, rows)
        what = f"{sent.step.mode} electrodes" + f", up to {merged**2} per dot" * (merged > 1)
        drawn = self._array.draw(electrodes, beside, rows)
        # Add empty rows, so that the height is constant.
        for picture in (pictured, drawn):
            picture += [[] for _ in range(rows - len(picture))]
        pairs = [([(title, "dim")], [(what, "dim")]), *zip(pictured, drawn, strict=True)]
        return [[*_padded(left, wide + 3), *right] for left, right in pairs]

    def _gauges(self, sent: StepResult, width: int) -> Rows:
        """Return intensity, current, pressure and charge, each with a bar, in ``width`` columns."""
        frame, sequence, limits = sent.step.input, sent.step.sequence, self._profile.limits
        peak_ma = float(np.abs(sequence.current_ua.astype(np.int32)).max(initial=0)) / 1000
        charge_uc = peak_ma * float(sequence.width_us.max(initial=0)) / 1000
        full_n, wish = self._profile.force.full_n, self._controls.state(frame.time_ns)
        asked = "paused" if wish.paused else f"of {wish.level:.2f}"
        gauges = (
            ("intensity", sequence.intensity, f"{sequence.intensity:.2f} {asked}"),
            ("current", peak_ma / limits.current_ma, f"{peak_ma:.2f}/{limits.current_ma:g} mA"),
            ("pressure", frame.force_n / full_n, f"{frame.force_n:.2f} N"),
            ("charge", charge_uc / limits.charge_uc, f"{charge_uc:.2f}/{limits.charge_uc:g} µC"),
        )
        room = max(3, width - _NAME - 15)
        return tuple((name, f"{bar(part, room)} {value}") for name, part, value in gauges)

    def _numbers(self, sent: StepResult) -> Rows:
        frame, sequence, statistics = sent.step.input, sent.step.sequence, self._statistics
        limits, dose, pose = self._profile.limits, self._board.dose, frame.pose
        dropped = self._source.dropped_frames + statistics.seen - statistics.delivered
        length = "" if self._source.duration_s is None else f" of {self._source.duration_s:.0f}"
        slots = f"{sequence.slots} slots"
        charge = f"{dose.most_mc:.1f}/{limits.session_mc:.0f} mC"
        return (
            ("time", f"{frame.time_ns / 1e9:.1f}{length} s"),
            ("rate", f"{sequence.rate_hz:.0f} Hz, {sequence.points} points, {slots}"),
            ("latency", _latency(sent, self._pulse)),
            ("session", f"{dose.seconds:.0f}/{limits.session_s:.0f} s, {charge}"),
            ("net", f"charge {dose.most_net_uc:.0f} µC"),
            ("finger", f"x {pose.x_mm:.1f}  y {pose.y_mm:.1f} mm"),
            ("unwanted", _beside(statistics.off_target, statistics.spill)),
            ("frames", f"{statistics.delivered} sent, {dropped} dropped of {self._source.frames}"),
            ("board", f"{self._board.acknowledged} of {statistics.frames} acknowledged"),
            ("computing", f"{sent.work_us:.0f} µs, {statistics.work_share:.1%} of the time"),
        )

    def summarize(self, figures: dict[str, Any], notes: list[str], files: Sequence[Path]) -> None:
        """Print a summary of the run."""
        lines = summary_lines(figures, acknowledges=self._board.capabilities.acknowledges)
        wrote = [f"wrote {path}" for path in files]
        account = self._source.account if self._plain else ""
        if account:
            # The source's own summary (``account``) does not count restarts at zero intensity.
            if again := figures["restarts"] + figures["dropped_late"]:
                notes = [*notes, f"intensity restarted at zero {again} times"]
            more = "; ".join([*notes, *wrote]) or "No warning; nothing was recorded."
            for line in (lines[0], account, more):
                self._print_now(line)
            return
        for line in (lines[0], *(f"  {text}" for text in (*lines[1:], *notes, *wrote))):
            self._print_now(line)


def _latency(sent: StepResult, pulse: FirstPulse | None) -> str:
    """Describe the time from the image to its first pulse or, if unknown, to its last byte sent."""
    if pulse is not None:
        return f"image to first pulse {pulse.latency_us / 1e3:.1f} ms"
    known_ms = sent.step.input.age_ns / 1e6 + sent.latency_us / 1e3
    return f"image to last byte {known_ms:.1f} ms"


def _beside(other: float, spill: float) -> str:
    """Describe the largest activation of other classes and places in slots with several points."""
    if not other and not spill:
        return "no points share a slot"
    return f"other classes {other:.0%}, places {spill:.0%}"


def bar(part: float, width: int = 10) -> str:
    filled = round(max(0.0, min(1.0, part)) * width)
    return "█" * filled + "░" * (width - filled)


class _Rows:
    """Lines of styled text for the library rich. Each line takes one row of the terminal. Lines are
    drawn faster than rich's tables, which measure and wrap cells."""

    def __init__(self, width: int, rows: list[Row]) -> None:
        self._width, self._rows = width, rows

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for row in self._rows:
            left = self._width
            for words, style in row:
                shown = _fitting(words, left)
                left -= cell_len(shown)
                yield Segment(shown, console.get_style(style) if style else None)
            yield Segment.line()


def _fitting(words: str, width: int) -> str:
    """Return a text of at most ``width`` columns. A wider text is cut and gets an ellipsis."""
    if cell_len(words) <= width:
        return words
    return set_cell_size(words, width - 1) + "…" if width > 0 else ""


def _padded(row: Row, width: int) -> Row:
    """Return a row padded with spaces."""
    return [*row, (" " * (width - sum(cell_len(words) for words, _ in row)), "")]


def _columns(rows: Rows, width: int) -> list[Row]:
    """Return terminal rows, each with two pairs of name and value."""
    wide = max(1, width // 2 - _NAME - 2)
    columns: list[Row] = []
    for pairs in zip_longest(rows[::2], rows[1::2], fillvalue=("", "")):
        row: Row = []
        for name, value in pairs:
            row += _padded([(_fitting(name, _NAME), "dim")], _NAME + 1)
            row += _padded([(_fitting(value, wide), "")], wide + 1)
        columns.append(row)
    return columns


_BLIND_KEYS = "+ − amplitude    0 off    space pause    q, Esc end; the session can continue later"


class BlindScreen(Screen):
    """Screen for participants. It hides electrodes, rates and currents, which reveal answers."""

    def event(self, event: Event) -> None:
        if not event.reveals:
            super().event(event)

    def _render(self) -> RenderableType:
        sent = self._latest
        if sent is None:
            return Text("waiting for the first frame")
        frame = sent.step.input
        table = Table.grid(padding=(0, 1))
        for name, part in (
            ("amplitude", self._controls.state(frame.time_ns).level),
            ("pressure", frame.force_n / self._profile.force.full_n),
        ):
            table.add_row(Text(name, style="dim"), Text(bar(part, 20)))
        where, _, now = self._source.title.partition(": ")
        return Group(
            Text(where, style="dim"),
            Panel(Text(now or " ", style="bold", justify="center"), width=72, padding=(1, 2)),
            table,
            Text(_BLIND_KEYS, style="dim"),
            Text(self._event, style="dim"),
        )


def summary_lines(figures: dict[str, Any], *, acknowledges: bool) -> list[str]:
    """Return the summary of a run as lines of text, from `RunStatistics.figures`."""
    pulse, by_host = figures["motion_to_pulse_us"], figures["reported_by"] == "host"
    latency = pulse or figures["motion_to_bytes_us"]
    rate = f"{figures['rate_hz']:.1f} Hz of {figures['rate_asked_hz'] or 0:.1f} Hz requested"
    if figures["slowed_sequences"]:
        rate += (
            f" ({figures['slowed_sequences']} sequences did not fit into a period "
            f"and were slowed; the lowest rate was {figures['lowest_rate_hz']:.1f} Hz)"
        )
    # Latencies are zero in simulated time.
    if latency["max"] > 0:
        rate += (
            f"; image to {'first pulse' if pulse else 'last byte'} {latency['p50'] / 1000:.1f} ms "
            f"median, {latency['p99'] / 1000:.1f} ms p99"
        )
    net_uc = figures["max_net_charge_uc"] or 0
    net = f"largest charge that remained after a discharge: {1e6 * net_uc:.3g} pC"
    counted = f"{figures['emulator_violations']} violations of limits, counted by the board"
    if by_host:
        least, at_most = figures["pulses"], figures["pulses_at_most"]
        pulses = str(least) if least == at_most else f"{least} to {at_most}"
        net = f"net charge of all pulses at most {net_uc:.2g} µC on one electrode"
        counted = f"{pulses} pulses, counted by this program, because the board reports no pulses"
    lines = [
        f"Ended after {figures['seconds']:.1f} s ({figures['ended']}): all electrodes off.",
        f"{figures['frames_in']} frames in, {figures['frames_delivered']} delivered, "
        f"{figures['dropped_frames']} dropped; {figures['slots']} slots in "
        f"{figures['acknowledged']} sequences {'acknowledged' if acknowledges else 'sent'}",
        f"{rate}; computing takes {figures['work_share']:.1%} of the time",
        f"strongest pulse {figures['max_current_ma']:.2f} mA, "
        f"{figures['max_charge_uc']:.3f} µC; {net}",
        f"session: {figures['dose_s']:.1f} s of current; largest charge through an electrode "
        f"{figures['dose_mc']:.2f} mC, largest net charge {figures['dose_net_uc']:.3g} µC",
        counted,
    ]
    if figures["worst_other"] is not None:
        lines.append(
            f"worst crosstalk: {figures['worst_other']:.0%} to other classes, "
            f"{figures['worst_spill']:.0%} to other places"
        )
    if figures["lifts"]:
        lines.append(f"the finger was lifted {figures['lifts']} times")
    if blind := figures["without_force_or_image"]:
        lines.append(f"{blind} sequences without current, because force or image was unknown")
    return lines
