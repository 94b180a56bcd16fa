"""Bridge from MCAP files: shows the images of a ROS 2 topic at their recorded times.

    python mcap_playback.py FILE TOPIC BOARD INTENSITY [FORCE]

Messages are sensor_msgs/msg/CompressedImage, or sensor_msgs/msg/Image in mono8, rgb8 or bgr8.
"""

import io
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from PIL import Image

import smarttouch as st

LONGEST_GAP_S = 10.0


def image_of(message: Any) -> np.ndarray:
    """Return the image of a message: gray (H, W, 1), RGB (H, W, 3) or RGBA (H, W, 4), uint8."""
    if hasattr(message, "format"):
        return np.array(Image.open(io.BytesIO(message.data)).convert("RGBA"))
    channels = {"mono8": 1, "rgb8": 3, "bgr8": 3}[message.encoding]
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    image = rows[:, : message.width * channels].reshape(message.height, message.width, channels)
    return image[:, :, ::-1] if message.encoding == "bgr8" else image


def main(path: str, topic: str, board: str, intensity: str, force: str | None = None) -> None:
    """Show each image at its recorded time, relative to the first image."""
    display = st.open_display(board)
    session = display.session(mode="RA", intensity=float(intensity), force=force)
    count, before_s, due_s = 0, None, 0.0
    with Path(path).open("rb") as file, session as touch:
        messages = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, _, record, message in messages.iter_decoded_messages(topic):
            logged_s = record.log_time / 1e9
            gap_s = 0.0 if before_s is None else logged_s - before_s
            if not 0 <= gap_s <= LONGEST_GAP_S:
                print(f"image {count}: shown at once, because recorded time jumps by {gap_s:g} s")
                gap_s = 0.0
            before_s, due_s = logged_s, max(due_s + gap_s, time.monotonic())
            time.sleep(max(0.0, due_s - time.monotonic()))
            touch.put(st.Frame(image_of(message), 0))
            count += 1
    print(f"{count} images, {touch.statistics.delivered} sequences with pulses")


if __name__ == "__main__":
    main(*sys.argv[1:])
