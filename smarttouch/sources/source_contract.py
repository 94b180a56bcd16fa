"""Base classes of sources, their stimuli and warnings, and checks of the inputs they return."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import SourceError, kind_in_words
from smarttouch.base.events import Advice, Emit
from smarttouch.base.stopping import Closing
from smarttouch.base.tactile_image import Frame as Frame
from smarttouch.base.tactile_image import Pose as Pose
from smarttouch.base.tactile_image import TactileImage
from smarttouch.imaging.grey_image import GreyConverter
from smarttouch.pages.page_and_lines import Page
from smarttouch.profile import Profile
from smarttouch.profile.electrodes import ElectrodeArray


@dataclass(frozen=True, eq=False, repr=False)
class Stimulus(TactileImage):
    """Tactile image delivered by a source.

    Attributes
    ----------
    activation, time_ns, force_n, level
        See `TactileImage`; the force is NaN if unknown.
    pose, number, age_ns, stale, period_us
        See `Frame`. Stimuli with equal numbers come from the same part of the source.
    image : ndarray, (H, W) uint8, optional
        Gray levels under the finger, for display.
    """

    pose: Pose = field(default=Pose(0.0, 0.0))
    number: int = 0
    age_ns: int = 0
    stale: bool = False
    image: NDArray[np.uint8] | None = None


Input = Frame | Stimulus  # a run reads one input from its source for each sequence


class Device(Closing):
    """Base class of `Source` and `ForceSource`, with notes for the user.

    Parameters
    ----------
    title : str
        Short name.

    Attributes
    ----------
    url : str
        URL by which the source was opened, or "".
    notes : list of str
        Warnings for the user, one sentence each.
    """

    def __init__(self, title: str) -> None:
        self.title = title
        self.url = ""
        self.notes: list[str] = []

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.url or self.title!r})"


class DeviceWarnings:
    """List of warnings in which a new warning replaces an earlier one with the same cause."""

    def __init__(self, notes: list[str]) -> None:
        self._notes = notes
        self._places: dict[str, int] = {}

    def put(self, cause: str, sentence: str) -> None:
        """Add or replace the warning for a cause."""
        if cause in self._places:
            self._notes[self._places[cause]] = sentence
        else:
            self._notes.append(sentence)
            self._places[cause] = len(self._notes) - 1


@dataclass(frozen=True, eq=False)
class Sheet:
    """Page or line under the finger, with its position in the coordinates of `Pose`.

    ``number`` changes with the page or line; ``corner_mm`` is the sheet's top left corner.
    """

    number: int
    page: Page
    corner_mm: tuple[float, float] = (0.0, 0.0)


class Pointer(Protocol):
    """Part of a source that follows the mouse pointer over the `Source.sheet` in a window."""

    is_shown: bool

    def move(self, x_mm: float, y_mm: float) -> None:
        """Move to a position on the sheet. Raises ValueError outside of the sheet."""


class Source(Device, ABC):
    """Base class of all sources. After a run, ``frames`` must equal ``dropped_frames`` plus the
    number of different inputs that were read."""

    duration_s: float | None = None
    """Duration of the source, s; None if the source is endless."""
    ended: ClassVar[str] = "the source has ended"
    """Message of a run that ends because the source has ended."""
    emit: Emit = staticmethod(lambda _event: None)
    """Function that receives events of the source; set by the run."""
    afferents: tuple[Afferent, ...] = tuple(Afferent)
    """Classes that the next input may stimulate; set by the run."""
    knows_force: bool = False
    """Whether inputs contain the finger force."""
    measures_force: bool = False
    """Whether the force in inputs is measured on a finger during the run. Otherwise, the
    force is used only on boards that no finger can touch."""
    frames: int = 0
    """Number of different frames or stimuli so far, including dropped ones."""
    dropped_frames: int = 0
    """Number of frames or stimuli that were never read."""
    pointer: Pointer | None = None
    """Part of the source that follows the mouse pointer in a window; None if there is none."""
    fixed_mode: ClassVar[bool] = False
    """Whether the source, instead of the user, chooses the classes to stimulate."""
    notes_told: int = 0
    """Number of `notes` already reported."""
    settings: Mapping[str, Any] = MappingProxyType({})
    """Default settings of `RunConfig` for this source."""
    keys_help: ClassVar[str] = ""
    """Help text for `keys`."""

    @property
    def sheet(self) -> Sheet | None:
        """Return the page or line under the finger, if known. Any thread may read it."""
        return None

    @property
    def words(self) -> str:
        """Return the text under the finger; empty if unknown."""
        return ""

    @property
    def account(self) -> str:
        """Return a summary of the run in words, for users who cannot see the run. Return "" if
        the source has no summary."""
        return ""

    def tell_notes(self, time_ns: int) -> None:
        """Emit an event for each of `notes` that has not been reported yet."""
        for words in self.notes[self.notes_told :]:
            self.emit(Advice(time_ns, words))
            self.notes_told += 1

    def narrowed(self, profile: Profile) -> Profile:
        """Return ``profile``, or a copy with stricter limits for this source."""
        return profile

    @property
    def keys(self) -> Mapping[str, Callable[[], None]]:
        """Functions to call when a key is pressed, by key; any thread may call them."""
        return {}

    @abstractmethod
    def read(self, time_ns: int) -> Input | None:
        """Return the input at ``time_ns`` since the start of the run; None at the end."""


class OpticalSource(Source):
    """Base class of sources of frames, which imaging converts to tactile images."""

    @abstractmethod
    def read(self, time_ns: int) -> Frame | None:
        """Return the frame at ``time_ns`` since the start of the run; None at the end."""


class StimulusSource(Source):
    """Base class of sources of stimuli. The source, not the user, chooses the afferent classes."""

    fixed_mode = True

    @abstractmethod
    def read(self, time_ns: int) -> Stimulus | None:
        """Return the stimulus at ``time_ns`` since the start of the run; None at the end."""


def checked_input(given: Any, who: object, electrodes: int) -> Input:
    """Return the frame or stimulus ``given`` by the source ``who``, with valid array types.

    Raises SourceError if ``given`` is invalid or of another type.
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
    """Convert a bool, gray, RGB or RGBA image to gray levels, (H, W) uint8, 0 is black.

    Transparent images get a background on which they are visible. Raises SourceError for images of
    other types and shapes, because it is unknown which of their values is white.
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
    return GreyConverter().convert(image)


def checked_activation(activation: Any, who: object, electrodes: int) -> NDArray[np.float32]:
    """Return an activation as (3, E) float32. Raises SourceError if the shape differs, or if a
    number is outside of [0, 1]."""
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


Given = Source | str | Path | NDArray[np.uint8] | Iterable[Any]  # accepted by `source_of`


class Images(OpticalSource):
    """Source of images that a Python program supplies. Each read returns the next image. If an
    image is not a `Frame`, the force that gives full intensity is assumed."""

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
"""Function that converts a frame to activation, (3, E) in [0, 1]."""


_OF_THE_SOURCE = (
    "url", "duration_s", "knows_force", "measures_force", "narrowed",
)  # fmt: skip


class OwnImaging(StimulusSource):
    """Source of stimuli that a user's function computes from frames. A stimulus keeps the image
    of its frame, so that recordings contain the image."""

    def __init__(self, source: Source, imaging: Imaging, profile: Profile) -> None:
        super().__init__(source.title)
        for name in _OF_THE_SOURCE:
            setattr(self, name, getattr(source, name))
        self._source, self._imaging, self._electrodes = source, imaging, profile.electrodes
        self._who = getattr(imaging, "__qualname__", type(imaging).__name__)

    def read(self, time_ns: int) -> Stimulus | None:
        """Return the stimulus that the function computes from the next frame; None at the end."""
        source_frame = self._source.read(time_ns)
        self._count()
        if source_frame is None:
            return None
        electrodes = len(self._electrodes)
        frame = checked_input(source_frame, self._source, electrodes)
        if not isinstance(frame, Frame):
            raise SourceError(
                f"{self.title} delivers stimuli, not frames: leave out the imaging function"
            )
        activation = self._imaging(frame, self._electrodes)
        return Stimulus(
            checked_activation(activation, self._who, electrodes), frame.time_ns, frame.force_n,
            pose=frame.pose, number=frame.number, age_ns=frame.age_ns, stale=frame.stale,
            image=frame.image, period_us=frame.period_us,
        )  # fmt: skip

    @property
    def keys(self) -> Mapping[str, Callable[[], None]]:
        """Functions of the frames' source, by key. Each is called when its key is pressed."""
        return self._source.keys

    @property
    def emit(self) -> Emit:
        """Function that receives events of the source of frames."""
        return self._source.emit

    @emit.setter
    def emit(self, emit: Emit) -> None:
        self._source.emit = emit

    def close(self) -> None:
        """Close the source of frames, and copy its notes."""
        self._source.close()
        self._count()
        self.notes: list[str] = self._source.notes

    def _count(self) -> None:
        self.frames: int = self._source.frames
        self.dropped_frames: int = self._source.dropped_frames
