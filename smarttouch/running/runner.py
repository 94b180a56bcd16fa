"""Runner, which assembles a run and ends it at zero current. Functions `run`, `steps`, `replay`."""

import contextlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.clock import SimulatedClock
from smarttouch.base.errors import BoardStoppedError, SmartTouchError, SourceError
from smarttouch.base.events import Advice, Note, RunFailed
from smarttouch.base.posix import priority_advice
from smarttouch.base.stopping import StopRequest
from smarttouch.boards.board import BoardReport
from smarttouch.boards.shutdown import stoppable_run
from smarttouch.kernels.bank import KernelBank, load_bank
from smarttouch.profile import Profile, load_profile
from smarttouch.profile.project_ceilings import ADVISORY_RMS_MA_CM2
from smarttouch.running.config import RunConfig, configured
from smarttouch.running.display import Display, open_display
from smarttouch.running.loop import Controls, ControlState, Loop, emit_to, steady_environment
from smarttouch.running.pattern_program import Program
from smarttouch.running.pipeline import Pipeline, make_regulator
from smarttouch.running.recording_format import recorded_settings
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.running.step_records import Listener, RunContext, Step, StepResult, as_listeners
from smarttouch.sources import open_source, options_taken, source_of
from smarttouch.sources.force import ForceSource, open_force
from smarttouch.sources.source_contract import (
    Given,
    Imaging,
    OwnImaging,
    Source,
    checked_input,
)
from smarttouch.stimulation.safety_limits import rms_ma_cm2
from smarttouch.stimulation.sequence_limits import Dose

Listeners = Iterable[Listener | Callable[[StepResult], object]]
MakeControls = Callable[[ControlState, tuple[Mode, ...]], Controls]


