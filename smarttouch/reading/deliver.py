"""Delivery of lines through the whole chain to an emulated board, for tests of legibility."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from smarttouch.afferent import Mode
from smarttouch.boards.emulator.simulated import SimulatedBoard
from smarttouch.delivered.line import LinePicture
from smarttouch.delivered.perception import DeliveredAnswers
from smarttouch.imaging.mapping import Tone
from smarttouch.imaging.registration import Registration
from smarttouch.kernels.bank import KernelBank
from smarttouch.profile import Profile
from smarttouch.reading.cursor import LineMotion, SweepingCursor
from smarttouch.reading.feed import LineFeed
from smarttouch.reading.line_source import ReadingSource
from smarttouch.reading.touch_line import TouchLine
from smarttouch.reading.window import pixel_of, press_n
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.runner import Runner
from smarttouch.sources.frame import Pose
from smarttouch.stimulation.sharing import NO_SHARING, SlotPolicy


@dataclass(frozen=True)
class Reading:
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
    answers: dict[int, NDArray[np.float32]]  # (E,) in [0, 1], by number of the sequence
    numbers: NDArray[np.uint32]  # (N,), sequence of each delivered slot
    width_us: NDArray[np.float32]  # (N,)
    current_ua: NDArray[np.int16]  # (N, E), positive is cathodic


def deliver_pulses(line: TouchLine, reading: Reading) -> DeliveredLine:
    """Read a line with a virtual finger on a simulated board.

    Frames, kernels, pressure gate, soft start, the proof of safety, the bytes and the board's own
    check are those of a live run; only the clock is virtual.
    """
    profile = reading.profile
    feed = LineFeed(iter([line])).start()
    cursor = SweepingCursor(feed, reading.motion, press_n(profile))
    source = ReadingSource("a line", profile, feed, cursor)
    feed.wait_for_end()
    answers = DeliveredAnswers(profile, reading.bank, reading.mode.afferents)
    config = RunConfig(
        mode=reading.mode, tone=reading.tone, scan=reading.sharing, intensity=reading.intensity
    )
    with Display("simulated:", profile) as display:
        Runner(
            source,
            display,
            config,
            listeners=[answers.watch],
            load_kernels=lambda _: reading.bank,
        ).run()
        board = display.board
        assert isinstance(board, SimulatedBoard)
        pulses = board.take_pulses()
        answers.deliver(*pulses)
    length_mm = _length_mm(line, profile)
    picture = LinePicture(profile.electrodes, length_mm)
    for pose, answer in answers:
        picture.add(pose.x_mm, answer)
    return DeliveredLine(picture, length_mm, answers.poses, answers.answer, *pulses)


def deliver_lines(lines: Sequence[TouchLine], reading: Reading) -> Iterator[DeliveredLine]:
    """Deliver many lines on all cores; yield each as it is ready."""
    # A process takes longer to start than one line to deliver.
    work = Parallel(n_jobs=-1 if len(lines) > 1 else 1, return_as="generator", max_nbytes=None)
    yield from work(delayed(deliver_pulses)(line, reading) for line in lines)


def ideal_picture(line: TouchLine, profile: Profile, step_mm: float) -> LinePicture:
    """Return the best that an array could deliver of a line: the ink in each electrode's cell.

    Nothing is lost to kernels, thresholds or whole microamperes; what is left
    is the pitch of the electrodes and the distance between two pulses.
    """
    optics, pixel_mm = profile.optics, pixel_of(profile)
    shape = (optics.sensor_rows, optics.sensor_columns)
    registration = Registration(profile.electrodes, optics, shape)
    picture = LinePicture(profile.electrodes, _length_mm(line, profile))
    paper = cv2.copyMakeBorder(
        line.image, 0, 0, shape[1] + 1, shape[1] + 1, cv2.BORDER_CONSTANT, value=255
    )
    for x_mm in np.arange(line.start_mm, line.end_mm + step_mm, step_mm):
        left = round(float(x_mm) / pixel_mm - shape[1] / 2) + shape[1] + 1
        window = paper[:, max(0, left) : max(0, left) + shape[1]]
        if window.shape == shape:
            ink = np.asarray(cv2.bitwise_not(np.ascontiguousarray(window)), np.uint8)
            picture.add(float(x_mm), registration.sample(ink))
    return picture


def _length_mm(line: TouchLine, profile: Profile) -> float:
    return int(line.image.shape[1]) * pixel_of(profile)
