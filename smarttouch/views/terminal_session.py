"""One run in a terminal: screen, keys, signals and results; and the summary of recordings."""

import contextlib
import json
import math
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smarttouch.base.afferent import Mode
from smarttouch.base.events import Advice
from smarttouch.base.files import write_json
from smarttouch.base.stopping import StopRequest
from smarttouch.kernels.bank import KernelBank, load_bank
from smarttouch.profile import Profile
from smarttouch.profile.settled_levels import SettledLevels
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.loop import STEP, Controls, ControlState
from smarttouch.running.runner import MakeControls, Runner
from smarttouch.running.step_records import Listener, RunContext, StepResult
from smarttouch.sources.force import ForceSource
from smarttouch.sources.source_contract import Source
from smarttouch.views.keys_and_signals import (
    LOST,
    by_signal,
    command_stop,
    ending_in_order,
)
from smarttouch.views.progress import bank_progress
from smarttouch.views.terminal_screen import BlindScreen, Screen

if TYPE_CHECKING:
    from smarttouch.running.recording_reader import RecordedRun
    from smarttouch.views.window import Window

OPENED_WITHIN_S = 60.0  # longest wait for a browser if a person must copy the address
_TIMED_S = 10.0  # longest wait for a browser if the run has a time limit
DRAWN_WITHIN_S = 30.0  # time to finish pictures after the first signal

_SUMMARIZED = ("subject", "note", "sensor", "force", "board")  # settings in a recording's summary

Keys = Mapping[str, Callable[[], None]]


def run_in_terminal(
    source: Source,
    display: Display,
    config: RunConfig,
    listeners: Sequence[Listener] = (),
    *,
    force: ForceSource | str | None = None,
    screen: type[Screen] = Screen,
    keys: Keys | None = None,
    keys_help: str = "",
    controls: MakeControls = Controls,
    json_file: Path | None = None,
    files: Sequence[Path] = (),
    window: bool = False,
    plain: bool = False,
    draws: bool = False,
) -> None:
    """Run a source on a display until the source or the user ends the run. Then print a summary.
    Arguments are as for `Runner`. ``keys`` maps additional keys to functions, and ``keys_help``
    describes these keys. ``json_file`` receives the figures of the run. The summary lists
    ``files``. With ``draws``, the run has time to finish pictures after a signal."""
    stop, typed = command_stop(), sys.stdin.isatty()
    asks = display.on_a_finger and (typed or window) and (screen, controls) == (Screen, Controls)
    operation = _Operation(draws, asks)
    keys, keys_help = {**operation.keys, **(keys or {})}, keys_help + "L last level    " * asks
    shown = screen(display.url, keys_help, plain, partial(_keys_of, stop, keys))
    with contextlib.ExitStack() as closing:
        page = None
        if window:
            page = _window(
                stop, config.seconds, blind=issubclass(screen, BlindScreen), keys=keys,
                keys_help=keys_help, alone=not typed,
            )  # fmt: skip
            closing.callback(page.shut)
        config, controls = _operated(display, config, controls, typed or window)
        runner = Runner(
            source,
            display,
            config,
            force=force,
            listeners=[
                *([] if page is None else [page]),  # prints its address before the screen starts
                shown,
                *listeners,
                operation,
            ],
            stop=stop,
            load_kernels=_load_kernels,
            controls=controls,
        )
        try:
            runner.run()
        finally:
            if json_file is not None and runner.statistics.figures:
                write_json(json_file, runner.statistics.figures)
        shown.summarize(runner.statistics.figures, runner.statistics.notes, files)
        if page is not None and not by_signal():
            if page.pages:
                print("The window shows the result until it is closed or you press Ctrl-C.")
            page.stay()


def _operated(
    display: Display, config: RunConfig, controls: MakeControls, steered: bool
) -> tuple[RunConfig, MakeControls]:
    """Return the settings and controls of a run. If the board may be on a finger, the intensity of
    ``config`` is the maximum, and a run that a person steers (``steered``) starts at zero."""
    if not display.on_a_finger:
        return config, controls

    def limited(state: ControlState, modes: tuple[Mode, ...]) -> Controls:
        ours = controls(state, modes)
        ours.most = ours.most if config.intensity is None else config.intensity
        return ours

    return (config.model_copy(update={"intensity": 0.0}) if steered else config), limited