class Runner:
    """One run of a source on a display; the source is closed at the end.

    ``force`` is a source of finger force or its URL. If a finger may be on the board, the default
    is the profile's ``force.source``. Otherwise force comes from ``source`` or the board.
    ``load_kernels`` returns the kernels of a profile. ``controls`` makes the controls from the
    initial state and the offered modes.
    """

    def __init__(
        self,
        source: Source,
        display: Display,
        config: RunConfig,
        *,
        force: ForceSource | str | None = None,
        listeners: Listeners = (),
        stop: StopRequest | None = None,
        load_kernels: Callable[[Profile], KernelBank] = load_bank,
        controls: MakeControls = Controls,
    ) -> None:
        self.source: Source = source
        self.display: Display = display
        self.config: RunConfig = config
        if force is None and display.on_a_finger:
            force = display.profile.force.source
        self._force = None if isinstance(force, str) else force
        self._force_url = force if isinstance(force, str) else None
        self.statistics: RunStatistics = RunStatistics()
        self._listeners = as_listeners(listeners)
        self._load_kernels, self._make_controls = load_kernels, controls
        self._stop = stop or StopRequest()
        self._emit = emit_to(self._listeners)

    def run(self) -> RunStatistics:
        """Run until the source ends or a stop is requested; return the statistics.

        Raises any error that prevents or ends the run; the display is then at zero.
        """
        with self.running(orderly=True) as loop:
            if isinstance(self.source, Program):
                self.source.perform(loop)
            else:
                loop.run()
        return self.statistics

    @contextmanager
    def running(self, *, orderly: bool = False) -> Iterator[Loop]:
        """Open the display for a ``with`` block, and yield the loop that delivers inputs.

        The display is at zero after the block. If ``orderly``, a signal only requests a stop, and
        the block must then end by itself.
        """
        source, display, statistics = self.source, self.display, self.statistics
        board, stop, ended = display.board, self._stop, "fault"
        report: BoardReport | None = None
        with contextlib.ExitStack() as stack:
            # Exit `stoppable_run` last, so that `smarttouch stop` waits for all recordings.
            to_its_end = stack.enter_context(stoppable_run(stop, board))
            stack.enter_context(display.stopping.on_stop(lambda: stop.ask(display.stopping.reason)))
            for listener in reversed(self._listeners):
                stack.callback(listener.close)
            stack.callback(source.close)
            if self._force_url is not None:
                self._force = stack.enter_context(open_force(self._force_url, display.profile))
            context, pipeline = self._prepared()
            if orderly:
                to_its_end()
            try:
                with self._open_loop(context, pipeline) as loop:
                    yield loop
                    board.stop()
                    with contextlib.suppress(BoardStoppedError):
                        report = board.report()
                ended = stop.reason or source.ended
                reported = source.notes[: source.notes_told]
                notes = [words for words in self._notes() if words not in reported]
                for words in [*_account(report, board.dose), *notes]:
                    self._emit(Note(self._now_ns, words))
            except BoardStoppedError:
                ended = stop.reason or ended
                raise
            except SmartTouchError as error:
                self._emit(RunFailed(self._now_ns, str(error)))
                raise
            finally:
                source.close()
                statistics.complete(source, board, report, ended)
                statistics.notes += self._notes()
                display.notes_reported = len(board.notes)
            for listener in self._listeners:
                listener.finish(context)
        for listener in self._listeners:
            statistics.notes += listener.notes

    def _prepared(self) -> tuple[RunContext, Pipeline]:
        """Do slow preparations, before the board is opened; return context and pipeline."""
        config, source, display = self.config, self.source, self.display
        driver, profile = display.board.driver, display.profile
        if display.on_a_finger:
            if config.intensity is None:
                raise SmartTouchError(
                    "a finger may be on the board, but no intensity is set: set it, for example by "
                    "--intensity 0.3"
                )
            profile = source.narrowed(profile)
        bank = self.statistics.kernels = self._load_kernels(profile)
        vibrated = any(listener.vibrates_pc for listener in self._listeners)
        pipeline = Pipeline(
            profile, bank, config, driver.timing, vibrated=vibrated, in_sums=driver.keeps_kernels
        )
        first = 1.0 if config.intensity is None else config.intensity
        state = ControlState(pipeline.mode, first)
        offered = (state.mode,) if source.fixed_mode else pipeline.offered()
        controls = self._make_controls(state, offered)
        settings = {
            **recorded_settings(config, profile),
            "vibrated": vibrated,
            "in_sums": driver.keeps_kernels,
            "sensor": source.url or source.title,
            "sensor_title": source.title,
            "board": display.url,
            "force": None if self._force is None else self._force.url or self._force.title,
        }
        context = RunContext(
            source, display.board, profile, bank, config, controls, self.statistics, settings
        )
        source.emit = self._emit
        for listener in self._listeners:
            listener.prepare(context)
        return context, pipeline

    @contextmanager
    def _open_loop(self, context: RunContext, pipeline: Pipeline) -> Iterator[Loop]:
        """Open the board for a ``with`` block, and yield the loop. After the block the board is at
        zero and closed."""
        board, profile, source = context.board, context.profile, self.source
        on_a_finger = self.display.on_a_finger
        clock = SimulatedClock() if board.simulated_time and not self.config.paced else None
        with steady_environment(pipeline, clock is not None), self.display.opened(self._stop):
            if pipeline.table is not None:
                board.keep_kernels(pipeline.table)
            self._require_force()
            if on_a_finger:
                for words in _warnings(profile, context.bank, pipeline.mode):
                    self._advise(words)
            pipeline.regulator = make_regulator(board, profile, self.config, self._advise)
            can, ledger = board.capabilities, pipeline.regulator.ledger
            context.settings |= {
                "carried_pc": ledger.charge_pc.tolist()
                if ledger and ledger.charge_pc.any()
                else [],
                "recharge": self.config.balance and can.recharges,
                "timing": asdict(board.driver.timing),
                "compliance_v": can.compliance_v,
                "firmware": can.firmware,
            }
            for listener in (*([source] if isinstance(source, Listener) else ()), *self._listeners):
                listener.start(context)
            source.tell_notes(0)
            yield Loop(
                source, pipeline, board, stop=self._stop, statistics=self.statistics,
                seconds=self.config.seconds, listeners=self._listeners,
                controls=context.controls, force=self._force, clock=clock,
            )  # fmt: skip
        board.notes += pipeline.notes()
        rms = rms_ma_cm2(profile)
        if on_a_finger and rms > ADVISORY_RMS_MA_CM2:
            board.notes.append(
                f"the current density at full intensity is {rms:.0f} mA/cm² r.m.s.: watch the "
                "finger, because IEC 60601-2-10 requires attention above "
                f"{ADVISORY_RMS_MA_CM2:g} mA/cm²"
            )
        if on_a_finger and not self.statistics.real_time:
            board.notes.append(priority_advice())

    def _notes(self) -> list[str]:
        """Return the notes so far, from the board, the source and the source of force."""
        noted = self.display.board.notes[self.display.notes_reported :]
        return [*noted, *self.source.notes, *(() if self._force is None else self._force.notes)]

    def _advise(self, words: str) -> None:
        self._emit(Advice(0, words))

    @property
    def _now_ns(self) -> int:
        return int(self.statistics.seconds * 1e9)

    def _require_force(self) -> None:
        """Raise SourceError if no finger force is known: without force no current flows."""
        source, force, board = self.source, self._force, self.display.board
        finger = self.display.on_a_finger
        if force is not None:
            title, flows = force.title, force.is_live or not finger
        else:
            title, known = source.title, source.knows_force and not finger
            flows = board.capabilities.force or source.measures_force or known
        if not flows:
            raise SourceError(
                f"neither {title} nor the board measures the finger's force, and without force no "
                "current flows: choose a source of force, for example --force hx711:PORT. If "
                "there is no sensor, state the finger's force in N, for example --force "
                f"fixed:{self.display.profile.force.full_n:g}"
            )


