"""The electric mouse: electrodes pulse when ridges of a texture pass under them."""

import math
import re
from collections.abc import Mapping
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import SmartTouchError, SourceError, require_within
from smarttouch.base.events import Note
from smarttouch.imaging.reading_profile import pixel_pitch_mm, profile_for_reading, reading_force_n
from smarttouch.instruments.hand_motion import HandMotion, open_motion, strokes_over
from smarttouch.instruments.relief import open_texture
from smarttouch.instruments.textures import Texture
from smarttouch.kernels.bank import KernelBank
from smarttouch.pages.page_and_lines import Page
from smarttouch.profile import Profile
from smarttouch.running.step_records import StepResult
from smarttouch.sources.source_contract import (
    DeviceWarnings,
    Pose,
    Sheet,
    Stimulus,
    StimulusSource,
)
from smarttouch.views.delivered_drawing import DeliveredDrawing, Under

_UNBOUNDED_MM = (150.0, 100.0)  # size of the part of an unbounded texture that is shown
_LONGEST_PX = 1000
_ROUNDING_MM = 1.0  # rounding may put the pointer this far outside of the texture


class PageMotion(HandMotion):
    """Motion of the pointer over a texture that is shown in the run's window."""

    resolution_mm: float = 0.25  # about the size of a pixel in the window

    def __init__(self, texture: Texture) -> None:
        super().__init__("the pointer over the page")
        wide, high = texture.size_mm or _UNBOUNDED_MM
        middle = texture.middle_mm
        corner = (middle[0] - wide / 2, middle[1] - high / 2)
        pixel_mm = max(wide, high) / _LONGEST_PX
        shape = (max(1, round(high / pixel_mm)), max(1, round(wide / pixel_mm)))
        picture = Page(texture.draw(*corner, shape, pixel_mm), pixel_mm)
        self.sheet: Sheet = Sheet(1, picture, corner)
        self.is_shown: bool = False  # whether the run's window shows the texture
        self.origin_mm: tuple[float, float] = middle
        # Replacing the tuple is atomic, so no lock is needed.
        self._place_mm = middle

    def move(self, x_mm: float, y_mm: float) -> None:
        """Move the hand to a place, mm. Raises ValueError if it is not on the texture."""
        sides = zip((x_mm, y_mm), self.sheet.corner_mm, self.sheet.page.size_mm, strict=True)
        if not all(-_ROUNDING_MM <= at - low <= size + _ROUNDING_MM for at, low, size in sides):
            raise ValueError(f"{x_mm:g}, {y_mm:g} mm is not on the texture")
        self._place_mm = (x_mm, y_mm)

    def read(self, time_ns: int) -> tuple[float, float]:
        """Return the displacement of the pointer from the middle of the texture."""
        if not self.is_shown:
            raise SourceError("motion=page follows the pointer in the run's window: add --window")
        x, y = self._place_mm
        return x - self.origin_mm[0], y - self.origin_mm[1]


SLIDES = 1.5
"""Distance, in mouse counts, by which the filtered place lags behind a moving hand. It is larger
than 1.4 counts, the length of a jitter of one count along both axes."""
STICKS = 4.5
"""A hand at rest counts as moving if it is farther than this from the filtered place, in mouse
counts. Jitter alone causes a distance of up to 4.3 counts: the filter lags by 1.5, and jitter of
two counts along both axes adds 2.8."""
_ROUNDING = 1 + 1e-6  # factor that tolerates rounding errors when distances are compared


class Deadband:
    """Filter with hysteresis that removes the jitter of a resting hand.

    After the first read at rest, jitter of one count (`resolution_mm`) along each axis does not
    change the filtered place. If the resolution is 0, the filter changes nothing.
    """

    def __init__(self, resolution_mm: float) -> None:
        self._slides_mm, self._sticks_mm = SLIDES * resolution_mm, STICKS * resolution_mm
        self._moves = False
        self._x_mm = self._y_mm = 0.0

    def follow(self, x_mm: float, y_mm: float) -> tuple[float, float]:
        """Return the filtered place of the hand, mm."""
        by_x, by_y = x_mm - self._x_mm, y_mm - self._y_mm
        far_mm = math.hypot(by_x, by_y)
        far_enough_mm = self._slides_mm if self._moves else self._sticks_mm
        self._moves = far_mm > far_enough_mm * _ROUNDING
        if self._moves:
            share = 1 - self._slides_mm / far_mm
            self._x_mm += share * by_x
            self._y_mm += share * by_y
        return self._x_mm, self._y_mm


