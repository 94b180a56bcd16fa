"""The 8 x 8 array on a mouse, textures to touch, and what a simulated board delivered of them."""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from smarttouch.emulator.emulated_boards import SimulatedDriver
from smarttouch.imaging.array_window import profile_for_reading, reading_force_n
from smarttouch.instruments.electric_mouse import MouseSource, TexturePicture
from smarttouch.instruments.hand_motion import START_S, PathMotion, SweepMotion
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.inputs import Controls, ControlState
from smarttouch.running.pipeline import Pipeline, Regulator
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.running.step import StepResult
from smarttouch.sources.source_contract import Stimulus
from smarttouch.stimulation.recharge import ChargeBalance, RechargeRules

from ..support.runs import loop_through
from ..support.scans import board_without_finger


@pytest.fixture(scope="session")
def mouse():
    """The electric mouse, millimeter by millimeter."""
    return profile_for_reading(load_profile("electric-mouse"))


@pytest.fixture(scope="session")
def mouse_bank(mouse):
    return load_bank(mouse)


@pytest.fixture(scope="session")
def brief(mouse, changed):
    """The same with pulses so short that neither net current nor its balance slows a frame."""
    return changed(mouse, {"pulse.width_us": 20})


DPI = 254
"""A tenth of a millimeter a pixel."""
FELT = 0.5
"""Answers above are of the electrode itself, and not of a neighbor's currents."""


def grating_file(path, angle_deg, kind="square", noise=0.0):
    """Draw a grating of 4 mm on 90 x 40 mm as an image, its ridges square, thin or faint."""
    y, x = np.mgrid[:400, :900] / 10
    angle = math.radians(angle_deg)
    phase = (x * math.cos(angle) + y * math.sin(angle)) / 4
    ridge = {
        "square": (phase + 0.25) % 1 < 0.5,
        "thin": (phase + 0.1) % 1 < 0.2,
        "faint": 0.5 + 0.1 * np.cos(2 * math.pi * phase),
    }[kind]
    grey = 255 * (1 - ridge) + noise * np.random.default_rng(1).standard_normal(ridge.shape)
    Image.fromarray(np.clip(grey, 0, 255).astype(np.uint8)).save(path, dpi=(DPI, DPI))
    return path


def object_file(path, kind, size_mm=(80, 40), at_mm=(40.0, 20.0)):
    """Draw a disc of 10 mm or a cross of 14 mm on paper."""
    image = np.full([round(10 * side) for side in size_mm[::-1]], 255, np.uint8)
    x, y = (round(10 * each) for each in at_mm)
    if kind == "disc":
        cv2.circle(image, (x, y), 50, 0, -1)
    else:
        cv2.rectangle(image, (x - 70, y - 15), (x + 69, y + 14), 0, -1)
        cv2.rectangle(image, (x - 15, y - 70), (x + 14, y + 69), 0, -1)
    Image.fromarray(image).save(path, dpi=(DPI, DPI))
    return path


def path_motion(folder, times_s, x_mm, y_mm):
    """Return a motion along points; it rests at the first until intensity is up, and at the end."""
    times = [0, *(START_S + np.asarray(times_s)), START_S + times_s[-1] + 0.1]
    rows = zip(times, [x_mm[0], *x_mm, x_mm[-1]], [y_mm[0], *y_mm, y_mm[-1]], strict=True)
    path = folder / "way.csv"
    lines = [",".join(f"{each:.6f}" for each in row) for row in rows]
    path.write_text("\n".join(["time_s,x_mm,y_mm", *lines]) + "\n")
    return PathMotion(path)


def touch(texture, motion, profile, bank, seconds=None, **options):
    """Let a finger feel a texture; return what was delivered, and the source."""
    source = MouseSource(texture, motion, profile, press_n=reading_force_n(profile), **options)
    return feel(source, profile, bank, seconds), source


def stroke(texture, speed_mm_s, profile, bank, length_mm=60.0, origin_mm=(15.3, 20.3), **options):
    """Stroke once to the right; return pulses of each electrode, (E,) Hz, and the source."""
    motion = SweepMotion(speed_mm_s, (length_mm, 0.0))
    motion.origin_mm = origin_mm
    seconds = length_mm / speed_mm_s
    felt, source = touch(texture, motion, profile, bank, START_S + seconds + 0.03, **options)
    in_time = (felt.time_s > START_S) & (felt.time_s <= START_S + seconds + 0.02)
    there = in_time & (felt.answer > FELT)
    pulses = np.bincount(felt.electrode[there], minlength=len(profile.electrodes))
    return pulses / seconds, source


OPENED_NS = 700_000_000
"""So long the hand rests, and a point here and there opens the level."""


@dataclass(frozen=True, eq=False)
class Felt:
    """What was delivered: pulses by when their sequence began, electrode, place and strength."""

    drawing: TexturePicture
    tally: RunStatistics
    time_s: NDArray[np.float64]
    electrode: NDArray[np.intp]
    place_mm: NDArray[np.float64]
    answer: NDArray[np.float32]


def feel(sensor: MouseSource, profile, bank, seconds: float | None = None) -> Felt:
    """Let a finger feel a texture until the hand stops; frames, kernels, safety are a live run's.

    The level is open before the hand moves, and nothing of that is part of the result. Charge is
    balanced, without which net current slows a texture under all electrodes.

    The sensor is closed at the end; the profile is as `profile_for_reading` returns it.
    """
    drawing = sensor.drawing(profile, bank)
    times_s: dict[int, float] = {}

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
            times_s[sent.number] = sent.step.input.time_ns / 1e9

    with sensor, board_without_finger(profile, SimulatedDriver) as board:
        pipeline = Pipeline(profile, bank, RunConfig(mode=sensor.mode, scan="points", balance=True))
        pipeline.regulator = Regulator(
            ledger=ChargeBalance(len(profile.electrodes)),
            recharge=RechargeRules.of(profile, board.driver.timing),
        )
        controls = Controls(ControlState(sensor.mode))
        tally = loop_through(sensor, pipeline, board, watch, seconds=seconds, controls=controls)
        drawing.deliver(*board.driver.take_pulses())
    count = len(profile.electrodes)
    known = [each for each in drawing.answers if each in drawing.poses]
    answers = np.array([drawing.answers[each] for each in known]).reshape(-1, count)
    places = [drawing.places_mm(drawing.poses[each]) for each in known]
    row, electrode = np.nonzero(answers)
    return Felt(
        drawing, tally, np.array([times_s[each] for each in known])[row], electrode,
        np.reshape(places, (-1, count, 2))[row, electrode], answers[row, electrode],
    )  # fmt: skip
