"""The moving picture of a run: what each panel shows is what was delivered then."""

import numpy as np
import pytest
from PIL import Image, ImageSequence

import smarttouch as st
from smarttouch.base.array_picture import ANODIC, CATHODIC
from smarttouch.base.errors import SmartTouchError
from smarttouch.views.moving_picture import FRAME_S
from smarttouch.views.outputs import DeliveredPicture

from ..raising import raises


def run(path, source, **settings):
    display = st.open_display("simulated:", st.load_profile("smarttouch-4x4"))
    with st.open_source(source, display.profile, speed_mm_s=12) as opened:
        drawing = DeliveredPicture(path, anatomy="paper")
        return st.run(opened, display, listeners=[drawing], **settings)


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """Frames of a word that is read, and the run's statistics."""
    path = tmp_path_factory.mktemp("film") / "a.gif"
    statistics = run(path, "text:on")
    with Image.open(path) as picture:
        assert picture.info["duration"] == 1000 * FRAME_S
        frames = [
            np.asarray(each.convert("RGB")).astype(int) for each in ImageSequence.Iterator(picture)
        ]
    assert path.stat().st_size < 1_000_000
    return frames, statistics


def colored(frame, color):
    """Return where a frame has a color, (N, 2) rows and columns; the legend is below."""
    near = np.abs(frame[:-60] - color).max(axis=2) < 12
    return np.argwhere(near)


def test_it_lasts_as_long_as_the_finger_had_current(film):
    frames, statistics = film
    assert len({each.shape for each in frames}) == 1
    assert 0.5 < len(frames) * FRAME_S / statistics.seconds < 1.1


def test_panels_change_and_the_sum_only_grows(film):
    frames, _ = film
    ink = [int((np.ptp(each[200:-55, 20:290], axis=2) > 40).sum()) for each in frames]
    assert ink[0] == 0
    assert 0 < ink[3 * len(ink) // 5] < ink[-1]
    strong = [len(colored(each, ANODIC)) + len(colored(each, CATHODIC)) for each in frames]
    assert max(strong) > 50
    # The finger goes from left to right over the page.
    moved = np.abs(frames[len(frames) // 2] - frames[2])[:160].max(axis=2) > 60
    assert moved[:, :360].sum() > 100


def test_what_cannot_be_drawn_is_one_sentence(tmp_path):
    path = tmp_path / "a.gif"
    with raises(SmartTouchError):
        run(path, "text:on", intensity=0.0)
    with raises(SmartTouchError):
        st.run(
            st.open_source("texture:grating:4mm,30deg", st.load_profile("electric-mouse")),
            st.open_display("simulated:"), listeners=[DeliveredPicture(path)], seconds=0.2,
        )  # fmt: skip
    assert not path.exists()
