"""A clip of print that moves, is blurred and flickers is felt as the page under it."""

import cv2
import numpy as np
import pytest
from PIL import Image, ImageDraw

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.imaging.array_window import profile_for_reading
from smarttouch.imaging.tactile_mapper import TactileMapper
from smarttouch.sources import open_source

from ..pages.printed import INK, PAPER, _font

SIDE, STEP, FRAMES = 64, 3, 60


@pytest.fixture
def page():
    """A line of large letters, (H, W) uint8, as wide as the clip is long."""
    sheet = Image.new("L", (SIDE + STEP * FRAMES, SIDE), PAPER)
    draw = ImageDraw.Draw(sheet)
    draw.text((70, 50), "THLE", fill=INK, font=_font("DejaVuSans-Bold", 56), anchor="ls")
    return np.asarray(sheet)


def filmed(path, page):
    """Write what a camera shows of a page that passes by, under a flickering lamp."""
    fourcc = cv2.VideoWriter.fourcc(*"MJPG")
    writer = cv2.VideoWriter(str(path), fourcc, 60.0, (SIDE, SIDE))
    random = np.random.default_rng(0)
    moving = cv2.GaussianBlur(cv2.blur(page.astype(np.float32), (2 * STEP, 1)), (0, 0), 1.2)
    for number in range(FRAMES):
        light = 0.8 + 0.2 * np.sin(2 * np.pi * number / 5)
        image = light * moving[:, STEP * number : STEP * number + SIDE]
        image = np.clip(image + random.normal(0, 3, image.shape), 0, 255).astype(np.uint8)
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    writer.release()


def test_a_moving_blurred_flickering_clip_is_made_out(profile, page, tmp_path):
    filmed(tmp_path / "clip.avi", page)
    mapper = TactileMapper(profile_for_reading(profile))
    true, seen = [], []
    with open_source(f"video:{tmp_path / 'clip.avi'}", profile, unpaced=True) as source:
        for number in range(FRAMES):
            frame = source.read(number * 10**9 // 60)
            seen.append(mapper.map(frame, Mode.RA).activation[Afferent.RA])
            under = page[:, STEP * number : STEP * number + SIDE] < (INK + PAPER) / 2
            true.append(cv2.resize(under.astype(np.float32), (8, 8), interpolation=cv2.INTER_AREA))
    seen, true = np.array(seen), np.array(true).reshape(FRAMES, -1)
    blank = true.max(axis=1) == 0
    assert blank.any()
    assert not seen[blank].any()
    assert np.corrcoef(seen.ravel(), true.ravel())[0, 1] > 0.8
    assert seen[true > 0.95].mean() > 0.8
    assert seen[true == 0].mean() < 0.1
