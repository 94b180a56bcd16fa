"""Views of a recording as PNG, SVG and MP4, in the colors of the page."""

import base64
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import RecordingError
from smarttouch.files import owner_only, unwritable
from smarttouch.window.tape import Tape

CATHODIC, ANODIC, BASE = (179, 88, 6), (84, 39, 136), (236, 238, 241)
KINDS = (".png", ".svg", ".mp4")
FILM_HZ = 25
"""Pictures a second of a film."""
MOST_FILM_S = 600
_PX_PER_MM = 24
_MOST_PX = 720
_FINER = 4
_EDGE = (139, 152, 164)
_CODEC = "vp09"
"""That browsers play, and that OpenCV brings along."""

Current = NDArray[np.int16]


def shown_current(picture: dict[str, Any], electrodes: int, slot: int | None) -> Current:
    """Return the current of each electrode in a slot, or the strongest of all, (E,) µA."""
    current = np.frombuffer(base64.b64decode(picture["current_ua"]), "<i2")
    current = current.reshape(-1, electrodes)
    if slot is not None:
        return np.asarray(current[slot])
    if not len(current):
        return np.zeros(electrodes, np.int16)
    strongest = np.abs(current.astype(np.int32)).argmax(axis=0)
    return np.asarray(np.take_along_axis(current, strongest[None], axis=0)[0])


def current_colors(current_ua: Current, full_ma: float) -> NDArray[np.uint8]:
    """Return the color of each electrode, (E, 3): orange is cathodic, purple anodic."""
    part = np.clip(current_ua / (1000 * full_ma), -1, 1)[:, None]
    target = np.where(part < 0, ANODIC, CATHODIC)
    mixed = np.array(BASE) + (target - np.array(BASE)) * np.abs(part)
    return np.asarray(np.floor(mixed + 0.5), np.uint8)


def svg(about: dict[str, Any], current_ua: Current) -> str:
    """Return a view of the electrodes, in mm."""
    wide, high = about["extent_mm"]
    colors = current_colors(current_ua, about["full_ma"])
    discs = "".join(
        f'<circle cx="{x:g}" cy="{y:g}" r="{about["radius_mm"]:g}" '
        f'fill="rgb({red},{green},{blue})"><title>electrode {number}: {ua / 1000:g} mA</title>'
        "</circle>"
        for number, ((x, y), (red, green, blue), ua) in enumerate(
            zip(about["place_mm"], colors.tolist(), current_ua.tolist(), strict=True)
        )
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{wide * 10:g}" height="{high * 10:g}" '
        f'viewBox="{-wide / 2:g} {-high / 2:g} {wide:g} {high:g}">'
        f'<g stroke="rgb{_EDGE}" stroke-width="0.04">{discs}</g></svg>\n'
    )


def raster(about: dict[str, Any], current_ua: Current) -> NDArray[np.uint8]:
    """Return a view of the electrodes as pixels, (H, W, 3) in RGB."""
    wide, high = about["extent_mm"]
    scale = min(_PX_PER_MM, _MOST_PX / max(wide, high))
    # Even sides, as films have.
    size = [2 * max(1, round(each * scale / 2)) for each in (wide, high)]
    fine = scale * _FINER
    image = np.full((size[1] * _FINER, size[0] * _FINER, 3), 255, np.uint8)
    radius = round(about["radius_mm"] * fine)
    colors = current_colors(current_ua, about["full_ma"]).tolist()
    for (x, y), color in zip(about["place_mm"], colors, strict=True):
        center = (round((x + wide / 2) * fine), round((y + high / 2) * fine))
        cv2.circle(image, center, radius, color, -1, cv2.LINE_AA)
        cv2.circle(image, center, radius, _EDGE, _FINER, cv2.LINE_AA)
    return np.asarray(cv2.resize(image, (size[0], size[1]), interpolation=cv2.INTER_AREA), np.uint8)


def export_view(tape: Tape, index: int, kind: str, slot: int | None = None) -> bytes:
    """Return a view of a step as a ``.png`` or ``.svg``; of a slot, or the strongest of all slots."""
    about = tape.array
    current = shown_current(json.loads(tape.picture(index)), len(about["place_mm"]), slot)
    if kind == ".svg":
        return svg(about, current).encode()
    _, png = cv2.imencode(".png", cv2.cvtColor(raster(about, current), cv2.COLOR_RGB2BGR))
    return png.tobytes()


def export_film(
    tape: Tape,
    path: Path,
    first: int = 0,
    last: int | None = None,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
) -> None:
    """Write steps of an index that has been read as a film (``.mp4``) in their own time.

    Raises RecordingError if the film is too long, or cannot be written.
    """
    # A copy: the recording may still be being read, and it grows.
    times = np.array(tape.times_s[first : None if last is None else last + 1])
    if not len(times):
        raise IndexError(first)
    seconds = float(times[-1] - times[0])
    if seconds > MOST_FILM_S:
        raise RecordingError(
            f"a film of {seconds:.0f} s is longer than {MOST_FILM_S}: choose fewer steps",
            about="film",
            problem="too long",
            value=seconds,
            allowed=MOST_FILM_S,
        )
    count = max(1, round(seconds * FILM_HZ))
    at_s = times[0] + np.arange(count) / FILM_HZ
    indices = first + np.searchsorted(times, at_s + 1e-9, side="right") - 1
    _write_film(path, _pictures(tape, indices.tolist()), advance, count)


def _pictures(tape: Tape, indices: Iterable[int]) -> Iterable[NDArray[np.uint8]]:
    about = tape.array
    for index in indices:
        picture = json.loads(tape.picture(index))
        yield raster(about, shown_current(picture, len(about["place_mm"]), None))


def _write_film(
    path: Path,
    pictures: Iterable[NDArray[np.uint8]],
    advance: Callable[[int, int], None],
    count: int,
) -> None:
    writer: cv2.VideoWriter | None = None
    try:
        for done, picture in enumerate(pictures, 1):
            height, width = picture.shape[:2]
            if writer is None:
                with open(path, "wb", opener=owner_only):
                    pass
                code = cv2.VideoWriter.fourcc(*_CODEC)
                writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, FILM_HZ, (width, height))
                if not writer.isOpened():
                    raise RecordingError(
                        f"cannot write {path}: see whether its folder is there and may be written "
                        "to, and that this OpenCV writes VP9",
                        about="file",
                        problem="unwritable",
                        value=path,
                    )
            writer.write(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
            advance(done, count)
    except OSError as error:
        raise unwritable(RecordingError, path, error) from None
    finally:
        if writer is not None:
            writer.release()
