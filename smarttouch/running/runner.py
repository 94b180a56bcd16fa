"""The runner: puts one run together, and ends it with the display at zero whatever happens."""

import contextlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict
from typing import Any

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.clock import SimulatedClock
from smarttouch.base.errors import (
    BoardStoppedError,
    SmartTouchError,
    SourceError,
)
from smarttouch.base.events import Advice, Note, RunFailed
from smarttouch.base.posix import priority_advice
from smarttouch.base.stopping import StopRequest
from smarttouch.boards.board import Board, BoardReport
from smarttouch.boards.shutdown import stoppable_run
from smarttouch.kernels.bank import KernelBank, load_bank
from smarttouch.profile import Profile
from smarttouch.profile.ceilings import ADVISORY_RMS_MA_CM2
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.inputs import Controls, ControlState
from smarttouch.running.listener import Listener, RunContext, as_listeners
from smarttouch.running.loop import Loop, emit_to, steady_environment
from smarttouch.running.pipeline import Pipeline, make_regulator
from smarttouch.running.program import Program
from smarttouch.running.recording_format import recorded_settings
from smarttouch.running.run_statistics import RunStatistics, figures_of
from smarttouch.running.step import StepResult
from smarttouch.sources.force import ForceSource, open_force
from smarttouch.sources.source_contract import Source
from smarttouch.stimulation.safety_limits import rms_ma_cm2

MakeControls = Callable[[ControlState, tuple[Mode, ...]], Controls]


