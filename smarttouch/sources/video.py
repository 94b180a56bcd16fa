"""Videos and folders of images, at their own pace or as fast as they are read."""

import math
import os
import re
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from smarttouch.base.errors import PageError, SourceError, require_within
from smarttouch.base.files import MOST_DOCUMENT_BYTES, require_file
from smarttouch.pages.grey_image import GreyConverter, read_pixels
from smarttouch.pages.page_image import open_image
from smarttouch.profile import Profile
from smarttouch.sources.camera import silence_opencv
from smarttouch.sources.preprocess import FramePreprocessor
from smarttouch.sources.source_contract import Frame, OpticalSource

USUAL_HZ = 30.0
FASTEST_HZ = 1000.0
SUFFIXES = (
    ".avif", ".bmp", ".gif", ".jp2", ".jpeg", ".jpg", ".pbm", ".pgm", ".png", ".ppm", ".tif",
    ".tiff", ".webp",
)  # fmt: skip
_FEWEST_PIXELS = 2
_MOST_PIXELS = 80_000_000
MOST_DECODED = 8  # images behind the one that is due from which they are skipped undecoded
_MISSING = 0.05  # accepted part of missing frames; containers only estimate how many they hold
_TEXT = cv2.VideoWriter.fourcc(*"ansi")
# Silences the decoder's messages on damaged frames; read once, when a process first opens a video.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
# Without playlists, which could open other files, pipes and addresses.
os.environ.setdefault(
    "OPENCV_FFMPEG_CAPTURE_OPTIONS",
    "protocol_whitelist;file|format_whitelist;3gp,asf,avi,flv,gif,h264,hevc,ivf,m4v,matroska,mjpeg,"
    "mov,mp4,mpeg,mpegts,mpegvideo,mxf,nut,ogg,webm,yuv4mpegpipe",
)


class Clip(ABC):
    """Sequence of images, to be read once."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.title: str = path.name or str(path)
        self.rate_hz: float = USUAL_HZ
        self.count = 0  # number of images; 0 if not known. A video's count is often an estimate
        self.notes: list[str] = []

    @abstractmethod
    def open(self) -> None:
        """Open the clip; raise SourceError if that fails."""

    @abstractmethod
    def next(self) -> NDArray[np.uint8] | None:
        """Return the next image, grey, (H, W); None at the end."""

    @abstractmethod
    def skip(self) -> bool:
        """Skip the next image; return False at the end."""

    @abstractmethod
    def close(self) -> None:
        """Close the clip."""


class VideoFile(Clip):
    """A video, through OpenCV."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._capture = cv2.VideoCapture()
        self._first: NDArray[np.uint8] | None = None
        self._converter = GreyConverter()
        self._read = 0

    def open(self) -> None:
        _require_file(self.path)
        silence_opencv()
        self._capture.open(str(self.path))
        # Any text is a video to some decoders.
        text = int(self._capture.get(cv2.CAP_PROP_FOURCC)) == _TEXT
        if not self._capture.isOpened() or text:
            self.close()
            message = f"{self.path} is not a readable video: give an MP4, AVI, MKV or MOV"
            raise SourceError(message)
        rate_hz = self._capture.get(cv2.CAP_PROP_FPS)
        if 0 < rate_hz <= FASTEST_HZ:
            self.rate_hz = rate_hz
        else:
            self.notes.append(
                f"{self.title} does not state its frame rate: {USUAL_HZ:g} Hz is assumed"
            )
        count = self._capture.get(cv2.CAP_PROP_FRAME_COUNT)
        self.count: int = int(count) if 0 < count < 1e9 else 0
        self._first = self.next()
        if self._first is None or min(self._first.shape) < _FEWEST_PIXELS:
            self.close()
            raise SourceError(f"{self.path} has no readable frame: record it again")

    def next(self) -> NDArray[np.uint8] | None:
        if self._first is not None:
            image, self._first = self._first, None
            return image
        color = self._captured(decoded=True)
        return None if color is None else self._converter.convert(color[:, :, ::-1])

    def skip(self) -> bool:
        if self._first is not None:
            self._first = None
            return True
        return self._captured(decoded=False) is not None

    def _captured(self, decoded: bool) -> Any:
        """Return the next frame in color, or True where none is decoded; None at the end."""
        try:
            found = self._capture.read()[1] if decoded else self._capture.grab() or None
        except cv2.error:
            found = None
        self._read += found is not None
        note = f"{self.title} breaks off: {self._read} of its {self.count} frames could be read"
        missing = self.count - self._read > max(1, _MISSING * self.count)
        if found is None and missing and note not in self.notes:
            self.notes.append(note)
        return found

    def close(self) -> None:
        self._capture.release()


class ImageFolder(Clip):
    """A folder of images of one size, in natural order of their names."""

    def __init__(self, path: Path, rate_hz: float) -> None:
        super().__init__(path)
        self.rate_hz = rate_hz
        self._files: list[Path] = []
        self._shape: tuple[int, ...] = ()
        self._converter = GreyConverter()
        self._index = 0

    def open(self) -> None:
        self._files = _images(self.path)
        self.count: int = len(self._files)
        self._shape = _load(self._files[0], self._converter).shape
        for file in self._files[1:]:
            with _reading(file) as image:
                width, height = image.size
            # Some formats state at their end how they lie, so either way is possible here.
            if sorted((width, height)) != sorted(self._shape):
                raise self._other_size(file, width, height)

    def _other_size(self, file: Path, width: int, height: int) -> SourceError:
        return SourceError(
            f"{file} has {width} x {height} pixels, {self._files[0].name} has "
            f"{self._shape[1]} x {self._shape[0]}: all images of a folder must be of one size"
        )

    def next(self) -> NDArray[np.uint8] | None:
        if self._index == len(self._files):
            return None
        file = self._files[self._index]
        self._index += 1
        image = _load(file, self._converter)
        if image.shape != self._shape:
            raise self._other_size(file, image.shape[1], image.shape[0])
        return image

    def skip(self) -> bool:
        if self._index == len(self._files):
            return False
        self._index += 1
        return True

    def close(self) -> None:
        """Do nothing: each image is read whole."""


