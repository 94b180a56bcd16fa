"""``mcap:``: images of other programs' MCAP files and ROS 2 bags, at their messages' times."""

import base64
import json
from collections import deque
from collections.abc import Callable, Iterator
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from mcap.records import Channel, Message, Schema
from numpy.typing import NDArray
from PIL import Image

from smarttouch.base.errors import SourceError
from smarttouch.base.lazy_names import import_extra
from smarttouch.profile import Profile
from smarttouch.running.mcap_file import McapFile
from smarttouch.sources.camera import to_grey
from smarttouch.sources.source_contract import OpticalSource
from smarttouch.sources.video import FASTEST_HZ, Clip, open_clip, require_frame_size

RAW = ("sensor_msgs/msg/Image", "foxglove.RawImage", "foxglove_msgs/msg/RawImage")
COMPRESSED = (
    "sensor_msgs/msg/CompressedImage",
    "foxglove.CompressedImage",
    "foxglove_msgs/msg/CompressedImage",
)
_CHANNELS = {
    "mono8": 1, "8UC1": 1, "rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4, "8UC4": 4,
    "mono16": 1, "16UC1": 1,
}  # fmt: skip
"""Channels of encodings (ROS's ``sensor_msgs/image_encodings.hpp``)."""
_AHEAD = 8  # messages that are read ahead, which say how far apart they are

Decode = Callable[[bytes], Any]


def open_mcap(
    rest: str, profile: Profile, *, topic: str | None = None, unpaced: bool = False
) -> OpticalSource:
    """Open ``mcap:FILE?topic=NAME``, or the folder of a ROS 2 bag; a single topic needs no name.

    ``unpaced`` gives one image a read.
    """
    return open_clip(McapImages(Path(rest), topic), profile, unpaced)


class McapImages(Clip):
    """Images of one topic: raw or compressed ones of ROS 2 or Foxglove.

    Messages in CDR and Protobuf need the extra ``ros``.
    """

    def __init__(self, path: Path, topic: str | None = None) -> None:
        super().__init__(path)
        self._topic = topic
        self._messages: Iterator[tuple[McapFile, Channel, Message]] = iter(())
        self._ahead: deque[tuple[McapFile, Channel, Message]] = deque()
        self._decoders: dict[tuple[int, int], Decode] = {}
        self._given = 0
        self._first_ns = self._last_ns = 0

    def open(self) -> None:
        files = [McapFile(each) for each in _files(self.path)]
        self._topic = _chosen(self.path, files, self._topic)
        self.title: str = f"{self.title} {self._topic}"
        self._messages = (
            (file, channel, message)
            for file in files
            for channel, message in file.all_messages()
            if channel.topic == self._topic
        )
        self._read_ahead()
        if not self._ahead:
            raise SourceError(f"{self.path} has no image on {self._topic}", about="topic")
        times_ns = [message.log_time for _, _, message in self._ahead]
        self._first_ns = times_ns[0]
        longest_ns = max((late - early for early, late in pairwise(times_ns)), default=0)
        if longest_ns > 0:
            self.rate_hz: float = min(FASTEST_HZ, 1e9 / longest_ns)

    def _read_ahead(self) -> None:
        while len(self._ahead) < _AHEAD and (each := next(self._messages, None)) is not None:
            self._ahead.append(each)

    def due_ns(self, number: int) -> int:
        if number < self._given:
            return self._last_ns
        if not self._ahead:
            return self._last_ns + round(1e9 / self.rate_hz)
        return max(self._last_ns, self._ahead[0][2].log_time - self._first_ns)

    def next(self) -> NDArray[np.uint8] | None:
        taken = self._take()
        if taken is None:
            return None
        file, channel, message = taken
        at = f"{self.path}, {self._topic}, {self._last_ns / 1e9:.3f} s after its first image"
        key = (id(file), channel.id)
        if key not in self._decoders:
            schema = file.schemas[channel.schema_id]
            self._decoders[key] = _decoder(channel, schema)
        try:
            image = self._decoders[key](message.data)
        except SourceError as error:
            raise SourceError(f"{at}: {error}", about="image") from None
        except Exception as error:  # whatever decoders make of damaged bytes
            raise SourceError(
                f"{at}: an image that cannot be read ({type(error).__name__}: {error})",
                about="image",
            ) from None
        return to_grey(image)

    def _take(self) -> tuple[McapFile, Channel, Message] | None:
        if not self._ahead:
            return None
        self._last_ns = self.due_ns(self._given)
        self._given += 1
        taken = self._ahead.popleft()
        self._read_ahead()
        return taken

    def skip(self) -> bool:
        return self._take() is not None

    def close(self) -> None:
        self._ahead.clear()
        self._messages = iter(())


