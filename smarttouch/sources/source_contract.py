"""Contract of sources: frames, stimuli, poses and warnings."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import SourceError, kind_in_words
from smarttouch.base.events import Advice, Emit
from smarttouch.base.stopping import Closing
from smarttouch.base.tactile_image import TactileImage, one_line
from smarttouch.pages.grey_image import to_grey
from smarttouch.pages.page_image import Page
from smarttouch.profile import Profile
from smarttouch.profile.electrodes import ElectrodeArray


@dataclass(frozen=True)
class Pose:
    """Position of the sensor patch's center on the page.

    ``x_mm`` runs right and ``y_mm`` down from the page's top left corner;
    ``angle_rad`` turns the patch clockwise as seen on the page.
    """

    x_mm: float
    y_mm: float
    angle_rad: float = 0.0


@dataclass(frozen=True, eq=False)
class Frame:
    """One image of an optical source.

    Attributes
    ----------
    image : ndarray, (H, W) uint8
        Grey levels, bright is white.
    time_ns : int
        Requested time, since the start of the run.
    pose : Pose
        Pose of the sensor.
    force_n : float, N
        Force of the finger; NaN if unknown.
    number : int
        Of the image at its source, from 0; the same number is the same image again.
    age_ns : int
        Age of the image when it was read.
    stale : bool
        Whether the source has gone silent and the image may be outdated.
    period_us : int, µs, optional
        Time to the next read, in which every active class pulses once. None: the mode's classes
        pulse at the profile's rates.
    """

    __repr__ = one_line

    image: NDArray[np.uint8]
    time_ns: int
    pose: Pose = Pose(0.0, 0.0)
    force_n: float = math.nan
    number: int = 0
    age_ns: int = 0
    stale: bool = False
    period_us: int | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Stimulus(TactileImage):
    """Tactile image of a source, with an optional period of its own: see `TactileImage`.

    Attributes
    ----------
    activation, time_ns, force_n, level
        See `TactileImage`; the force is NaN if unknown.
    pose, number, age_ns, stale, period_us
        See `Frame`; equal numbers mean the same place or part.
    image : ndarray, (H, W) uint8, optional
        Grey levels under the finger, for display.
    """

    pose: Pose = Pose(0.0, 0.0)
    number: int = 0
    age_ns: int = 0
    stale: bool = False
    image: NDArray[np.uint8] | None = None


Input = Frame | Stimulus  # input of a run, read once for each sequence


class Device(Closing):
    """Base of sources that are opened by URL, closed, and have notes for the user.

    Parameters
    ----------
    title : str
        Name in a few words.

    Attributes
    ----------
    url : str
        URL by which it was opened.
    notes : list of str
        Warnings after a run, a sentence each.
    """

    def __init__(self, title: str) -> None:
        self.title = title
        self.url = ""
        self.notes: list[str] = []

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.url or self.title!r})"


class DeviceWarnings:
    """Warnings that are updated instead of being repeated, in a list to which others may append."""

    def __init__(self, notes: list[str]) -> None:
        self._notes = notes
        self._places: dict[str, int] = {}

    def put(self, cause: str, sentence: str) -> None:
        """Set the warning of a cause, in the place of the earlier one."""
        if cause in self._places:
            self._notes[self._places[cause]] = sentence
        else:
            self._notes.append(sentence)
            self._places[cause] = len(self._notes) - 1


@dataclass(frozen=True, eq=False)
class Sheet:
    """A page or a line that lies under the finger: its picture, and where it is for poses.

    ``number`` changes with the picture; ``corner_mm`` is the place of its top left corner.
    """

    number: int
    page: Page
    corner_mm: tuple[float, float] = (0.0, 0.0)


class Pointer(Protocol):
    """Part of a source that the pointer over the `sheet` moves, once a window shows it."""

    is_shown: bool

    def move(self, x_mm: float, y_mm: float) -> None:
        """Move to a place on the sheet; ValueError outside of it."""


class Source(Device, ABC):
    """Base of all sources.

    Everything that a source delivers is either read or dropped: at the end ``frames``
    is the number of distinct inputs read plus ``dropped_frames``.
    """

    duration_s: float | None = None
    """Duration; None if it never ends by itself."""
    ended: ClassVar[str] = "the source has ended"
    """Message at its end."""
    emit: Emit = staticmethod(lambda _event: None)
    """Receives events of the source; set by the run."""
    afferents: tuple[Afferent, ...] = tuple(Afferent)
    """Classes that the next input may drive; set by the run."""
    knows_force: bool = False
    """Whether its inputs have a force."""
    measures_force: bool = False
    """Whether that force is measured on a finger during the run. Any other force counts only on
    boards that no finger can touch."""
    frames: int = 0
    """Distinct frames or stimuli that it delivered."""
    dropped_frames: int = 0
    """Frames or stimuli that arrived but were never read."""
    pointer: Pointer | None = None
    """What the pointer over a page of the window moves, if anything."""
    fixed_mode: ClassVar[bool] = False
    """Whether it chooses the classes that it drives, so that the user cannot."""
    notes_told: int = 0
    """Number of its `notes` that were reported as they arose."""
    settings: Mapping[str, Any] = MappingProxyType({})
    """Settings of a run that suit it, as `RunConfig` names them, where no others are asked for."""
    keys_help: ClassVar[str] = ""
    """Help text for its keys."""

    @property
    def sheet(self) -> Sheet | None:
        """Return what lies under the finger, if that is known; from any thread."""
        return None

    @property
    def words(self) -> str:
        """Return the text that is read, if it is known."""
        return ""

    @property
    def account(self) -> str:
        """Return in words what it has delivered, for users who cannot see it; empty if unknown."""
        return ""

    def tell_notes(self, time_ns: int) -> None:
        """Report the notes that have come up since the last call."""
        for words in self.notes[self.notes_told :]:
            self.emit(Advice(time_ns, words))
            self.notes_told += 1

    def narrowed(self, profile: Profile) -> Profile:
        """Return the profile used to plan this source's stimulation; never with wider limits."""
        return profile

    @property
    def keys(self) -> Mapping[str, Callable[[], None]]:
        """Functions of single keys, callable from any thread; none if it has no controls."""
        return {}

    @abstractmethod
    def read(self, time_ns: int) -> Input | None:
        """Return the input at ``time_ns`` since the start; None at the end."""


