"""``lsl:``: images or activations from a stream of the Lab Streaming Layer."""

import contextlib
import time
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import SourceError, SourceLostError
from smarttouch.instruments.pushed_stimuli import (
    LOOK_S,
    TCP_TABLES,
    PushedStimuli,
    lead_to_us,
    own_sockets,
)
from smarttouch.profile import Profile
from smarttouch.sources.live_capture import ImageDevice, LiveSource, Shot
from smarttouch.sources.source_contract import Source

FIND_S = 3.0  # time to look for a stream
_MOST_SAMPLES = 64


def open_lsl(
    rest: str, profile: Profile, *, size: tuple[int, int] | None = None, follow: bool = False
) -> Source:
    """Open ``lsl:NAME``, a stream of another program of this user on this machine.

    With ``size``, as in 64x48, a sample is an image of gray levels, row by row from 0 (black) to
    255. Without, it is the activation of the electrodes from 0 to 1, E numbers for all classes or
    3 E for RA, SAI and PC. With ``follow`` each is one pulse, see `PushedStimuli`.
    """
    if size is not None:
        return LiveSource(LslImages(rest, size), profile, follow=follow)
    return LslStimuli(rest, profile, follow)


class LslInlet:
    """Newest sample of a stream, which programs of this user alone may send.

    The Lab Streaming Layer does not say who sends: any program of the network could name its stream
    so. The connection must end in a program of this user on this machine.
    """

    def __init__(self, name: str) -> None:
        if not name:
            raise SourceError("lsl: has no stream: give its name, as in lsl:Tactile", about="name")
        if not TCP_TABLES[0].exists():
            raise SourceError(
                f"this system has no {TCP_TABLES[0]}, which says whose program sends: use socket:",
                about="lsl",
            )
        self.name: str = name
        self._lsl, self._util = _import_lsl()
        self._inlet: Any = None
        self.channels: int = 0

    def open(self) -> None:
        """Find the stream, and connect; raise SourceError if there is none."""
        found = self._lsl.resolve_byprop("name", self.name, 1, FIND_S)
        if not found:
            raise SourceError(
                f"there is no stream {self.name!r} on the Lab Streaming Layer: start the program "
                "that sends it, and check its name",
                about="name",
            )
        for info in found:
            if (inlet := self._connected(info)) is not None:
                self.channels, self._inlet = info.channel_count(), inlet
                return
        raise SourceError(
            f"the stream {self.name!r} does not come from a program of yours on this machine, and "
            "anybody else's could drive current: send it from here",
            about="name",
        )

    def _connected(self, info: Any) -> Any:
        """Return an inlet of a stream of this user; None if it is of others, or has words."""
        if info.channel_format() == self._lsl.cf_string:
            return None
        before = own_sockets()
        # Without recovery: it would connect to whoever takes the name.
        inlet = self._lsl.StreamInlet(info, max_buflen=1, recover=False)
        try:
            inlet.open_stream(timeout=FIND_S)
            # The system shows where the connection leads; what the stream states of itself is not
            # believed.
            if lead_to_us(own_sockets() - before):
                return inlet
        except (self._util.TimeoutError, self._util.LostError, OSError):
            pass
        inlet.close_stream()
        return None

    def newest(self, timeout_s: float) -> tuple[NDArray[np.float64] | None, int]:
        """Return the newest sample, None at the time limit, and how many came before it."""
        inlet = self._inlet
        lost = SourceLostError(f"the stream {self.name!r} has ended", about="name")
        if inlet is None:
            raise lost
        try:
            first, _ = inlet.pull_sample(timeout=timeout_s)
            if first is None:
                return None, 0
            more, _ = inlet.pull_chunk(timeout=0.0, max_samples=_MOST_SAMPLES)
        except self._util.LostError:
            raise lost from None
        return np.asarray(more[-1] if more else first, np.float64), len(more)

    def close(self) -> None:
        """Close the connection."""
        inlet, self._inlet = self._inlet, None
        if inlet is not None:
            with contextlib.suppress(Exception):
                inlet.close_stream()


class LslImages(ImageDevice):
    """Images of a stream."""

    def __init__(self, name: str, size: tuple[int, int]) -> None:
        self.title: str = f"LSL stream {name}"
        self._inlet, self._size = LslInlet(name), size

    def open(self) -> None:
        self._inlet.open()
        width, height = self._size
        if self._inlet.channels != width * height:
            raise SourceError(
                f"the stream {self._inlet.name!r} has {self._inlet.channels} channels, an image of "
                f"{width} x {height} has {width * height}: give the size that it sends",
                about="size",
            )

    def grab(self, timeout_s: float) -> Shot | None:
        sample, before = self._inlet.newest(timeout_s)
        if sample is None:
            return None
        if not (sample.min() >= 0 and sample.max() <= 255):
            raise SourceError(
                f"the stream {self._inlet.name!r} has gray levels from {sample.min():g} to "
                f"{sample.max():g}: they must be from 0 to 255",
                about="image",
            )
        width, height = self._size
        image = np.rint(sample).astype(np.uint8).reshape(height, width)
        return Shot(image, time.perf_counter_ns(), before)

    def close(self) -> None:
        self._inlet.close()


class LslStimuli(PushedStimuli):
    """Activations of a stream; those that are not from 0 to 1 are left out and counted."""

    def __init__(self, name: str, profile: Profile, follow: bool) -> None:
        super().__init__(f"LSL stream {name}", profile, follow)
        self._inlet = LslInlet(name)
        self._inlet.open()
        count = len(profile.electrodes)
        self._shape = len(Afferent), count
        if self._inlet.channels not in (count, len(Afferent) * count):
            self._inlet.close()
            raise SourceError(
                f"the stream {name!r} has {self._inlet.channels} channels: this array has {count} "
                f"electrodes, so give {count} or {len(Afferent) * count}, or size for images",
                about="channels",
            )
        self._thread.start()

    def receive(self) -> None:
        try:
            sample, before = self._inlet.newest(LOOK_S)
        except SourceError:
            # Until it is there again.
            self._inlet.close()
            time.sleep(LOOK_S)
            with contextlib.suppress(SourceError):
                self._inlet.open()
            return
        if sample is None:
            return
        self.frames += before
        self.dropped_frames += before
        if sample.min() >= 0 and sample.max() <= 1:
            level = sample.astype(np.float32).reshape(-1, self._shape[1])
            self.push(np.ascontiguousarray(np.broadcast_to(level, self._shape)))
        else:
            self.wrong += 1

    def close(self) -> None:
        super().close()
        self._inlet.close()
        self._note_wrong("activations were not from 0 to 1 and were left out")


def _import_lsl() -> tuple[Any, Any]:
    try:
        return import_module("pylsl"), import_module("pylsl.util")
    except (ImportError, RuntimeError) as error:
        raise SourceError(
            f"lsl: needs the extra lsl and its library: pip install 'smarttouch[lsl]' ({error})",
            about="lsl",
            remedy="pip install 'smarttouch[lsl]'",
        ) from None
