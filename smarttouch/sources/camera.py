"""Cameras as sources, read with OpenCV."""

import os
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import SourceError, SourceLostError, require_within
from smarttouch.imaging.grey_image import GreyConverter
from smarttouch.profile import Profile
from smarttouch.sources.live_capture import ImageDevice, LiveSource, Shot

BUFFERS = 1  # images that the driver buffers: a run uses only the newest one
FAILURES = 5  # consecutive reads without an image after which the camera counts as lost
_PAUSE_S = 0.02
COMPRESSED = float(cv2.VideoWriter.fourcc(*"MJPG"))
"""Encoding that allows higher frame rates over USB. Cameras without it keep their own encoding."""
_MANUAL_EXPOSURE = 1
"""Value of V4L2_CID_EXPOSURE_AUTO for manual exposure (3 is automatic)."""
_BELIEVED_AGE_NS = 2_000_000_000
_MOST_PIXELS = 100_000_000
_BACKENDS = {"linux": cv2.CAP_V4L2, "darwin": cv2.CAP_AVFOUNDATION}
"""Backend of OpenCV by platform. Other backends could take a camera's name as a file or URL."""


def open_camera(
    rest: str,
    profile: Profile,
    *,
    size: tuple[int, int] | None = None,
    exposure: float | None = None,
    fps: float | None = None,
) -> LiveSource:
    """Open ``camera:N``, or a camera by its device, as in ``camera:/dev/video2``.

    ``size`` is width and height, pixels; ``exposure`` is in units of the camera, usually 100 µs on
    Linux. Without an option, the camera keeps its own setting.
    """
    return LiveSource(CameraDevice(rest, size, exposure, fps), profile)


def cameras() -> list[tuple[int, str]]:
    """Return numbers and names of the cameras that Linux lists, without opening them.

    Leave out additional device nodes of a camera, for example for metadata.
    """
    nodes = Path("/sys/class/video4linux").glob("video*/index")
    return sorted(
        (int(node.parent.name[5:]), node.with_name("name").read_text().strip())
        for node in nodes
        if int(node.read_text()) == 0
    )


def silence_opencv() -> None:
    """Turn off OpenCV's warnings on the terminal; sources report problems by notes and errors."""
    # Before version 4.13, the main module of OpenCV contains `setLogLevel`.
    log = cv2.utils.logging if hasattr(cv2.utils, "logging") else cv2
    log.setLogLevel(0)


def _format(capture: cv2.VideoCapture) -> tuple[int, int, float]:
    """Return width, height and rate of the images."""
    width, height, rate_hz = (
        capture.get(key)
        for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FPS)
    )
    return round(width), round(height), rate_hz