class Runner:
    """One run of a source on a display; the source is closed at its end.

    ``force`` is a source of finger force or its URL: if not given, where a finger may be on the
    board that of the profile's ``force.source``, else what source or board measure.
    ``load_kernels`` returns the kernels of a profile, ``controls`` makes the controls from their
    first state and the modes offered, and ``opened`` opens the board for a block. Time is the
    board's, and the machine's where a run is paced.
    """

    def __init__(
        self,
        source: Source,
        display: Display,
        config: RunConfig,
        *,
        force: ForceSource | str | None = None,
        listeners: Iterable[Listener | Callable[[StepResult], object]] = (),
        stop: StopRequest | None = None,
        load_kernels: Callable[[Profile], KernelBank] = load_bank,
        controls: MakeControls = Controls,
        opened: Callable[[StopRequest], AbstractContextManager[Board]] | None = None,
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
        self._vibrated = any(each.vibrates_pc for each in self._listeners)
        self._load_kernels = load_kernels
        self._make_controls = controls
        self._stop = stop or StopRequest()
        self._opened = opened or display.opened
        self._emit = emit_to(self._listeners)

    def run(self) -> RunStatistics:
        """Run until the source ends or a stop is requested; return the statistics.

        Raises whatever keeps the run from beginning or going on; the display is at zero.
        """
        with self.running(orderly=True) as loop:
            if isinstance(self.source, Program):
                self.source.perform(loop)
            else:
                loop.run()
        return self.statistics

    @contextmanager
    def running(self, *, orderly: bool = False) -> Iterator[Loop]:
        """Open the display for a block and yield the loop that delivers the source's inputs.

        The display is at zero after the block, whatever has ended it. If ``orderly``, a signal
        only requests a stop, and the block ends by itself.
        """
        with contextlib.ExitStack() as stack:
            ending = self.display.stopping
            # First of all, so that it ends last: whoever stops the run waits for its recording.
            to_its_end = stack.enter_context(stoppable_run(self._stop, self.display.board))
            stack.enter_context(ending.on_stop(lambda: self._stop.ask(ending.reason)))
            for listener in reversed(self._listeners):
                stack.callback(listener.close)
            stack.callback(self.source.close)
            if self._force_url is not None:
                self._force = stack.enter_context(open_force(self._force_url, self.display.profile))
            context, pipeline = self._prepared()
            if orderly:
                to_its_end()
            report: BoardReport | None = None
            ended = "fault"
            try:
                with self._open_loop(context, pipeline) as loop:
                    yield loop
                    context.board.stop()
                    report = context.board.report()
                ended = self._stop.reason or self.source.ended
                self._account(report)
                self.statistics.notes += loop.inputs.notes()
            except BoardStoppedError:
                ended = self._stop.reason or ended
                raise
            except SmartTouchError as error:
                self._emit(RunFailed(self._now_ns, str(error)))
                raise
            finally:
                self.source.close()
                board = self.display.board
                self.statistics.ended = ended
                self.statistics.figures = figures_of(
                    self.statistics, self.source, board, report, ended
                )
                self.statistics.notes += self._notes()
                self.display.notes_reported = len(board.notes)
            for listener in self._listeners:
                listener.finish(context)
        for listener in self._listeners:
            self.statistics.notes += listener.notes

    def _prepared(self) -> tuple[RunContext, Pipeline]:
        """Do all that takes long: the board is not open."""
        config, source, board = self.config, self.source, self.display.board
        self._require_a_level()
        profile = self.display.profile
        if self.display.on_a_finger:
            profile = source.narrowed(profile)
        bank = self.statistics.kernels = self._load_kernels(profile)
        pipeline = Pipeline(
            profile, bank, config, board.driver.timing, vibrated=self._vibrated,
            in_sums=board.driver.keeps_kernels,
        )  # fmt: skip
        first = 1.0 if config.intensity is None else config.intensity
        state = ControlState(pipeline.mode, first)
        offered = (state.mode,) if source.fixed_mode else pipeline.offered()
        controls = self._make_controls(state, offered)
        context = RunContext(
            source, board, profile, bank, config, controls, self.statistics,
            self._settings(profile),
        )  # fmt: skip
        source.emit = self._emit
        for listener in self._listeners:
            listener.prepare(context)
        return context, pipeline

    @contextmanager
    def _open_loop(self, context: RunContext, pipeline: Pipeline) -> Iterator[Loop]:
        """Open the board for a block and yield its loop; the board is closed, at zero, after it."""
        board, profile, source = context.board, context.profile, self.source
        clock = SimulatedClock() if board.simulated_time and not self.config.paced else None
        with steady_environment(pipeline, clock is not None), self._opened(self._stop):
            if pipeline.table is not None:
                board.keep_kernels(pipeline.table)
            self._require_force()
            self._warn_of_simulation(profile)
            if pipeline.mode is Mode.PC and self.display.on_a_finger:
                self._advise(_weak_selectivity(context.bank))
            pipeline.regulator = make_regulator(board, profile, self.config, self._advise)
            context.settings |= self._board_settings(pipeline)
            for listener in (*([source] if isinstance(source, Listener) else ()), *self._listeners):
                listener.start(context)
            source.tell_notes(0)
            yield Loop(
                source,
                pipeline,
                board,
                stop=self._stop,
                statistics=self.statistics,
                seconds=self.config.seconds,
                listeners=self._listeners,
                controls=context.controls,
                force=self._force,
                clock=clock,
            )
        board.notes += [*pipeline.notes()]
        if self.display.on_a_finger:
            board.notes += _density(profile)
            if not self.statistics.real_time:
                board.notes.append(priority_advice())

    def _settings(self, profile: Profile) -> dict[str, Any]:
        """Return all settings that sequences depend on, and others worth recording."""
        source, display = self.source, self.display
        return {
            **recorded_settings(self.config, profile),
            "vibrated": self._vibrated,
            "in_sums": display.board.driver.keeps_kernels,
            "timing": asdict(display.board.driver.timing),
            "sensor": source.url or source.title,
            "sensor_title": source.title,
            "board": display.url,
            "force": None if self._force is None else self._force.url or self._force.title,
        }

    def _board_settings(self, pipeline: Pipeline) -> dict[str, Any]:
        """Return settings that an open board reports, and the charge that an earlier run left."""
        can, ledger = self.display.board.capabilities, pipeline.regulator.ledger
        carried_pc = [] if ledger is None else ledger.charge_pc.tolist()
        return {
            "carried_pc": carried_pc if any(carried_pc) else [],
            "recharge": self.config.balance and can.recharges,
            "timing": asdict(self.display.board.driver.timing),
            "compliance_v": can.compliance_v,
            "firmware": can.firmware,
        }

    def _account(self, report: BoardReport) -> None:
        dose = self.display.board.dose
        self._note_late(
            f"counted by the {report.by}: {report.slots} slots, strongest "
            f"{report.max_current_ma:.3f} mA, {report.max_charge_uc:.3f} µC, {report.violations} "
            "violations"
        )
        self._note_late(
            f"dose {dose.seconds:.3f} s of current, {dose.most_mc:.4f} mC through one electrode, "
            f"net charge {dose.most_net_uc:.3f} µC"
        )
        told = self.source.notes[: self.source.notes_told]
        for words in self._notes():
            if words not in told:
                self._note_late(words)

    def _notes(self) -> list[str]:
        force = self._force
        return [
            *self.display.board.notes[self.display.notes_reported :],
            *self.source.notes,
            *(force.notes if force is not None else ()),
        ]

    def _advise(self, words: str) -> None:
        self._emit(Advice(0, words))

    def _note_late(self, words: str) -> None:
        self._emit(Note(self._now_ns, words))

    @property
    def _now_ns(self) -> int:
        return int(self.statistics.seconds * 1e9)

    def _require_a_level(self) -> None:
        if self.config.intensity is None and self.display.on_a_finger:
            raise SmartTouchError(
                "a finger may be on the board, and no intensity is set: give one, for example "
                "--intensity 0.3"
            )

    def _require_force(self) -> None:
        """Raise if no source of force could let current flow."""
        source, force, board = self.source, self._force, self.display.board
        finger = self.display.on_a_finger
        title = source.title if force is None else force.title
        if force is not None and (force.is_live or not finger):
            return
        if force is None and (
            board.capabilities.force or source.measures_force or (source.knows_force and not finger)
        ):
            return
        raise SourceError(
            f"the finger's force is not measured: neither {title} nor the board does, so there "
            "would be no current: give a source of force, for example --force hx711:PORT, or, "
            "where nothing measures it and a person presses, "
            f"--force fixed:{self.display.profile.force.full_n:g} (N)"
        )

    def _warn_of_simulation(self, profile: Profile) -> None:
        """Warn where a real finger gets values that were calibrated in simulation."""
        simulated = [
            name for name, note in profile.calibrated.items() if note.found.startswith("simulated")
        ]
        if simulated and self.display.on_a_finger:
            self._advise(
                f"Of the profile {', '.join(simulated)} were calibrated in simulation, on no "
                "finger: calibrate again, and turn the current up slowly."
            )


def _density(profile: Profile) -> list[str]:
    rms = rms_ma_cm2(profile)
    if rms <= ADVISORY_RMS_MA_CM2:
        return []
    return [
        f"at full intensity an electrode's own pulses are {rms:.0f} mA/cm² r.m.s.: above "
        f"{ADVISORY_RMS_MA_CM2:g}, IEC 60601-2-10 wants the operator's attention"
    ]


def _weak_selectivity(bank: KernelBank) -> str:
    """Return what PC mode does to the classes above."""
    most = float(bank.off_target[Afferent.PC].max())
    return (
        f"PC mode is not selective: classes nearer to the surface get up to {most:.1f} times what "
        f"PC does, and answer at {1 / most:.0%} of its current. Raise the intensity slowly."
    )
