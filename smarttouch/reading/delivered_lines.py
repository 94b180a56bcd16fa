"""Lines delivered through the whole chain to an emulated board, and as nerves respond to them."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from statistics import fmean

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.emulator.emulated_boards import SimulatedDriver
from smarttouch.imaging.array_window import pixel_pitch_mm, reading_force_n
from smarttouch.imaging.tactile_mapper import Tone
from smarttouch.kernels.bank import KernelBank
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.response import ignore_nan, response_quality
from smarttouch.physiology.spikes import SpikeModel
from smarttouch.profile import Profile
from smarttouch.reading.line_feed import LineFeed, TouchLine
from smarttouch.reading.line_source import LineMotion, ReadingSource, SweepingCursor
from smarttouch.running.config import RunConfig
from smarttouch.running.delivered import FIELD_MM, DeliveredResponses, LinePicture, delivered_spikes
from smarttouch.running.display import Display
from smarttouch.running.runner import Runner
from smarttouch.running.step import StepResult
from smarttouch.sources.source_contract import Pose
from smarttouch.stimulation.scan_sequence import NO_SHARING, SlotPolicy


@dataclass(frozen=True)
class LineDelivery:
    """Presentation of lines under the finger, for a profile of `profile_for_reading`."""

    profile: Profile
    bank: KernelBank
    tone: Tone  # from ink to activation
    motion: LineMotion
    mode: Mode = Mode.RA
    sharing: SlotPolicy = NO_SHARING
    intensity: float = 1.0  # in [0, 1], of the highest comfortable current


@dataclass(frozen=True, eq=False)
class DeliveredLine:
    """A line as it was delivered to the skin, sequence by sequence."""

    picture: LinePicture
    length_mm: float
    poses: dict[int, Pose]  # by number of the sequence
    meant: dict[int, NDArray[np.bool_]]  # (E,) electrodes that were to stimulate, likewise
    answers: dict[int, NDArray[np.float32]]  # (E,) in [0, 1], by number of the sequence
    numbers: NDArray[np.uint32]  # (N,), sequence of each delivered slot
    width_us: NDArray[np.float32]  # (N,)
    current_ua: NDArray[np.int16]  # (N, E), positive is cathodic


def deliver_pulses(line: TouchLine, reading: LineDelivery) -> DeliveredLine:
    """Read a line with a virtual finger on a simulated board.

    Frames, kernels, pressure gate, soft start, the proof of safety, the bytes and the board's own
    check are those of a live run; only the clock is virtual.
    """
    profile = reading.profile
    feed = LineFeed(iter([line])).start()
    cursor = SweepingCursor(feed, reading.motion, reading_force_n(profile))
    source = ReadingSource("a line", profile, feed, cursor)
    feed.wait_for_end()
    answers = DeliveredResponses(profile, reading.bank, reading.mode.afferents)
    meant: dict[int, NDArray[np.bool_]] = {}

    def watch(sent: StepResult) -> None:
        answers.watch(sent)
        if sent.number in answers.poses:
            meant[sent.number] = np.asarray(sent.step.tactile.activation.any(axis=0))

    config = RunConfig(
        mode=reading.mode, tone=reading.tone, scan=reading.sharing, intensity=reading.intensity
    )
    with Display("simulated:", profile) as display:
        Runner(
            source, display, config, listeners=[watch], load_kernels=lambda _: reading.bank
        ).run()
        driver = display.board.driver
        assert isinstance(driver, SimulatedDriver)
        pulses = driver.take_pulses()
        answers.deliver(*pulses)
    length_mm = int(line.image.shape[1]) * pixel_pitch_mm(profile)
    picture = LinePicture(profile.electrodes, length_mm)
    for pose, answer in answers:
        picture.add(pose.x_mm, answer)
    return DeliveredLine(picture, length_mm, answers.poses, meant, answers.answer, *pulses)


def deliver_lines(lines: Sequence[TouchLine], reading: LineDelivery) -> Iterator[DeliveredLine]:
    """Deliver many lines on all cores; yield each as it is ready."""
    # A process takes longer to start than one line to deliver.
    work = Parallel(n_jobs=-1 if len(lines) > 1 else 1, return_as="generator", max_nbytes=None)
    yield from work(delayed(deliver_pulses)(line, reading) for line in lines)


_FULL_QUANTILE = 0.99


@dataclass(frozen=True, eq=False)
class NerveReading:
    """Lines as one finger responded to them, and means of `ResponseQuality` over the sequences that
    had slots, each by itself; NaN if none of these fired.
    """

    pictures: list[LinePicture]
    shown: list[list[NDArray[np.float32]]]  # (E,) in [0, 1] for each pose of each line
    silent_points: float
    wrong_class: float
    misplaced: float


def read_at_nerve(
    lines: Sequence[DeliveredLine], finger: Finger, wanted: Collection[Afferent]
) -> NerveReading:
    """Return the response of a finger to delivered lines that were meant for some classes.

    Each electrode has the spikes of the receptors around it, of all classes, relative to nearly the
    most that any electrode has.
    """
    profile = finger.profile
    places = profile.electrodes.position_mm
    away = finger.receptor_mm[:, None] - places
    field = np.exp(-(away**2).sum(axis=2) / (2 * FIELD_MM**2)).astype(np.float32)
    silent = np.zeros(len(field), np.intp)
    found, model = [], SpikeModel(finger)
    values: list[list[NDArray[np.float32]]] = []
    for line in lines:
        periods = dict.fromkeys(line.poses, round(1e6 / profile.pulse.rate_hz))
        slots = line.numbers, line.width_us, line.current_ua
        # Products are small: a second thread would only wait.
        with threadpool_limits(limits=1, user_api="blas"):
            spikes = delivered_spikes(finger, *slots, periods, model=model)
        counts = {number: spikes.get(number, silent) for number in line.poses}
        values.append([each @ field for each in counts.values()])
        found += [
            response_quality(finger, counts[number], line.meant[number], wanted)
            for number in line.poses
            if number in line.answers
        ]
    full = float(np.quantile([each.max() for line in values for each in line], _FULL_QUANTILE))
    pictures = [LinePicture(profile.electrodes, line.length_mm) for line in lines]
    shown = [
        [np.clip(each / max(full, 1e-9), 0, 1).astype(np.float32) for each in line]
        for line in values
    ]
    for line, picture, those in zip(lines, pictures, shown, strict=True):
        for pose, each in zip(line.poses.values(), those, strict=True):
            picture.add(pose.x_mm, each)
    measures = (
        ignore_nan(fmean, (getattr(each, name) for each in found))
        for name in ("silent_points", "wrong_class", "misplaced")
    )
    return NerveReading(pictures, shown, *measures)