class CameraDevice(ImageDevice):
    """Camera that delivers gray images. It adds a note for each setting that the camera refuses."""

    def __init__(
        self,
        rest: str,
        size: tuple[int, int] | None = None,
        exposure: float | None = None,
        fps: float | None = None,
    ) -> None:
        self._device = _device(rest)
        self.title: str = f"camera {self._device}"
        if size is not None and not (min(size) >= 2 and size[0] * size[1] <= _MOST_PIXELS):
            raise SourceError(
                f"an image of {size[0]} x {size[1]} pixels is not possible: give width and "
                "height, for example 640 x 480"
            )
        if fps is not None:
            require_within(SourceError, "fps", fps, 0, 1000, above=True)
        if exposure is not None:
            require_within(SourceError, "exposure", exposure, -1e9, 1e9)
        self._size, self._exposure, self._fps = size, exposure, fps
        self._capture: cv2.VideoCapture | None = None
        self._failures = 0
        self._converter = GreyConverter()

    def open(self) -> None:
        # Wait for an image for one second, not ten as by default.
        os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", "1")
        silence_opencv()
        try:
            self._capture = cv2.VideoCapture(self._device, _BACKENDS.get(sys.platform, cv2.CAP_ANY))
            opened = self._capture.isOpened()
            if opened:
                self._set_up(self._capture)
        except cv2.error:
            opened = False
        if not opened:
            self.close()
            raise SourceError(f"cannot open {self.title}: {self._obstacle()}")
        self._failures = 0

    def _obstacle(self) -> str:
        """Return the probable reason why the camera does not open, and what to do."""
        node = f"/dev/video{self._device}" if isinstance(self._device, int) else self._device
        if Path(node).exists() and not os.access(node, os.R_OK | os.W_OK):
            return (
                f"you may not read {node}: join its group (sudo usermod -aG video $USER) and log "
                "in again"
            )
        return (
            "check that it is connected, that its number is right and that no other program uses it"
        )

    def _set_up(self, capture: cv2.VideoCapture) -> None:
        capture.set(cv2.CAP_PROP_BUFFERSIZE, BUFFERS)
        capture.set(cv2.CAP_PROP_FOURCC, COMPRESSED)
        self._set_size(capture)
        width, height, given_hz = _format(capture)
        if self._size is not None and (width, height) != tuple(self._size):
            self._note(f"delivers {width} x {height}, not {self._size[0]} x {self._size[1]}")
        if self._fps is not None and given_hz > 0 and abs(given_hz - self._fps) > 0.05 * self._fps:
            self._note(f"delivers {given_hz:g} images a second, not {self._fps:g}")
        if self._exposure is not None:
            manual = capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL_EXPOSURE)
            if not (capture.set(cv2.CAP_PROP_EXPOSURE, self._exposure) and manual):
                self._note(f"does not accept exposure {self._exposure:g}, and keeps its setting")
            else:
                exposure = capture.get(cv2.CAP_PROP_EXPOSURE)
                if abs(exposure - self._exposure) > 0.1 * abs(self._exposure):
                    self._note(f"uses exposure {exposure:g}, not {self._exposure:g}")

    def _set_size(self, capture: cv2.VideoCapture) -> None:
        if self._size is not None:
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, self._size[0])
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, self._size[1])
        if self._fps is not None:
            capture.set(cv2.CAP_PROP_FPS, self._fps)

    def _note(self, words: str) -> None:
        note = f"{self.title} {words}"
        if note not in self.notes:
            self.notes.append(note)

    def grab(self, timeout_s: float) -> Shot | None:
        """Return the next image, or None; wait for the driver for at most one second."""
        capture = self._capture
        if capture is None:
            raise SourceLostError(f"{self.title} is not open")
        try:
            taken, image = capture.read()
        except cv2.error:
            taken, image = False, None
        if not taken or image is None or not image.size:
            self._failures += 1
            if self._failures >= FAILURES:
                raise SourceLostError(f"{self.title} gave no image {FAILURES} times in a row")
            time.sleep(min(timeout_s, _PAUSE_S))
            return None
        self._failures = 0
        return Shot(self._grey(image), self._taken_ns(capture))

    def _grey(self, image: NDArray[Any]) -> NDArray[np.uint8]:
        """Convert an image from OpenCV, gray or BGR, to gray levels."""
        if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] == 2):
            raise SourceError(
                f"{self.title} gives images of shape {image.shape}: only gray and color can be read"
            )
        if image.ndim == 3 and image.shape[2] >= 3:
            image = cv2.cvtColor(np.ascontiguousarray(image[:, :, :3]), cv2.COLOR_BGR2RGB)
        return self._converter.convert(image)

    @staticmethod
    def _taken_ns(capture: cv2.VideoCapture) -> int:
        """Return the driver's time stamp, or the current time if the stamp is not plausible."""
        now_ns = time.perf_counter_ns()
        taken_ns = round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
        return taken_ns if 0 <= now_ns - taken_ns <= _BELIEVED_AGE_NS else now_ns

    def close(self) -> None:
        if self._capture is not None:
            self._capture.release()
            self._capture = None


def _device(rest: str) -> int | str:
    number = rest.strip()
    if number.isascii() and number.isdigit():
        if len(number) <= 3:
            return int(number)
    elif number.startswith("/"):
        return number
    raise SourceError(
        f"camera:{rest} is not a camera: give its number, as in camera:0, or its device, as in "
        "camera:/dev/video2"
    )
