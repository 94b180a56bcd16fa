"""Videos and image folders as sources. A read returns the image that is due at this
time, or, if ``unpaced``, the next image."""

import contextlib
import itertools
import math
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
from numpy.typing import NDArray

from smarttouch.base.errors import PageError, SourceError, require_within
from smarttouch.base.files import MOST_DOCUMENT_BYTES, require_file
from smarttouch.imaging.grey_image import GreyConverter, open_image, read_pixels
from smarttouch.profile import Profile
from smarttouch.sources.camera import silence_opencv
from smarttouch.sources.flat_field_and_motion import FramePreprocessor
from smarttouch.sources.source_contract import Frame, OpticalSource

USUAL_HZ = 30.0
FASTEST_HZ = 1000.0
SUFFIXES = (
    ".avif", ".bmp", ".gif", ".jp2", ".jpeg", ".jpg", ".pbm", ".pgm", ".png", ".ppm", ".tif",
    ".tiff", ".webp",
)  # fmt: skip
_FEWEST_PIXELS = 2
_MOST_PIXELS = 80_000_000
MOST_DECODED = 8  # an image that is late by at least this number of images is not decoded
_MISSING = 0.05  # accepted share of missing frames, because counts in files are inexact
_TEXT = cv2.VideoWriter.fourcc(*"ansi")
# Suppress messages of FFmpeg, which reads this variable when the process opens its first video.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
# Exclude playlists, because they could open other files, pipes and addresses.
os.environ.setdefault(
    "OPENCV_FFMPEG_CAPTURE_OPTIONS",
    "protocol_whitelist;file|format_whitelist;3gp,asf,avi,flv,gif,h264,hevc,ivf,m4v,matroska,mjpeg,"
    "mov,mp4,mpeg,mpegts,mpegvideo,mxf,nut,ogg,webm,yuv4mpegpipe",
)


Image = NDArray[np.uint8]  # gray, (H, W)


@dataclass
class Clip:
    """Sequence of images that can be read once.

    Each item of ``images`` is a function that decodes an image, or returns None if it is damaged.
    ``count`` is the number of images, often an estimate for videos; 0 if unknown.
    """

    title: str
    rate_hz: float
    count: int
    images: Iterator[Callable[[], Image | None]]
    notes: list[str] = field(default_factory=list)
    close: Callable[[], None] = lambda: None


def video_clip(path: Path) -> Clip:
    """Open a video with OpenCV."""
    _require_file(path)
    silence_opencv()
    capture = cv2.VideoCapture(str(path))
    # Some decoders accept any text as a video.
    if not capture.isOpened() or int(capture.get(cv2.CAP_PROP_FOURCC)) == _TEXT:
        capture.release()
        message = f"{path} is not a readable video: give an MP4, AVI, MKV or MOV"
        raise SourceError(message)
    count, rate_hz = capture.get(cv2.CAP_PROP_FRAME_COUNT), capture.get(cv2.CAP_PROP_FPS)
    clip = Clip(path.name, rate_hz, int(count) if 0 < count < 1e9 else 0, iter(()))
    clip.close = capture.release
    if not 0 < rate_hz <= FASTEST_HZ:
        clip.rate_hz = USUAL_HZ
        clip.notes.append(f"{path.name} does not state its frame rate: assuming {USUAL_HZ:g} Hz")
    images = _grabbed(capture, clip)
    first = next(images, lambda: None)()
    if first is None or min(first.shape) < _FEWEST_PIXELS:
        capture.release()
        raise SourceError(f"{path} has no readable frame: record it again")
    clip.images = itertools.chain([lambda: first], images)
    return clip


