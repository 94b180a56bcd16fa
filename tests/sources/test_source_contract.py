"""The contract of sources, run over the kinds that there are."""

import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from smarttouch.sources import open_source
from smarttouch.sources.sensor_protocol import encode_frame
from smarttouch.testing.source_contracts import SourceContract

from .test_video import write_clip

GOLDENS = Path(__file__).parents[1] / "running" / "goldens"


class Contract(SourceContract):
    """The contract of a source of a URL; `nowhere` is one that is not there."""

    url = nowhere = ""
    unpaced = width_mm = fps = None

    def make(self, profile):
        options = {"unpaced": self.unpaced, "page_width_mm": self.width_mm, "fps": self.fps}
        return open_source(self.url, profile, **options)

    def make_impossible(self, profile):
        open_source(self.nowhere, profile)


class TestPage(Contract):
    nowhere, width_mm = "page:nothing.png", 20.0

    @pytest.fixture(autouse=True)
    def _page(self, tmp_path):
        grey = np.full((80, 200), 255, np.uint8)
        grey[30:50, 20:180:10] = 0
        Image.fromarray(grey).save(tmp_path / "page.png")
        self.url = f"page:{tmp_path / 'page.png'}"


class TestText(Contract):
    url, nowhere = "text:a word", "text:"


class TestUnpacedFolder(Contract):
    nowhere = "frames:nothing"
    unpaced = True

    @pytest.fixture(autouse=True)
    def _folder(self, tmp_path):
        for number in range(40):
            grey = np.full((48, 64), 5 * number, np.uint8)
            Image.fromarray(grey).save(tmp_path / f"{number}.png")
        self.url = f"frames:{tmp_path}"


class TestPacedFolder(TestUnpacedFolder):
    unpaced, fps = None, 200.0


class TestUnpacedVideo(Contract):
    nowhere = "video:nothing.avi"
    unpaced = True

    @pytest.fixture(autouse=True)
    def _video(self, tmp_path):
        images = [np.full((48, 64), 5 * number) for number in range(40)]
        self.url = f"video:{write_clip(tmp_path / 'clip.avi', images)}"


class TestSerialArray(Contract):
    ends = False
    nowhere = "serial-array:/dev/nothing"

    @pytest.fixture(autouse=True)
    def _device(self, make_device):
        device = make_device(
            lambda number: encode_frame(number, 0, np.full((8, 8), number % 256, np.uint8))
        )
        self.url = f"serial-array:{device.line.name}"

    def pause(self):
        time.sleep(0.005)


class TestRecording(Contract):
    nowhere = "recording:nothing.mcap"
    url = f"recording:{GOLDENS / 'ra.mcap'}"