class TexturePicture(DeliveredDrawing):
    """Drawing of the strongest response at each place. Pulses are too few for a mean response."""

    strongest: bool = True
    longest_px: int = 3000

    def __init__(
        self, profile: Profile, bank: KernelBank, afferents: tuple[Afferent, ...], texture: Texture
    ) -> None:
        super().__init__(profile, bank, afferents)
        self._texture = texture
        self._least, self._most = np.full(2, np.inf), np.full(2, -np.inf)

    def watch(self, sent: StepResult) -> None:
        """Record the pose of a step, and extend the area over which the array has moved."""
        super().watch(sent)
        position_mm = (sent.input.pose.x_mm, sent.input.pose.y_mm)
        self._least, self._most = (
            np.minimum(self._least, position_mm),
            np.maximum(self._most, position_mm),
        )

    def under(self) -> Under:
        """Return the part of the texture that the array passed over."""
        if not np.isfinite(self._least).all():
            raise SmartTouchError("nothing to draw, because no step was sent: let the run go on")
        half = np.abs(self._position_mm).max(axis=0) + np.array(self._cell_mm)
        corner, end = self._least - half, self._most + half
        left, top = corner.tolist()
        wide, high = (end - corner).tolist()
        title = f"Under the hand: {self._texture.title}"
        return title, (left, top), (wide, high), partial(self._texture.draw, left, top)


USUAL_RATE_HZ = 100.0
FASTEST_HZ = 100.0
"""Highest pulse rate that people interpret correctly (paper, Sections III-B.3 and V)."""
SLOWEST_RATE_HZ = 10.0
JUMP_MM = 20.0
"""Largest motion between two frames, 2 m/s at 100 Hz. A larger change means that tracking was lost,
so the ridges between the two places cause no pulses."""
_EARLY = 1e-3
"""Relative tolerance of the shortest time between two pulses, because times are rounded to µs."""


class PulseLimit:
    """Limit of the pulse rate of each electrode, with a count of the omitted pulses."""

    def __init__(self, electrodes: int, fastest_hz: float) -> None:
        self._shortest_ns = int((1 - _EARLY) * 1e9 / fastest_hz)
        self._last_ns = np.full(electrodes, -(10**15), np.int64)
        self.left_out: int = 0

    def keep(self, wanted: NDArray[np.float32], time_ns: int) -> NDArray[np.float32]:
        """Return the pulses, (E,), with each pulse that comes too early set to zero."""
        active = wanted > 0
        due = active & (time_ns - self._last_ns >= self._shortest_ns)
        self._last_ns[due] = time_ns
        self.left_out += int(active.sum()) - int(due.sum())
        return wanted * due