def _warnings(profile: Profile, bank: KernelBank, mode: Mode) -> Iterator[str]:
    """Yield warnings for a real finger before current flows."""
    simulated = [
        name for name, note in profile.calibrated.items() if note.found.startswith("simulated")
    ]
    if simulated:
        yield (
            f"The profile's {', '.join(simulated)} were calibrated in simulation, not on a real "
            "finger: calibrate again, and raise the intensity slowly."
        )
    if mode is Mode.PC:
        worst = float(bank.off_target[Afferent.PC].max())
        yield (
            f"PC mode is not selective: shallower classes are activated up to {worst:.1f} times "
            f"as strongly as PC, and fire at {1 / worst:.0%} of the current that PC needs. Raise "
            "the intensity slowly."
        )


def _account(report: BoardReport | None, dose: Dose) -> list[str]:
    """Return two sentences: the counts of what was delivered, if known, and the session's dose."""
    return [
        "no report arrived from the board after the stop: what it delivered is unknown"
        if report is None
        else f"counted by the {report.by}: {report.slots} slots, pulses of at most "
        f"{report.max_current_ma:.3f} mA and {report.max_charge_uc:.3f} µC, {report.violations} "
        "violations of limits",
        f"dose: {dose.seconds:.3f} s of current, at most {dose.most_mc:.4f} mC through one "
        f"electrode, net charge of at most {dose.most_net_uc:.3f} µC",
    ]


def run(
    source: Given,
    display: Display | str,
    config: RunConfig | None = None,
    *,
    listeners: Listeners = (),
    force: ForceSource | str | None = None,
    imaging: Imaging | None = None,
    stop: StopRequest | None = None,
    **settings: Any,
) -> RunStatistics:
    """Run a source on a display to its end, or until `Display.stop`; return the statistics.

    Parameters
    ----------
    source : Source, str, Path, ndarray or iterable
        A source, which is closed at the end; a URL; the path of an image, document, video or
        recording; images (N, H, W) uint8; or an iterable of images, one for each sequence.
    display : Display or str
        A display, or the URL of its board.
    config : RunConfig, optional
        Settings of the run.
    listeners : iterable of Listener or callable
        Listeners; a plain function receives each `StepResult`.
    force : ForceSource or str, optional
        Source of finger force, or its URL; by default ``source`` or the board. If a finger may be
        on the board, force must be measured, or stated as ``"fixed:0.9"``, here or in the profile's
        ``force.source``.
    imaging : callable, optional
        Function that converts a `Frame` to activation, (3, E) in [0, 1], instead of the built-in
        imaging.
    stop : StopRequest, optional
        Stop request, which ends the run, like `Display.stop`.
    **settings
        Settings of `RunConfig` that replace those of ``config``: ``mode``, ``seconds``,
        ``intensity`` …

    Raises
    ------
    SmartTouchError
        Any error that prevents or ends the run; the display is then at zero.

    Examples
    --------
    >>> import smarttouch as st
    >>> st.run("text:a", "simulated:", seconds=0.5).frames
    25
    """
    config = configured(config, settings)
    display = open_display(display) if isinstance(display, str) else display
    profile, listeners = display.profile, as_listeners(listeners)
    vibrated = any(listener.vibrates_pc for listener in listeners)
    if vibrated and isinstance(source, str) and "vibrated" in options_taken(source):
        opened = open_source(source, profile, vibrated=True)
    else:
        opened = source_of(source, profile, light_on_dark=config.light_on_dark)
    if imaging is not None:
        opened = OwnImaging(opened, imaging, profile)
    return Runner(opened, display, config, force=force, listeners=listeners, stop=stop).run()