class OpticalSource(Source):
    """Source of frames, which imaging turns into tactile images."""

    @abstractmethod
    def read(self, time_ns: int) -> Frame | None:
        """Return the frame at ``time_ns`` since the start; None at the end."""


class StimulusSource(Source):
    """Source of stimuli, which also chooses the classes that they drive."""

    fixed_mode = True

    @abstractmethod
    def read(self, time_ns: int) -> Stimulus | None:
        """Return the stimulus at ``time_ns`` since the start; None at the end."""


def checked_input(given: Any, who: object, electrodes: int) -> Input:
    """Return a frame or stimulus that a source ``who`` returned, for (E,) electrodes.

    Raises a SourceError for anything else, with what it is.
    """
    if isinstance(given, Frame):
        image = given.image
        if type(image) is np.ndarray and image.dtype == np.uint8 and image.ndim == 2 and image.size:
            return given
        return replace(given, image=gray_image(image, who))
    if not isinstance(given, Stimulus):
        raise SourceError(
            f"{who} returned {kind_in_words(given)}: a source returns a Frame or a Stimulus, or "
            "None at its end"
        )
    return replace(given, activation=checked_activation(given.activation, who, electrodes))


def gray_image(image: Any, who: object) -> NDArray[np.uint8]:
    """Return an image as gray levels, (H, W) uint8, 0 black: from bool, gray, RGB or RGBA.

    The ground under transparent print is chosen so that it is seen. Raises a SourceError for other
    types and shapes: which number is white would be a guess.
    """
    if not (
        isinstance(image, np.ndarray)
        and image.dtype in (np.uint8, np.bool_)
        and image.size
        and (image.ndim == 2 or (image.ndim == 3 and image.shape[2] in (1, 3, 4)))
    ):
        raise SourceError(
            f"{who} gave an image that is {kind_in_words(image)}: give gray levels (H, W) uint8, "
            "0 black and 255 white, or RGB (H, W, 3)"
        )
    return to_grey(image)