def _files(path: Path) -> list[Path]:
    """Return the file, or the files of a bag in their order."""
    if not path.is_dir():
        return [path]
    found = sorted(path.glob("*.mcap"), key=lambda each: (len(each.name), each.name))
    if not found:
        older = next(path.glob("*.db3"), None)
        raise SourceError(
            f"{path} has no .mcap file"
            + (": convert it, ros2 bag convert can" if older else ": give one, or a ROS 2 bag"),
            about="file",
        )
    return found


def _chosen(path: Path, files: list[McapFile], topic: str | None) -> str:
    """Return the topic that was asked for, or the only one with images."""
    for file in files:
        if not file.ended:
            # Its summary is missing: channels are in chunks alone.
            for _ in file.all_messages():
                pass
    kinds = {
        channel.topic: file.schemas[channel.schema_id].name
        for file in files
        for channel in file.channels.values()
        if channel.schema_id in file.schemas
    }
    images = sorted(name for name, kind in kinds.items() if kind in (*RAW, *COMPRESSED))
    if topic is None and len(images) == 1:
        return images[0]
    if topic in images:
        return topic
    there = ", ".join(images) or "none"
    what = f"no images on {topic}" if topic else f"{len(images) or 'no'} topics with images"
    raise SourceError(
        f"{path} has {what}: choose one by ?topic=NAME (with images: {there})", about="topic"
    )


def _decoder(channel: Channel, schema: Schema) -> Decode:
    """Return what makes an image, (H, W) or (H, W, C), of a message."""
    encoding = channel.message_encoding
    decoded: Decode
    if encoding == "json":
        decoded = _of_json
    elif encoding == "cdr" and schema.encoding == "ros2msg":
        decoded = _from_package("mcap_ros2.decoder", encoding, schema)
    elif encoding == "protobuf":
        decoded = _from_package("mcap_protobuf.decoder", encoding, schema)
    else:
        raise SourceError(
            f"messages in {encoding or 'no'} encoding with schemas in {schema.encoding or 'none'} "
            "are not known: record them as ROS 2 (ros2msg), Protobuf or JSON",
            about="topic",
        )
    turned = _compressed if schema.name in COMPRESSED else _raw
    return lambda data: turned(decoded(data))


def _from_package(module: str, encoding: str, schema: Schema) -> Decode:
    decoders = import_extra(module, f"a message in {encoding}", "ros", SourceError)
    decode: Decode = decoders.DecoderFactory().decoder_for(encoding, schema)
    return decode


def _of_json(data: bytes) -> SimpleNamespace:
    values = json.loads(data)
    return SimpleNamespace(**values | {"data": base64.b64decode(values["data"], validate=True)})


def _compressed(message: Any) -> NDArray[np.uint8]:
    with Image.open(BytesIO(bytes(message.data))) as image:
        require_frame_size("an image", *image.size, "image")
        return np.array(image.convert("L"))


def _raw(message: Any) -> NDArray[Any]:
    height, width, step = int(message.height), int(message.width), int(message.step)
    require_frame_size("an image", width, height, "image")
    encoding = str(message.encoding)
    channels = _CHANNELS.get(encoding)
    if channels is None:
        raise SourceError(
            f"images in {encoding!r} are not known: give one of {', '.join(_CHANNELS)}",
            about="encoding",
        )
    deep = encoding in ("mono16", "16UC1")
    big = bool(getattr(message, "is_bigendian", False))
    kind = np.dtype(("<u2", ">u2")[big] if deep else np.uint8)
    rows = np.frombuffer(bytes(message.data), np.uint8).reshape(height, step)
    row = np.ascontiguousarray(rows[:, : width * channels * kind.itemsize]).view(kind)
    image = row.reshape(height, width, channels).astype(kind.newbyteorder("="))
    return image[:, :, [2, 1, 0, 3][:channels]] if encoding.startswith("rgb") else image
