"""The picture of what the skin got."""

import numpy as np
import pytest
from PIL import Image

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import SmartTouchError
from smarttouch.instruments.electric_mouse import TexturePicture
from smarttouch.instruments.hand_motion import SweepMotion, strokes_over
from smarttouch.instruments.relief import open_texture

from ..raising import raises
from .touched import object_file, touch


@pytest.fixture(scope="module")
def cross(tmp_path_factory, mouse, mouse_bank):
    """A cross, stroked over and back, and what came of it."""
    path = object_file(tmp_path_factory.mktemp("cross") / "o.png", "cross", (40, 20), (20.0, 10.0))
    texture = open_texture(str(path))
    options = strokes_over(texture.size_mm, mouse.electrodes.extent_mm)
    origin = options.pop("origin_mm")
    motion = SweepMotion(60.0, **options)
    motion.origin_mm = origin
    return texture, touch(texture, motion, mouse, mouse_bank)[0]


def test_what_is_drawn_looks_like_what_was_touched(cross):
    texture, touched = cross
    got = touched.drawing.picture((0.0, 0.0), (200, 400), 0.1).astype(float)
    drawn = texture.draw(0.0, 0.0, (200, 400), 0.1).astype(float)
    assert np.corrcoef(got.ravel(), drawn.ravel())[0, 1] > 0.8


def test_pulses_are_where_their_electrodes_were(cross, mouse):
    _, touched = cross
    felt = touched.felt
    poses = np.array([touched.poses_mm[each] for each in felt.number])
    np.testing.assert_allclose(
        felt.place_mm - poses, mouse.electrodes.position_mm[felt.electrode], atol=1e-9
    )
    assert (np.diff(felt.number.astype(int)) >= 0).all()


def test_the_sheet_shows_both(cross, tmp_path):
    _, touched = cross
    touched.drawing.save(tmp_path / "felt.png")
    sheet = 255.0 - np.asarray(Image.open(tmp_path / "felt.png").convert("L"), float)
    half = (sheet.shape[0] - 24) // 2
    above, below = sheet[52:half], sheet[52 + half : 2 * half]
    assert above.shape == below.shape
    assert np.corrcoef(above.ravel(), below.ravel())[0, 1] > 0.8
    path = tmp_path / "none" / "felt.png"
    with raises(SmartTouchError, names="file", value=path):
        touched.drawing.save(path)


def test_a_run_without_pulses_is_an_error(mouse, mouse_bank, tmp_path):
    empty = TexturePicture(mouse, mouse_bank, (Afferent.RA,), open_texture("grating:4mm"))
    empty.deliver(np.zeros(0, np.uint32), np.zeros(0, np.float32), np.zeros((0, 64), np.int16))
    assert (empty.picture((0.0, 0.0), (20, 20), 1.0) == 255).all()
    with raises(SmartTouchError):
        empty.save(tmp_path / "felt.png")
    assert not (tmp_path / "felt.png").exists()