class MouseSource(StimulusSource):
    """Source in which an electrode pulses when a ridge of the texture passes under it.

    The pulse rate of an electrode is the texture's spatial frequency times the hand's speed. The
    texture stays in place, and a hand at rest receives no pulses (paper, Section IV-C). The pose of
    a stimulus is the place of the array's center on the texture. Its image shows the texture under
    the array.
    """

    frames: int

    ended = "the hand has stopped"
    settings: Mapping[str, Any] = MappingProxyType({"scan": "points"})

    def __init__(
        self,
        texture: Texture,  # texture under the hand
        motion: HandMotion,  # reports the motion of the hand; the source closes it
        # Profile from `profile_for_reading`, so that images show exactly the area under the array.
        profile: Profile,
        mode: Mode = Mode.RA,  # class to stimulate: RA, SAI or PC
        rate_hz: float = USUAL_RATE_HZ,  # frames per second
        # Force of the virtual finger, if the motion reports no force. A real board needs a source
        # of the real force.
        press_n: float | None = None,
    ) -> None:
        super().__init__(f"{texture.title} under {motion.title}")
        if len(mode.afferents) != 1:
            message = f"mode {mode} stimulates more than one class: choose RA, SAI or PC"
            raise SourceError(message)
        words, most_hz = f"a rate of {rate_hz:g} frames a second", profile.limits.rate_hz
        require_within(SourceError, "rate_hz", rate_hz, SLOWEST_RATE_HZ, most_hz, words)
        # Largest pulse rate: the rate that people can interpret, or half the frame rate if lower.
        self.fastest_hz: float = min(FASTEST_HZ, rate_hz / 2)
        self.duration_s: float | None = motion.duration_s
        self.knows_force: bool = motion.knows_force or press_n is not None
        self.measures_force: bool = motion.measures_force
        self.texture: Texture = texture
        self.motion: HandMotion = motion
        self.pointer: PageMotion | None = motion if isinstance(motion, PageMotion) else None
        self.mode: Mode = mode
        self.merged: int = 0  # ridges without a pulse, because another passed in the same frame
        self._electrodes = len(profile.electrodes)
        self._limit = PulseLimit(self._electrodes, self.fastest_hz)
        self._afferent: Afferent = mode.afferents[0]
        self._period_us = round(1e6 / rate_hz)
        self._press_n = press_n
        self._steady = Deadband(motion.resolution_mm)
        self._feeler = texture.feeler(profile.electrodes.position_mm)
        self._pixel_mm = pixel_pitch_mm(profile)
        self._shape = (profile.optics.sensor_rows, profile.optics.sensor_columns)
        self._origin: tuple[float, float] | None = None
        self._place = (math.nan, math.nan)
        self._image = np.full(self._shape, 255, np.uint8)
        self._said = DeviceWarnings(self.notes)
        self._warned = False

    @property
    def sheet(self) -> Sheet | None:
        return None if self.pointer is None else self.pointer.sheet

    def read(self, time_ns: int) -> Stimulus | None:
        """Return the pulses at a time; None at the end of the motion."""
        moved = self.motion.read(time_ns)
        if moved is None:
            self._sum_up()
            return None
        if self._origin is None:
            self._origin = self.motion.origin_mm or self.texture.middle_mm
        x, y = self._steady.follow(*moved)
        position_mm = (self._origin[0] + x, self._origin[1] + y)
        activation = np.zeros((len(Afferent), self._electrodes), np.float32)
        if position_mm != self._place:
            activation[self._afferent] = self._pulses(position_mm, time_ns)
            self._draw_image(position_mm)
        force_n = self.motion.force_n if self.motion.knows_force else self._press_n
        return Stimulus(
            activation, time_ns, math.nan if force_n is None else force_n, self._period_us,
            pose=Pose(*position_mm), number=self.frames - 1, image=self._image,
        )  # fmt: skip

    def drawing(self, profile: Profile, bank: KernelBank) -> TexturePicture:
        """Return an empty drawing, to which a run with this source adds the responses."""
        return TexturePicture(profile, bank, (self._afferent,), self.texture)

    def close(self) -> None:
        """Close the motion, and add notes about omitted pulses and merged ridges."""
        self._sum_up()
        self.motion.close()
        for note in [*self.texture.notes, *self.motion.notes]:
            self._said.put(note, note)

    def _pulses(self, position_mm: tuple[float, float], time_ns: int) -> NDArray[np.float32]:
        before, self._place = self._place, position_mm
        # The distance is NaN for the first place.
        if not math.dist(position_mm, before) <= JUMP_MM:
            self._feeler.place(*position_mm)
            return np.zeros(self._electrodes, np.float32)
        passed = self._feeler.move(*position_mm)
        self.merged += passed.merged
        kept_pulses = self._limit.keep(passed.height, time_ns)
        if self._limit.left_out and not self._warned:
            self._warned = True
            self.emit(
                Note(
                    time_ns,
                    f"an electrode passes more than {self.fastest_hz:g} ridges per second, so "
                    "some pulses are left out: move more slowly",
                )
            )
        return kept_pulses

    def _draw_image(self, position_mm: tuple[float, float]) -> None:
        rows, columns = self._shape
        left = position_mm[0] - columns * self._pixel_mm / 2
        top = position_mm[1] - rows * self._pixel_mm / 2
        self._image = self.texture.draw(left, top, self._shape, self._pixel_mm)
        self.frames += 1

    def _sum_up(self) -> None:
        if self._limit.left_out:
            self._said.put(
                "left out",
                f"{self._limit.left_out} pulses were left out, because an electrode pulses at most "
                f"{self.fastest_hz:g} times a second: move more slowly, or raise rate_hz",
            )
        if self.merged:
            self._said.put(
                "merged",
                f"{self.merged} ridges caused no pulse, because another ridge passed the same "
                "electrode in the same frame: move more slowly",
            )


def open_motion_over(texture: Texture, url: str, profile: Profile, **options: Any) -> HandMotion:
    """Open a motion by its URL, with the options that depend on the texture or the profile. The URL
    ``page`` selects the pointer in the run's window."""
    if url == "page":
        return PageMotion(texture)
    kind = url.partition(":")[0]
    if kind == "sweep" and texture.size_mm is not None:
        options |= strokes_over(texture.size_mm, profile.electrodes.extent_mm)
    elif kind not in ("sweep", "path", "evdev"):
        options["profile"] = profile
    return open_motion(url, **options)


_MOTION = re.compile("[?&]motion=")


def open_texture_source(
    rest: str, profile: Profile, *, mode: Mode = Mode.RA, rate_hz: float | None = None
) -> MouseSource:
    """Open ``texture:WHAT?motion=URL``. WHAT is a texture as for `open_texture`.

    URL selects the motion of the hand; by default, a virtual hand sweeps over the texture. Give
    ``motion`` last, because URL can have options: ``grating:4mm?motion=sweep:3?speed_mm_s=20``.
    """
    what, *motions = _MOTION.split(rest, maxsplit=1)
    surface, reading = open_texture(what or "grating:4mm"), profile_for_reading(profile)
    moves = open_motion_over(surface, motions[0] if motions else "sweep:", profile)
    try:
        rate = USUAL_RATE_HZ if rate_hz is None else rate_hz
        force_n = reading_force_n(profile)
        return MouseSource(surface, moves, reading, mode, rate, press_n=force_n)
    except BaseException:
        moves.close()
        raise
