"""Every kind of image becomes the same page; every bad one gets one sentence."""

import struct
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, TiffImagePlugin

from smarttouch.documents.page_image import load_page
from smarttouch.errors import PageError


@pytest.fixture
def picture():
    grey = np.full((60, 80), 255, np.uint8)
    grey[20:40, 30:50] = 0
    return Image.fromarray(grey)


def transparent(image):
    rgba = image.convert("RGBA")
    pixels = np.array(rgba)
    pixels[..., 3] = np.where(pixels[..., 0] > 128, 0, 255)
    pixels[..., :3] = 0
    return Image.fromarray(pixels)


KINDS = {
    "grey": lambda image: image,
    "color": lambda image: image.convert("RGB"),
    "palette": lambda image: image.convert("P"),
    "two levels": lambda image: image.convert("1"),
    "16 bit": lambda image: Image.fromarray(np.asarray(image).astype(np.uint16) * 257),
    "alpha": transparent,
    "grey alpha": lambda image: image.convert("LA"),
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_gives_the_same_page(picture, tmp_path, kind):
    path = tmp_path / "page.png"
    KINDS[kind](picture).save(path)
    assert np.array_equal(load_page(path, dpi=300).grey, np.asarray(picture))


@pytest.mark.parametrize(("mode", "suffix"), [("CMYK", "tif"), ("F", "tif"), ("I", "tif")])
def test_tiff_kinds(picture, tmp_path, mode, suffix):
    path = tmp_path / f"page.{suffix}"
    picture.convert(mode).save(path)
    assert np.abs(load_page(path, dpi=300).grey.astype(int) - np.asarray(picture)).max() <= 1


def test_exif_orientation(picture, tmp_path):
    path = tmp_path / "page.jpg"
    exif = Image.Exif()
    exif[0x0112] = 6
    picture.save(path, exif=exif, quality=95)
    assert load_page(path, dpi=300).grey.shape == (80, 60)


@pytest.mark.parametrize("compression", [None, "tiff_lzw"])
def test_a_turned_tiff(picture, tmp_path, compression):
    path = tmp_path / "page.tif"
    turned = TiffImagePlugin.ImageFileDirectory_v2()
    turned[0x0112] = 6
    picture.save(path, tiffinfo=turned, compression=compression)
    assert np.array_equal(load_page(path, dpi=300).grey, np.rot90(picture, -1))


@pytest.mark.parametrize(
    ("stated", "shape", "mm_per_pixel"),
    [
        ((200, 100), (120, 80), 0.127),
        ((100, 200), (60, 160), 0.127),
        ((200, 199), (60, 80), 0.127),
    ],
)
def test_pixels_become_square(picture, tmp_path, stated, shape, mm_per_pixel):
    path = tmp_path / "page.tif"
    picture.save(path, dpi=stated)
    page = load_page(path)
    assert page.grey.shape == shape
    assert page.mm_per_pixel == pytest.approx(mm_per_pixel)
    ink = np.argwhere(page.grey < 128) * page.mm_per_pixel
    size_mm = [20 / each * 25.4 for each in reversed(stated)]
    assert np.ptp(ink, axis=0) + 0.127 == pytest.approx(size_mm, rel=0.02)


@pytest.mark.parametrize("stated", [(1000, 100), (300, 20), (72, 300)])
def test_resolutions_that_are_not_believed(picture, tmp_path, stated):
    path = tmp_path / "page.tif"
    picture.save(path, dpi=stated)
    with pytest.raises(PageError, match="does not say how large it is"):
        load_page(path)


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


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "no file"),
        (b"", "not an image"),
        (b"hello, I am a text", "not an image"),
        (png_header(60_000, 60_000), "above 100 megapixels"),
        (png_header(12_000, 12_000), "above the limit"),
        (png_header(0, 0), "0 x 0|cannot be read|not an image"),
        (png_header(1, 1), "1 x 1 pixels: a page needs at least 8 x 8"),
        (png_header(100, 100), "cannot be read"),
    ],
)
def test_bad_files(tmp_path, content, words):
    path = tmp_path / "page.png"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(PageError, match=words):
        load_page(path, dpi=300)


def test_a_folder(tmp_path):
    with pytest.raises(PageError, match="is a folder"):
        load_page(tmp_path)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "give --dpi or --page-width-mm"),
        ({"dpi": 300, "page_width_mm": 5}, "both given"),
        ({"dpi": 0}, "--dpi 0"),
        ({"dpi": float("nan")}, "--dpi nan"),
        ({"page_width_mm": -5}, "--page-width-mm -5"),
        ({"dpi": 0.1}, "would be"),
        ({"dpi": 1e5}, "would be"),
    ],
)
def test_bad_scales(picture, tmp_path, options, words):
    path = tmp_path / "page.png"
    picture.save(path)
    with pytest.raises(PageError, match=words) as caught:
        load_page(path, **options)
    assert "\n" not in str(caught.value)


@given(st.binary(max_size=300))
def test_no_bytes_crash_the_loader(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("fuzz") / "page.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + data)
    with pytest.raises(PageError):
        load_page(path, dpi=300)
