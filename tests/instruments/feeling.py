"""A texture felt without hardware: the whole chain to a simulated board, and what the skin got."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from smarttouch.emulator.emulated_boards import SimulatedDriver
from smarttouch.instruments.electric_mouse import MouseSource, TexturePicture
from smarttouch.running.config import RunConfig
from smarttouch.running.inputs import Controls, ControlState
from smarttouch.running.pipeline import Pipeline, Regulator
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.running.step import StepResult
from smarttouch.sources.source_contract import Stimulus
from smarttouch.stimulation.recharge import ChargeBalance, RechargeRules

from ..looping import loop_through
from ..played import played

OPENED_NS = 700_000_000
"""So long the hand rests, and a point here and there opens the level."""


@dataclass(frozen=True, eq=False)
class FeltPulses:
    """Pulses that were felt, as delivered: of which sequence, electrode and place, how strong."""

    number: NDArray[np.int64]
    electrode: NDArray[np.intp]
    place_mm: NDArray[np.float64]
    answer: NDArray[np.float32]


def pulses_of(drawing: TexturePicture) -> FeltPulses:
    """Return the pulses that a drawing shows."""
    known = [number for number in drawing.answer if number in drawing.poses]
    if not known:
        nothing = np.zeros(0)
        return FeltPulses(nothing, nothing.astype(int), nothing.reshape(0, 2), nothing)
    answers = np.array([drawing.answer[number] for number in known])
    row, electrode = np.nonzero(answers)
    places = np.array([drawing.places_mm(drawing.poses[number]) for number in known])
    return FeltPulses(
        np.array(known)[row], electrode, places[row, electrode], answers[row, electrode]
    )


@dataclass(frozen=True, eq=False)
class SimulationResult:
    """Pulses felt, and by the number of each sequence when it began and where the hand was."""

    drawing: TexturePicture
    felt: FeltPulses
    times_ns: dict[int, int]
    poses_mm: dict[int, tuple[float, float]]
    tally: RunStatistics


def feel(sensor: MouseSource, profile, bank, seconds: float | None = None) -> SimulationResult:
    """Let a finger feel a texture until the hand stops; frames, kernels, safety are a live run's.

    The level is open before the hand moves, and nothing of that is part of the result. Charge is
    balanced, without which net current slows a texture under all electrodes.

    The sensor is closed at the end; the profile is as `profile_for_reading` returns it.
    """
    drawing = sensor.drawing(profile, bank)
    times_ns: dict[int, int] = {}
    poses_mm: dict[int, tuple[float, float]] = {}

    def opening(time_ns: int) -> Stimulus | None:
        given = read(time_ns)
        if given is not None and time_ns < OPENED_NS:
            activation = given.activation.copy()
            activation[sensor.mode.afferents[0], time_ns // 10_000_000 % len(activation[0])] = 1
            given = replace(given, activation=activation)
        return given

    read, sensor.read = sensor.read, opening

    def watch(sent: StepResult) -> None:
        if sent.step.input.time_ns < OPENED_NS:
            return
        drawing.watch(sent)
        if sent.number is not None:
            frame = sent.step.input
            times_ns[sent.number] = frame.time_ns
            poses_mm[sent.number] = (frame.pose.x_mm, frame.pose.y_mm)

    with sensor, played(profile, SimulatedDriver) as board:
        config = RunConfig(mode=sensor.mode, scan="points", balance=True)
        pipeline = Pipeline(profile, bank, config)
        pipeline.regulator = Regulator(
            ledger=ChargeBalance(len(profile.electrodes)),
            recharge=RechargeRules.of(profile, board.driver.timing),
        )
        tally = loop_through(
            sensor, pipeline, board, watch, seconds=seconds,
            controls=Controls(ControlState(sensor.mode)),
        )  # fmt: skip
        drawing.deliver(*board.driver.take_pulses())
    return SimulationResult(drawing, pulses_of(drawing), times_ns, poses_mm, tally)
