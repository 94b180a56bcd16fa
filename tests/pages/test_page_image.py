"""Pages have the scale of their image, upright; every bad image gets one sentence."""

import math
import struct
import zlib

import numpy as np
import pytest
from PIL import Image, TiffImagePlugin

from smarttouch.base.errors import PageError
from smarttouch.pages.document import open_document

from ..raising import raises


def load_page(path, **options):
    with open_document(path, **options) as document:
        return document.page(0)


@pytest.fixture
def picture():
    grey = np.full((60, 80), 255, np.uint8)
    grey[20:40, 30:50] = 0
    return Image.fromarray(grey)


@pytest.mark.parametrize("compression", [None, "tiff_lzw"])
def test_a_turned_tiff(picture, tmp_path, compression):
    path = tmp_path / "page.tif"
    turned = TiffImagePlugin.ImageFileDirectory_v2()
    turned[0x0112] = 6
    picture.save(path, tiffinfo=turned, compression=compression)
    assert np.array_equal(load_page(path, dpi=300).grey, np.rot90(picture, -1))


@pytest.mark.parametrize(("stated", "shape"), [
    ((200, 100), (120, 80)), ((100, 200), (60, 160)), ((200, 199), (60, 80)),
])  # fmt: skip
def test_pixels_become_square(picture, tmp_path, stated, shape):
    path = tmp_path / "page.tif"
    picture.save(path, dpi=stated)
    page = load_page(path)
    assert page.grey.shape == shape
    assert page.mm_per_pixel == pytest.approx(0.127)
    ink = np.argwhere(page.grey < 128) * page.mm_per_pixel
    size_mm = [20 / each * 25.4 for each in reversed(stated)]
    assert np.ptp(ink, axis=0) + 0.127 == pytest.approx(size_mm, rel=0.02)


@pytest.mark.parametrize("stated", [(1000, 100), (300, 20), (72, 300)])
def test_resolutions_that_are_not_believed(picture, tmp_path, stated):
    path = tmp_path / "page.tif"
    picture.save(path, dpi=stated)
    with open_document(path) as document:
        document.page(0)
    assert len(document.notes) == 1


def test_scale(picture, tmp_path):
    path = tmp_path / "page.png"
    picture.save(path, dpi=(254, 254))
    assert load_page(path).mm_per_pixel == pytest.approx(0.1, rel=1e-3)
    assert load_page(path, dpi=127).mm_per_pixel == pytest.approx(0.2)
    assert load_page(path, page_width_mm=40).mm_per_pixel == pytest.approx(0.5)


def png_header(width, height):
    body = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    chunk = struct.pack(">I", 13) + b"IHDR" + body + struct.pack(">I", zlib.crc32(b"IHDR" + body))
    return b"\x89PNG\r\n\x1a\n" + chunk + struct.pack(">I", 0) + b"IDAT" + b"\0\0\0\0"


# Pillow has its own mind of an image without pixels, by version.
@pytest.mark.parametrize("side", [0, 100])
def test_images_of_which_nothing_comes(tmp_path, side):
    path = tmp_path / "page.png"
    path.write_bytes(png_header(side, side))
    with raises(PageError, value=path):
        load_page(path, dpi=300)


@pytest.mark.parametrize(("side", "value", "allowed"), [
    # So large that Pillow does not even tell how large.
    (60_000, None, 10**8),
    (12_000, (12_000, 12_000), 10**8),
    (1, (1, 1), (8, 8)),
])  # fmt: skip
def test_too_many_and_too_few_pixels(tmp_path, side, value, allowed):
    path = tmp_path / "page.png"
    path.write_bytes(png_header(side, side))
    pixels = {"value": value, "allowed": allowed}
    with raises(PageError, names="pixels", **pixels) as caught:
        load_page(path, dpi=300)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(("options", "about", "value"), [
    ({"dpi": 300, "page_width_mm": 5}, "dpi", ("dpi", "page_width_mm")),
    ({"dpi": 0}, "dpi", 0),
    ({"dpi": math.nan}, "dpi", math.nan),
    ({"page_width_mm": -5}, "page_width_mm", -5),
    ({"dpi": 0.1}, "size_mm", pytest.approx((20_320, 15_240))),
    ({"dpi": 1e5}, "size_mm", pytest.approx((0.02032, 0.01524))),
])  # fmt: skip
def test_bad_scales(picture, tmp_path, options, about, value):
    path = tmp_path / "page.png"
    picture.save(path)
    with raises(PageError, value=value):
        load_page(path, **options)