def _grabbed(capture: cv2.VideoCapture, clip: Clip) -> Iterator[Callable[[], Image | None]]:
    """Yield a decoding function for each image of a video; add a note if the video ends early."""
    converter, read = GreyConverter(), 0

    def decode() -> Image | None:
        with contextlib.suppress(cv2.error):
            is_decoded, color = capture.retrieve()
            if is_decoded:
                return converter.convert(cv2.cvtColor(color, cv2.COLOR_BGR2RGB))
        return None

    with contextlib.suppress(cv2.error):
        while capture.grab():
            read += 1
            yield decode
    if clip.count - read > max(1, _MISSING * clip.count):
        clip.notes.append(
            f"{clip.title} ends early: only {read} of its {clip.count} frames could be read"
        )


def folder_clip(path: Path, rate_hz: float) -> Clip:
    """Open a folder of images of one size, in natural order of names."""
    files, converter = _images(path), GreyConverter()
    shape = _load(files[0], converter).shape

    def load(file: Path) -> Image:
        image = _load(file, converter)
        if image.shape != shape:
            raise SourceError(
                f"{file} has {image.shape[1]} x {image.shape[0]} pixels, but {files[0].name} has "
                f"{shape[1]} x {shape[0]}: all images of a folder must have one size"
            )
        return image

    return Clip(path.name, rate_hz, len(files), (partial(load, file) for file in files))


def _require_file(path: Path) -> None:
    if path.is_dir():
        raise SourceError(f"{path} is a folder: give a video file, or frames:{path}")
    require_file(path, SourceError, MOST_DOCUMENT_BYTES)


def _images(folder: Path) -> list[Path]:
    """Return the images of a folder in natural order: 2.png before 10.png."""
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
    # Sort names that differ only in leading zeros by the complete name.
    return [(0, int(digits), "") if digits else (1, 0, text) for digits, text in parts] + [
        (2, 0, file.name)
    ]


@contextmanager
def _reading(file: Path) -> Iterator[PIL.Image.Image]:
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
    """Open ``video:FILE``, a video that OpenCV can read. With ``unpaced``, each read returns the
    next image instead of the one that is due."""
    return ClipSource(video_clip(Path(rest)), profile, unpaced)


def open_frames(
    rest: str, profile: Profile, *, fps: float | None = None, unpaced: bool = False
) -> OpticalSource:
    """Open ``frames:DIR``, a folder of images of one size, in natural order of their names.

    ``fps`` defaults to 30. With ``unpaced``, each read returns the next image instead of the one
    that is due."""
    rate_hz = USUAL_HZ if fps is None else fps
    words = f"a rate of {rate_hz:g} images a second"
    require_within(SourceError, "fps", rate_hz, 0, FASTEST_HZ, words, above=True)
    return ClipSource(folder_clip(Path(rest), rate_hz), profile, unpaced)


class ClipSource(OpticalSource):
    """Source that plays a clip. With ``unpaced``, each read returns the clip's next image.

    Otherwise, a read returns the image that is due. Skipped images count as dropped. They are
    decoded, to measure the motion, if they are less than `MOST_DECODED` images late."""

    ended = "end of the clip"
    duration_s: float | None
    frames: int
    dropped_frames: int

    def __init__(self, clip: Clip, profile: Profile, unpaced: bool) -> None:
        super().__init__(clip.title)
        self._clip, self._unpaced = clip, unpaced
        self._intake = FramePreprocessor(profile)
        self._frame: Frame | None = None
        self._is_unread = self._is_over = False
        self.notes: list[str] = clip.notes
        if clip.count and not unpaced:
            self.duration_s = clip.count / clip.rate_hz

    def read(self, time_ns: int) -> Frame | None:
        """Return the frame at ``time_ns`` since the start of the run; None at the end."""
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
        """Advance to the next image, without decoding it if ``far_behind``."""
        decode = next(self._clip.images, None)
        image = None if decode is None or far_behind else decode()
        if decode is None or (image is None and not far_behind):
            self._is_over = True
            if decode is not None:
                self.notes.append(f"{self.title} ends early: image {self.frames} is damaged")
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
        """Close the file; count an unread frame as dropped."""
        self.dropped_frames += self._is_unread
        self._is_unread = False
        self._is_over = True
        self._clip.close()