def checked_activation(activation: Any, who: object, electrodes: int) -> NDArray[np.float32]:
    """Return the activation of (3, E) electrodes as float32, of numbers in [0, 1] alone."""
    shape = len(Afferent), electrodes
    if (
        not isinstance(activation, np.ndarray)
        or activation.dtype.kind not in "fbiu"
        or activation.shape != shape
    ):
        raise SourceError(
            f"{who} gave an activation that is {kind_in_words(activation)}: give an array "
            f"of {shape}, in [0, 1], a row for each of RA, SAI and PC"
        )
    # Reject NaN: every comparison with it is false.
    lowest, highest = float(activation.min()), float(activation.max())
    if not 0 <= lowest <= highest <= 1:
        raise SourceError(
            f"{who} gave an activation from {lowest:g} to {highest:g}: it must be in [0, 1]"
        )
    return activation if activation.dtype == np.float32 else activation.astype(np.float32)


Given = Source | str | Path | NDArray[np.uint8] | Iterable[Any]  # what a source can be made of


class Images(OpticalSource):
    """Images one after another, one for each sequence; at the finger's full force."""

    frames: int
    knows_force = True
    ended = "all images have been shown"

    def __init__(self, images: Iterable[Any], profile: Profile) -> None:
        super().__init__("images")
        self._images: Iterator[Any] = iter(images)
        self._press_n = profile.force.full_n

    def read(self, time_ns: int) -> Frame | None:
        """Return the next image; None after the last."""
        image = next(self._images, None)
        if image is None:
            return None
        self.frames += 1
        if isinstance(image, Frame):
            return replace(image, time_ns=time_ns, number=self.frames - 1)
        gray = gray_image(image, self.title)
        return Frame(gray, time_ns, force_n=self._press_n, number=self.frames - 1)


Imaging = Callable[[Frame, ElectrodeArray], NDArray[np.floating[Any]]]
"""Returns the activation of each class at each electrode, (3, E) in [0, 1], of a frame."""


_OF_THE_SOURCE = (
    "url", "duration_s", "knows_force", "measures_force", "narrowed",
)  # fmt: skip


class OwnImaging(StimulusSource):
    """Stimuli that a function makes of an optical source's frames; recordings keep both."""

    def __init__(self, source: Source, imaging: Imaging, profile: Profile) -> None:
        super().__init__(source.title)
        for name in _OF_THE_SOURCE:
            setattr(self, name, getattr(source, name))
        self._source, self._imaging, self._electrodes = source, imaging, profile.electrodes
        self._who = getattr(imaging, "__qualname__", type(imaging).__name__)

    def read(self, time_ns: int) -> Stimulus | None:
        """Return what the function makes of the next frame; None at the end."""
        source_frame = self._source.read(time_ns)
        self._count()
        if source_frame is None:
            return None
        electrodes = len(self._electrodes)
        frame = checked_input(source_frame, self._source, electrodes)
        if not isinstance(frame, Frame):
            raise SourceError(
                f"{self.title} gives tactile images, which need no imaging: leave it out"
            )
        activation = self._imaging(frame, self._electrodes)
        return Stimulus(
            checked_activation(activation, self._who, electrodes), frame.time_ns, frame.force_n,
            pose=frame.pose, number=frame.number, age_ns=frame.age_ns, stale=frame.stale,
            image=frame.image, period_us=frame.period_us,
        )  # fmt: skip

    @property
    def keys(self) -> Mapping[str, Callable[[], None]]:
        """Keys of the source."""
        return self._source.keys

    @property
    def emit(self) -> Emit:
        """Receives the source's events."""
        return self._source.emit

    @emit.setter
    def emit(self, emit: Emit) -> None:
        self._source.emit = emit

    def close(self) -> None:
        """Close the source."""
        self._source.close()
        self._count()
        self.notes: list[str] = self._source.notes

    def _count(self) -> None:
        self.frames: int = self._source.frames
        self.dropped_frames: int = self._source.dropped_frames
