"""Every kind of image becomes the same page; every bad one gets one sentence."""

import struct
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from smarttouch.errors import PageError
from smarttouch.pages.page_image import load_page, print_text


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


def test_printed_text():
    page = print_text("Touch\nthis")
    ink = (page.grey < 128).any(axis=1)
    assert np.count_nonzero(np.diff(ink.astype(int)) == 1) == 2
    assert page.size_mm[0] == pytest.approx(92, abs=0.1)


@pytest.mark.parametrize("text", ["", "  ", "\n\n"])
def test_nothing_to_print(text):
    with pytest.raises(PageError, match="nothing to print"):
        print_text(text)