def _require_file(path: Path) -> None:
    if path.is_dir():
        raise SourceError(f"{path} is a folder: give a video file, or frames:{path}")
    require_file(path, SourceError, MOST_DOCUMENT_BYTES)


def _images(folder: Path) -> list[Path]:
    """Return the images of a folder, 2.png before 10.png."""
    if folder.is_file():
        raise SourceError(f"{folder} is a file: give a folder of images, or video:{folder}")
    try:
        files = [
            file
            for file in folder.iterdir()
            if file.suffix.lower() in SUFFIXES and not file.name.startswith(".")
        ]
    except FileNotFoundError:
        raise SourceError(f"no folder {folder}: check its name") from None
    except OSError as error:
        message = f"cannot read the folder {folder}: {error.strerror}"
        raise SourceError(message) from None
    if not files:
        message = f"{folder} contains no images: give PNG, JPEG, TIFF, WebP or BMP files"
        raise SourceError(message)
    return sorted(files, key=_natural)


def _natural(file: Path) -> list[tuple[int, int, str]]:
    parts = re.findall(r"([0-9]+)|([^0-9]+)", file.name)
    # Names that differ in leading zeros alone still have one order.
    return [(0, int(digits), "") if digits else (1, 0, text) for digits, text in parts] + [
        (2, 0, file.name)
    ]


@contextmanager
def _reading(file: Path) -> Iterator[Image.Image]:
    try:
        with open_image(file) as image:
            yield image
    except PageError as error:
        raise SourceError(f"{error}; remove it from the folder") from None


def _load(file: Path, converter: GreyConverter) -> NDArray[np.uint8]:
    with _reading(file) as image:
        _require_pixels(file, *image.size)
        return converter.convert(read_pixels(image))


def _require_pixels(file: Path, width: int, height: int) -> None:
    if min(width, height) < _FEWEST_PIXELS or width * height > _MOST_PIXELS:
        raise SourceError(
            f"{file} has {width} x {height} pixels: a frame needs at least {_FEWEST_PIXELS} x "
            f"{_FEWEST_PIXELS}, and at most {_MOST_PIXELS // 10**6} megapixels"
        )


def open_video(rest: str, profile: Profile, *, unpaced: bool = False) -> OpticalSource:
    """Open ``video:FILE``, any video that OpenCV reads; ``unpaced`` gives one frame a read."""
    return ClipSource(VideoFile(Path(rest)), profile, unpaced)


def open_frames(
    rest: str, profile: Profile, *, fps: float | None = None, unpaced: bool = False
) -> OpticalSource:
    """Open ``frames:DIR``, a folder of images of one size, in natural order of their names.

    ``fps`` is 30 if not given; ``unpaced`` gives one image a read.
    """
    rate_hz = USUAL_HZ if fps is None else fps
    words = f"a rate of {rate_hz:g} images a second"
    require_within(SourceError, "fps", rate_hz, 0, FASTEST_HZ, words, above=True)
    return ClipSource(ImageFolder(Path(rest), rate_hz), profile, unpaced)


class ClipSource(OpticalSource):
    """Shows the image of a clip that is due at the time of the read, or the next at each read.

    Images in between are decoded as well, so that motion is followed, but for those that are far
    behind; all of them count as dropped.
    """

    ended = "end of the clip"

    def __init__(self, clip: Clip, profile: Profile, unpaced: bool) -> None:
        super().__init__(clip.title)
        self._clip, self._unpaced = clip, unpaced
        self._intake = FramePreprocessor(profile)
        self._frame: Frame | None = None
        self._is_unread = self._is_over = False
        self.notes: list[str] = clip.notes
        clip.open()
        if clip.count and not unpaced:
            self.duration_s = clip.count / clip.rate_hz

    def read(self, time_ns: int) -> Frame | None:
        """Return the frame at a time since the start; None at the end."""
        due = self.frames if self._unpaced else int(time_ns * self._clip.rate_hz / 1e9)
        while self.frames <= due and not self._is_over:
            self._take(far_behind=due - self.frames >= MOST_DECODED)
        if self._frame is None or (self._is_over and not self._is_unread):
            return None
        self._is_unread = False
        taken_ns = round(self._frame.number * 1e9 / self._clip.rate_hz)
        age_ns = 0 if self._unpaced else max(0, time_ns - taken_ns)
        return replace(self._frame, time_ns=time_ns, age_ns=age_ns)

    def _take(self, far_behind: bool) -> None:
        """Take the next image, or skip it undecoded."""
        image = None if far_behind else self._clip.next()
        if image is None and not (far_behind and self._clip.skip()):
            self._is_over = True
            return
        self.dropped_frames += self._is_unread
        self._is_unread = image is not None
        if image is None:
            self.dropped_frames += 1
        else:
            image, pose = self._intake.take(image)
            self._frame = Frame(image, 0, pose, math.nan, number=self.frames)
        self.frames += 1

    def close(self) -> None:
        """Close the file, and count an unread frame as dropped."""
        self.dropped_frames += self._is_unread
        self._is_unread = False
        self._is_over = True
        self._clip.close()