def steps(
    source: Given,
    profile: Profile | str,
    config: RunConfig | None = None,
    *,
    kernels: KernelBank | None = None,
    **settings: Any,
) -> Iterator[Step]:
    """Yield each frame of a source with its tactile image and sequence, without board and clock.

    Sequences are made as for a board that stores kernels, such as ``emulator:`` or ``simulated:``.

    Parameters
    ----------
    source : Source, str, Path, ndarray or iterable
        See `run`.
    profile : Profile or str
        Device and finger, or the name or file of the profile.
    config : RunConfig, optional
        Settings of the run.
    kernels : KernelBank, optional
        By default the kernels of the profile.
    **settings
        Settings of `RunConfig` that replace those of ``config``; ``intensity`` is 1 by default.

    Examples
    --------
    >>> import smarttouch as st
    >>> profile = st.load_profile("electric-mouse")
    >>> first = next(st.steps(st.open_source("text:a", profile), profile))
    >>> first.tactile.activation.shape
    (3, 64)
    """
    profile, config = load_profile(profile), configured(config, settings)
    level = 1.0 if config.intensity is None else config.intensity
    pipeline = Pipeline(profile, kernels or load_bank(profile), config, in_sums=True)
    most_ns = float("inf") if config.seconds is None else config.seconds * 1e9
    elapsed_ns = 0
    with source_of(source, profile, light_on_dark=config.light_on_dark) as opened:
        while elapsed_ns < most_ns and (current := opened.read(elapsed_ns)) is not None:
            frame = checked_input(current, opened, pipeline.electrodes)
            if frame.stale:
                frame = replace(frame, force_n=0.0)
            step = pipeline.process(frame, level)
            yield step
            elapsed_ns += 1000 * step.sequence.period_us


def replay(
    path: Path | str,
    display: Display,
    *,
    listeners: Listeners = (),
    force: ForceSource | str | None = None,
    stop: StopRequest | None = None,
    **settings: Any,
) -> RunStatistics:
    """Play a recording on a display, with the recorded modes and levels.

    Parameters
    ----------
    path : Path or str
        The recording.
    display : Display
        Display, whose profile may differ from the recorded profile. If a finger may be on the
        board, the stricter limits of both profiles apply, and the recorded force is not used.
    listeners, force, stop
        See `run`.
    **settings
        Settings of `RunConfig` to replace; ``intensity`` scales the recorded intensity.

    Raises
    ------
    RecordingError
        If the recording cannot be read, or the board does not offer the recorded modes.
    SmartTouchError
        See `run`.

    Examples
    --------
    >>> import smarttouch as st, tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "run.mcap"
    >>> display = st.open_display("simulated:")
    >>> source = st.open_source("text:a", display.profile)
    >>> first = st.run(source, display, seconds=0.5, listeners=[st.Recorder(path)])
    >>> st.replay(path, display).slots == first.slots
    True
    """
    from smarttouch.running.recorded_source import RecordedControls, RecordingSource
    from smarttouch.running.recording_reader import RecordedRun

    recording = RecordedRun(path)
    config = recording.run.model_copy(update={"hold": None, "balance": False} | dict(settings))
    return Runner(
        RecordingSource(recording), display, config, force=force, listeners=listeners, stop=stop,
        controls=partial(RecordedControls, recording),
    ).run()  # fmt: skip
