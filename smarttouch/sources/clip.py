"""Clips: videos and folders of images, image after image."""

import os
import re
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image, ImageOps, UnidentifiedImageError

from smarttouch.errors import SourceError
from smarttouch.files import MOST_DOCUMENT_BYTES, open_file, require_file
from smarttouch.sources.camera import QUIET_OPENCV, to_grey

USUAL_HZ = 30.0
FASTEST_HZ = 1000.0
SUFFIXES = (".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".tif", ".tiff")
_FEWEST_PIXELS = 2
_MOST_PIXELS = 80_000_000
_MISSING = 0.05  # accepted part of missing frames; containers only estimate how many they hold
_TURNED = ("JPEG", "TIFF")
"""Formats that may state the camera's orientation before they are decoded."""
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
        self.title = path.name or str(path)
        self.rate_hz = USUAL_HZ
        self.count = 0
        """Number of images; 0 if not known. A video's count is often an estimate."""
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
        self._read = 0

    def open(self) -> None:
        _require_file(self.path)
        with QUIET_OPENCV:
            self._capture.open(str(self.path))
        # Any text is a video to some decoders.
        text = int(self._capture.get(cv2.CAP_PROP_FOURCC)) == _TEXT
        if not self._capture.isOpened() or text:
            self.close()
            message = f"{self.path} is not a readable video: give an MP4, AVI, MKV or MOV"
            raise SourceError(message, about="file")
        rate_hz = self._capture.get(cv2.CAP_PROP_FPS)
        if 0 < rate_hz <= FASTEST_HZ:
            self.rate_hz = rate_hz
        else:
            self.notes.append(
                f"{self.title} does not state its frame rate: {USUAL_HZ:g} Hz is assumed"
            )
        count = self._capture.get(cv2.CAP_PROP_FRAME_COUNT)
        self.count = int(count) if 0 < count < 1e9 else 0
        self._first = self.next()
        if self._first is None or min(self._first.shape) < _FEWEST_PIXELS:
            self.close()
            raise SourceError(f"{self.path} has no readable frame: record it again", about="file")

    def next(self) -> NDArray[np.uint8] | None:
        if self._first is not None:
            image, self._first = self._first, None
            return image
        with QUIET_OPENCV:
            try:
                read, color = self._capture.read()
            except cv2.error:
                read, color = False, None
        if not read or color is None:
            self._end()
            return None
        self._read += 1
        return to_grey(color)

    def skip(self) -> bool:
        if self._first is not None:
            self._first = None
            return True
        with QUIET_OPENCV:
            try:
                read = self._capture.grab()
            except cv2.error:
                read = False
        if not read:
            self._end()
            return False
        self._read += 1
        return True

    def _end(self) -> None:
        note = f"{self.title} breaks off: {self._read} of its {self.count} frames could be read"
        if self.count - self._read > max(1, _MISSING * self.count) and note not in self.notes:
            self.notes.append(note)

    def close(self) -> None:
        self._capture.release()


class ImageFolder(Clip):
    """A folder of images of one size, in natural order of their names."""

    def __init__(self, path: Path, rate_hz: float) -> None:
        super().__init__(path)
        self.rate_hz = rate_hz
        self._files: list[Path] = []
        self._index = 0

    def open(self) -> None:
        self._files = _images(self.path)
        self.count = len(self._files)
        with warnings.catch_warnings():
            # Sizes are checked below.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            sizes = [_size(file) for file in self._files]
        for file, (width, height) in zip(self._files, sizes, strict=True):
            if (width, height) != sizes[0]:
                raise SourceError(
                    f"{file} has {width} x {height} pixels, {self._files[0].name} has "
                    f"{sizes[0][0]} x {sizes[0][1]}: all images of a folder must be of one size",
                    about="file",
                )

    def next(self) -> NDArray[np.uint8] | None:
        if self._index == len(self._files):
            return None
        self._index += 1
        return _load(self._files[self._index - 1])

    def skip(self) -> bool:
        if self._index == len(self._files):
            return False
        self._index += 1
        return True

    def close(self) -> None:
        """Do nothing: each image is read whole."""


def _require_file(path: Path) -> None:
    if path.is_dir():
        raise SourceError(
            f"{path} is a folder: give a video file, or frames:{path}",
            about="file",
            remedy=f"frames:{path}",
        )
    require_file(path, SourceError, MOST_DOCUMENT_BYTES)


def _images(folder: Path) -> list[Path]:
    """Return the images of a folder, 2.png before 10.png."""
    if folder.is_file():
        raise SourceError(
            f"{folder} is a file: give a folder of images, or video:{folder}",
            about="folder",
            remedy=f"video:{folder}",
        )
    try:
        files = [
            file
            for file in folder.iterdir()
            if file.suffix.lower() in SUFFIXES and not file.name.startswith(".")
        ]
    except FileNotFoundError:
        raise SourceError(f"no folder {folder}: check its name", about="folder") from None
    except OSError as error:
        message = f"cannot read the folder {folder}: {error.strerror}"
        raise SourceError(message, about="folder") from None
    if not files:
        message = f"{folder} contains no images: give PNG, JPEG, BMP, TIFF or PGM files"
        raise SourceError(message, about="folder")
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
        with (
            open_file(file, SourceError, MOST_DOCUMENT_BYTES) as opened,
            Image.open(opened) as image,
        ):
            yield image
    except UnidentifiedImageError:
        raise SourceError(f"{file} is not a readable image: remove it", about="file") from None
    except (OSError, SyntaxError, ValueError, EOFError, Image.DecompressionBombError) as error:
        raise SourceError(f"{file} cannot be read, remove it: {error}", about="file") from None


def _size(file: Path) -> tuple[int, int]:
    """Return width and height of the image in its stated orientation."""
    with _reading(file) as image:
        width, height = image.size
        if image.format in _TURNED and image.getexif().get(ExifTags.Base.Orientation, 1) >= 5:
            width, height = height, width
    small = min(width, height) < _FEWEST_PIXELS
    if small or width * height > _MOST_PIXELS:
        message = (
            f"{file} has {width} x {height} pixels: a frame needs at least {_FEWEST_PIXELS} x "
            f"{_FEWEST_PIXELS}, and at most {_MOST_PIXELS // 10**6} megapixels"
        )
        raise SourceError(message, about="file")
    return width, height


def _load(file: Path) -> NDArray[np.uint8]:
    with _reading(file) as image:
        upright = ImageOps.exif_transpose(image) if image.format in _TURNED else image
        if upright.mode.startswith("I"):
            deep = np.clip(np.asarray(upright), 0, 65535).astype(np.uint16)
            return to_grey(deep)
        return np.array(upright.convert("L"))
