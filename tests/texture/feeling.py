"""A texture felt without hardware: the whole chain to a simulated board, and what the skin got."""

from dataclasses import dataclass

from smarttouch.boards.emulator.simulated import SimulatedBoard
from smarttouch.clock import SimulatedClock
from smarttouch.kernels.bank import KernelBank
from smarttouch.profile import Profile
from smarttouch.running.config import RunConfig
from smarttouch.running.controls import Controls, ControlState
from smarttouch.running.listener import as_listeners
from smarttouch.running.loop import run_loop
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.statistics import RunStatistics
from smarttouch.running.step import StepResult
from smarttouch.stimulation.safety import SafetyLimits
from smarttouch.stopping import StopRequest
from smarttouch.texture.felt import FeltMap
from smarttouch.texture.source import MouseSource


@dataclass(frozen=True, eq=False)
class Touched:
    """What came of it.

    Attributes
    ----------
    felt : FeltMap
        Every delivered pulse, in the world.
    times_ns : dict of int to int, ns
        When each sequence began, by its number.
    poses_mm : dict of int to tuple of float, mm
        Where the hand was then.
    tally : RunStatistics
    """

    felt: FeltMap
    times_ns: dict[int, int]
    poses_mm: dict[int, tuple[float, float]]
    tally: RunStatistics


def feel(
    source: MouseSource,
    profile: Profile,
    bank: KernelBank,
    seconds: float | None = None,
) -> Touched:
    """Let a finger feel a texture until the hand stops; frames, kernels, safety are a live run's.

    Parameters
    ----------
    source : MouseSource
        Closed at the end.
    profile : Profile
        As `profile_for_reading` returns it.
    bank : KernelBank
    seconds : float, optional
        Longest run.

    Raises
    ------
    SmartTouchError
        Whatever would end such a run.
    """
    felt = source.drawing(profile, bank)
    times_ns: dict[int, int] = {}
    poses_mm: dict[int, tuple[float, float]] = {}
    tally = RunStatistics()

    def watch(sent: StepResult) -> None:
        felt.watch(sent)
        if sent.number is not None:
            frame = sent.step.input
            times_ns[sent.number] = frame.time_ns
            poses_mm[sent.number] = (frame.pose.x_mm, frame.pose.y_mm)

    limits = SafetyLimits.of(profile)
    with source, SimulatedBoard("", limits, profile.output) as board:
        run_loop(
            source,
            Pipeline(profile, bank, RunConfig(mode=source.mode, scan="points")),
            board,
            stop=StopRequest(),
            statistics=tally,
            seconds=seconds,
            listeners=as_listeners([watch]),
            controls=Controls(ControlState(source.mode)),
            clock=SimulatedClock(),
        )
        felt.deliver(*board.take_pulses())
    return Touched(felt, times_ns, poses_mm, tally)
