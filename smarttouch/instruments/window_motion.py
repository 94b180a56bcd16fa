"""A window that shows the texture; the pointer over it is the hand."""

import base64
import gc
import io
import queue
import threading
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from smarttouch.base.errors import SourceError
from smarttouch.instruments.hand_motion import HandMotion
from smarttouch.instruments.textures import Texture

if TYPE_CHECKING:
    import tkinter

PAD_MM = (150.0, 100.0)  # size of a texture without bounds
_SHARE = 0.8  # largest part of the screen for the window
_POLL_MS = 50
_START_S = 10.0


def open_window(rest: str, *, texture: Texture | None = None) -> "WindowMotion":
    """Open ``window:`` over a texture, or over an empty pad."""
    if rest:
        raise SourceError(f"window: takes nothing after the colon, not {rest!r}")
    return WindowMotion(texture)


class Pointer:
    """Position of the pointer on a picture, set by one thread and read by another."""

    def __init__(self, size_px: tuple[int, int], mm_per_px: float) -> None:
        self._mm_per_px = mm_per_px
        # One tuple is replaced at once: no lock is needed.
        self.place_px: tuple[float, float] = (size_px[0] / 2, size_px[1] / 2)

    @property
    def place_mm(self) -> tuple[float, float]:
        """Position from the top left corner of the picture."""
        x, y = self.place_px
        return x * self._mm_per_px, y * self._mm_per_px


class WindowMotion(HandMotion):
    """Motion of the pointer over a texture, at true size if the screen is large enough."""

    def __init__(self, texture: Texture | None = None) -> None:
        super().__init__("the pointer over a window")
        self._texture = texture
        self._open = True
        self._closing = threading.Event()
        self._started: queue.SimpleQueue[Pointer | SourceError] = queue.SimpleQueue()
        # Tk belongs to one thread from its first call to its last.
        self._thread = threading.Thread(target=self._show, name="window", daemon=True)
        self._thread.start()
        try:
            started = self._started.get(timeout=_START_S)
        except queue.Empty:
            self._open = False
            self._closing.set()
            message = "window: the display does not answer: try again"
            raise SourceError(message) from None
        if isinstance(started, SourceError):
            self.close()
            raise started
        self._pointer = started

    def read(self, time_ns: int) -> tuple[float, float] | None:
        """Return the displacement of the pointer from its start; None once the window is closed."""
        if not self._open:
            return None
        x, y = self._pointer.place_mm
        if self.origin_mm is None:
            self.origin_mm: tuple[float, float] = (x, y)
        return x - self.origin_mm[0], y - self.origin_mm[1]

    def close(self) -> None:
        """Close the window."""
        self._open = False
        self._closing.set()
        self._thread.join(_START_S)

    def _show(self) -> None:
        try:
            import tkinter
        except ImportError:
            words = "window: this Python has no Tk: apt install python3-tk, or move by evdev:"
            self._started.put(_missing("tkinter", words))
            return
        try:
            root = tkinter.Tk()
        except tkinter.TclError as error:
            words = f"window: there is no display ({error}): run it in a desktop, or move by evdev:"
            self._started.put(_missing("display", words))
            return
        try:
            pointer, shown = self._fill(root)
            self._started.put(pointer)
            self._watch(root)
            root.mainloop()
            del shown
        except tkinter.TclError as error:
            message = f"window: the display failed: {error}"
            self._started.put(SourceError(message))
        self._open = False
        # Tcl ends the program if another thread collects what is left of the window.
        self._closing.wait()
        del root
        gc.collect()

    def _fill(self, root: "tkinter.Tk") -> tuple[Pointer, "tkinter.PhotoImage"]:
        """Return the pointer's position, and objects that Tk shows without keeping references."""
        import tkinter

        size_mm = (self._texture and self._texture.size_mm) or PAD_MM
        screen = (root.winfo_screenwidth(), root.winfo_screenheight())
        size_px, mm_per_px = fit(size_mm, 1 / root.winfo_fpixels("1m"), screen)
        shape = (size_px[1], size_px[0])
        image = np.full(shape, 255, np.uint8)
        if self._texture is not None:
            image = self._texture.draw(0.0, 0.0, shape, mm_per_px)
        pointer = Pointer(size_px, mm_per_px)
        root.title(f"SmartTouch: {self._texture.title if self._texture else 'move here'}")
        root.resizable(False, False)
        picture = tkinter.PhotoImage(master=root, data=_png(image))
        label = tkinter.Label(root, image=picture, borderwidth=0, cursor="crosshair")
        label.pack()
        label.bind("<Motion>", lambda event: setattr(pointer, "place_px", (event.x, event.y)))
        self.resolution_mm = mm_per_px
        self.title: str = f"the pointer over a window, {mm_per_px:.3f} mm a pixel"
        return pointer, picture

    def _watch(self, root: "tkinter.Tk") -> None:
        """End the window's thread when the window is to be closed."""
        if self._open:
            root.after(_POLL_MS, self._watch, root)
        else:
            root.destroy()


def fit(
    size_mm: tuple[float, float], mm_per_px: float, screen_px: tuple[int, int]
) -> tuple[tuple[int, int], float]:
    """Return the size in pixels of a picture on the screen, at true size or smaller to fit, and its
    scale in mm per pixel."""
    room = [_SHARE * side * mm_per_px for side in screen_px]
    smaller = max(1.0, *(side / most for side, most in zip(size_mm, room, strict=True)))
    mm_per_px *= smaller
    wide, high = (max(1, round(side / mm_per_px)) for side in size_mm)
    return (wide, high), mm_per_px


def _missing(what: str, message: str) -> SourceError:
    return SourceError(message)


def _png(image: NDArray[np.uint8]) -> bytes:
    file = io.BytesIO()
    Image.fromarray(image).save(file, format="PNG")
    return base64.b64encode(file.getvalue())