def _window(stop: StopRequest, seconds: float | None, **given: Any) -> "Window":
    from smarttouch.views.window import Window
    from smarttouch.views.window_server import has_browser

    waits_s = math.inf if has_browser() else OPENED_WITHIN_S
    return Window(
        stop,
        waits_s=waits_s if seconds is None else min(_TIMED_S, seconds),
        stays=True,
        **given,
    )


def _load_kernels(profile: Profile) -> KernelBank:
    with bank_progress() as progress:
        return load_bank(profile, progress)


class _Operation(Listener):
    """Listener that lets a run end normally after a signal. If ``asks``, it also offers the user
    the last comfortable level of each mode, and logs the levels that the user keeps."""

    def __init__(self, draws: bool, asks: bool) -> None:
        super().__init__()
        self._draws, self._stack = draws, contextlib.ExitStack()
        self._levels: SettledLevels | None = None
        self.keys: dict[str, Callable[[], None]] = dict.fromkeys("Ll", self._rise) if asks else {}

    def prepare(self, run: RunContext) -> None:
        self._run = run
        self._stack.enter_context(ending_in_order(DRAWN_WITHIN_S if self._draws else None))
        if self.keys:
            self._levels = SettledLevels(run.profile, run.controls.most)
            self._stack.callback(self._levels.save)

    def step(self, result: StepResult) -> None:
        if self._levels is None:
            return
        step, (at_ns, force_n) = result.step, (result.input.time_ns, result.input.force_n)
        if words := self._levels.note(at_ns, str(step.mode), step.level, force_n, step.observed):
            self._run.source.emit(Advice(at_ns, words))

    def _rise(self) -> None:
        """Set intensity to the last comfortable level of the mode. The ramp limits the rise."""
        # The key may be pressed before the run is prepared.
        if self._levels is not None:
            controls, state = self._run.controls, self._run.controls.state(0)
            controls.set_level(self._levels.offered.get(str(state.mode), state.level))

    def close(self) -> None:
        self._stack.close()


def _keys_of(stop: StopRequest, keys: Keys, run: RunContext) -> Callable[[str], None]:
    """Return the function that handles the keys of a run."""
    controls = run.controls
    does: dict[str, Callable[[], None]] = {
        "+": lambda: controls.change_level(STEP),
        "-": lambda: controls.change_level(-STEP),
        "0": controls.silence,
        " ": controls.toggle_pause,
        "m": controls.next_mode,
        "q": lambda: stop.ask("key q"),
        "\x1b": lambda: stop.ask("key Esc"),
        LOST: lambda: stop.ask("the terminal is gone"),
    }
    does |= {"=": does["+"], "up": does["+"], "down": does["-"], "_": does["-"]}

    def on_key(key: str) -> None:
        for key_lines in (does, keys):
            key_lines.get(key, lambda: None)()

    return on_key


def describe_recording(path: Path) -> list[tuple[str, str]]:
    """Return the summary of a recording as pairs of name and value."""
    from smarttouch.running.recording_reader import RecordedRun

    recording = RecordedRun(path)
    settings, steps = recording.settings, [step for _, step in recording.contents("/step")]
    modes = Counter(step["mode"] for step in steps)
    slots = sum(step["slots"] for step in steps)
    strongest_ma = max((step["strongest_ma"] for step in steps), default=0.0)
    versions = json.loads(recording.about["versions"])
    began = datetime.fromtimestamp(recording.started_unix_ns / 1e9, UTC)
    rows = [
        ("began", f"{began:%Y-%m-%d %H:%M:%S} UTC"),
        ("lasted", f"{recording.seconds:.1f} s"),
        ("profile", f"{recording.profile.name}, {recording.profile.title}"),
        *((name, str(settings.get(name) or "none")) for name in _SUMMARIZED),
        ("sequences", ", ".join(f"{mode} {count:,}" for mode, count in modes.items()) or "none"),
        ("strongest", f"{strongest_ma:.2f} mA through one electrode; slots: {slots:,}"),
        ("versions", ", ".join(f"{name} {value}" for name, value in versions.items())),
        ("file", f"{path.stat().st_size / 1e6:.2f} MB"),
        *((f"{at_ns / 1e9:10.3f} s", words) for at_ns, words in recording.events),
    ]
    # Damage is known only after everything has been read.
    return [("state", _state(recording)), *rows]


def _state(recording: "RecordedRun") -> str:
    if recording.whole:
        return "complete"
    if recording.damaged_chunks:
        return f"damaged: {recording.damaged_chunks} chunks cannot be read"
    return "incomplete: the program that wrote the recording did not end normally"
