"""Image files of any kind give the same gray levels, as a page and as a frame."""

import io
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image, TiffImagePlugin

from smarttouch.imaging.grey_image import GreyConverter
from smarttouch.pages.document import Document
from smarttouch.sources import open_source

PRINT = np.full((60, 160), 255, np.uint8)
cv2.putText(PRINT, "mill 42", (8, 42), cv2.FONT_HERSHEY_SIMPLEX, 1.1, 0, 2, cv2.LINE_AA)
INK = 255 - PRINT


def deep(bits, color=False, picture=PRINT):
    """Return a function that writes the sample print in 16-bit pixels, with ``bits`` used bits."""

    def write(path):
        levels = np.rint(picture * ((2**bits - 1) / 255)).astype(np.uint16)
        cv2.imwrite(str(path), np.dstack([levels] * 3) if color else levels)

    return write


def pillow(make, **options):
    return lambda path: make().save(path, **options)


def on_transparent(*colors):
    """Return a function that makes print in these colors, side by side, on transparent ground."""

    def make():
        pixels = np.zeros((*PRINT.shape, 4), np.uint8)
        for part, color in zip(np.array_split(pixels, len(colors), axis=1), colors, strict=True):
            part[..., :3] = color
        pixels[..., 3] = INK
        return Image.fromarray(pixels)

    return make


def clear_palette():
    """Return white print in a palette image, whose palette entry 0 is saved as transparent."""
    image = Image.fromarray((INK > 127).astype(np.uint8), "P")
    image.putpalette([0, 0, 0, 255, 255, 255])
    return image


def turned(values, orientation):
    exif = Image.Exif()
    exif[0x0112] = orientation
    return lambda path: Image.fromarray(values).save(path, exif=exif, lossless=True, quality=95)


def deep_and_turned(path):
    """Write a rotated 16-bit color PNG, with an eXIf chunk that states its orientation."""
    deep(16, color=True, picture=np.rot90(PRINT))(path)
    exif = Image.Exif()
    exif[0x0112] = 6
    chunk = b"eXIf" + exif.tobytes()[6:]
    head, data = path.read_bytes()[:33], path.read_bytes()[33:]
    size, crc = len(chunk) - 4, zlib.crc32(chunk)
    path.write_bytes(head + size.to_bytes(4, "big") + chunk + crc.to_bytes(4, "big") + data)


def deep_on_clear(path):
    cv2.imwrite(str(path), np.dstack([np.zeros_like(INK)] * 3 + [INK]).astype(np.uint16) * 257)


def white_is_zero(path):
    """Write a TIFF with 12-bit levels in 16-bit pixels, in which 0 is white."""
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[262] = 0
    Image.fromarray(INK.astype(np.uint16) * 16).save(path, tiffinfo=tags)


def animation(path):
    first = Image.fromarray(PRINT)
    first.save(path, save_all=True, append_images=[Image.fromarray(INK)], duration=40)


HIGHLIGHT = PRINT / 255.0
HIGHLIGHT[:3, :3] = 1.3

KINDS = {
    **{f"deep-{bits}.png": deep(bits) for bits in (9, 10, 12, 16)},
    **{f"color-{bits}.{kind}": deep(bits, color=True)
       for bits, kind in ((10, "png"), (12, "tif"), (16, "png"))},
    "color-on-its-side.png": deep_and_turned,
    "deep-on-clear.png": deep_on_clear,
    "white-is-zero.tif": white_is_zero,
    "float-1.tif": pillow(lambda: Image.fromarray(np.float32(PRINT / 255))),
    "float-255.tif": pillow(lambda: Image.fromarray(np.float32(PRINT))),
    "float-signed.tif": pillow(lambda: Image.fromarray(np.float32(PRINT / 127.5 - 1))),
    "float-highlight.tif": pillow(lambda: Image.fromarray(np.float32(HIGHLIGHT))),
    "float-hole.tif": pillow(
        lambda: Image.fromarray(np.where(PRINT < 1, np.nan, PRINT).astype(np.float32))
    ),
    **{f"{mode}.tif": pillow(lambda mode=mode: Image.fromarray(PRINT).convert(mode))
       for mode in ("L", "RGB", "CMYK", "I", "F")},
    "two-levels.png": pillow(lambda: Image.fromarray(PRINT > 127)),
    "grey-alpha.png": pillow(lambda: Image.fromarray(PRINT).convert("LA")),
    "on-its-side.jpg": turned(np.rot90(PRINT), 6),
    "palette.png": pillow(lambda: Image.fromarray(PRINT).convert("P")),
    "palette-clear.png": pillow(clear_palette, transparency=0),
    "black-on-clear.png": pillow(on_transparent((0, 0, 0))),
    "white-on-clear.png": pillow(on_transparent((255, 255, 255))),
    "pale-on-clear.webp": pillow(on_transparent((240, 240, 250)), lossless=True, exact=True),
    "both-on-clear.png": pillow(on_transparent((255, 255, 255), (0, 0, 0))),
    "cut-out.png": pillow(lambda: Image.fromarray(np.dstack([INK | 255] * 3 + [PRINT]))),
    "upside-down.png": turned(PRINT[::-1, ::-1], 3),
    "upside-down.webp": turned(PRINT[::-1, ::-1], 3),
    "on-its-side.png": turned(np.rot90(PRINT), 6),
    "animation.gif": animation,
    "animation.webp": lambda path: animation(path),
}  # fmt: skip


@pytest.mark.parametrize("name", KINDS)
def test_a_page_and_a_frame_of_any_kind(profile, tmp_path, name):
    KINDS[name](tmp_path / name)
    with Document(tmp_path / name, dpi=150) as document:
        page = document.page(0).grey
        assert len(document) == 1
    with open_source(f"frames:{tmp_path}", profile, unpaced=True) as source:
        frame = source.read(0).image
    np.testing.assert_array_equal(page, frame)
    assert page.shape == PRINT.shape
    # Palettes and lossy formats do not keep all gray levels.
    coarse = ("palette", "two-levels", "animation", "on-its-side.jpg")
    most = 128 if name.startswith(coarse) else 2
    assert np.abs(page.astype(int) - PRINT).max() <= most


@pytest.mark.parametrize(("ink", "ground"), [
    ((200, 60, 60), (60, 140, 60)), ((220, 30, 30), (87, 87, 87)), ((255, 255, 0), (255, 255, 255)),
    ((0, 0, 0), (255, 255, 255)), ((40, 90, 200), (130, 60, 70)),
])  # fmt: skip
def test_print_of_any_color_is_seen(ink, ground):
    share = INK[..., None] / 255
    grey = GreyConverter().convert(np.rint(share * ink + (1 - share) * ground).astype(np.uint8))
    largest = np.abs(np.subtract(ink, ground)).max()
    assert abs(int(grey[INK == 255].mean()) - int(grey[INK == 0].mean())) >= 0.4 * largest
    assert abs(np.corrcoef(grey.ravel(), INK.ravel())[0, 1]) > 0.99


def test_print_of_several_colors_is_seen():
    """Luma would reduce the contrast of the yellow print from 205 to 45 levels."""
    colors = [(0, 0, 0), (230, 57, 57), (140, 200, 255), (255, 218, 50)]
    share = INK[..., None] / 255
    lines = [np.rint(255 - share * np.subtract(255, color)) for color in colors]
    grey = GreyConverter().convert(np.vstack(lines).astype(np.uint8))
    for color, line in zip(colors, np.array_split(grey, len(colors)), strict=True):
        assert 255 - int(line[INK == 255].mean()) >= 0.4 * (255 - min(color))


def test_black_print_below_a_marker_stays_legible():
    yellow = np.dstack([PRINT, PRINT, np.where(np.arange(60)[:, None] < 50, 0, PRINT)])
    pale = np.full((40, 160, 3), 255, np.uint8)
    pale[10:30, 10:150] = (255, 225, 60)
    grey = GreyConverter().convert(np.vstack([yellow, pale]).astype(np.uint8))
    assert grey[:40][PRINT[:40] == 255].min() - int(grey[:40][PRINT[:40] == 0].max()) > 100


def test_luma_where_it_shows_all():
    red = np.dstack([np.full_like(PRINT, 255), PRINT, PRINT])
    np.testing.assert_array_equal(
        GreyConverter().convert(red), cv2.cvtColor(red, cv2.COLOR_RGB2GRAY)
    )


def test_colors_of_16_bits_are_those_of_8(tmp_path):
    red = np.dstack([PRINT, PRINT, np.full_like(PRINT, 255)])
    greys = []
    for kind, levels in ((np.uint8, 1), (np.uint16, 257)):
        cv2.imwrite(str(tmp_path / "red.png"), red.astype(kind) * kind(levels))
        with Document(tmp_path / "red.png", dpi=150) as document:
            greys.append(document.page(0).grey)
    np.testing.assert_array_equal(*greys)


def test_each_page_of_16_bits_in_color(tmp_path):
    levels = [np.dstack([each.astype(np.uint16) * 257] * 3) for each in (PRINT, INK)]
    cv2.imwritemulti(str(tmp_path / "pages.tif"), levels)
    with Document(tmp_path / "pages.tif", dpi=150) as document:
        np.testing.assert_array_equal([document.page(k).grey for k in (0, 1)], [PRINT, INK])


def test_colors_that_nobody_sees_do_not_count():
    red = np.dstack([np.full_like(PRINT, 255), PRINT, PRINT, np.full_like(PRINT, 255)])
    hidden = np.where(INK[..., None] > 127, (200, 60, 60, 0), (60, 140, 60, 0))
    grey = GreyConverter().convert(np.vstack([red, *[hidden] * 9]).astype(np.uint8))
    np.testing.assert_array_equal(grey[: len(PRINT)], GreyConverter().convert(red[..., :3]))


@pytest.mark.parametrize("light", [True, False])
@pytest.mark.parametrize("around", [4, 200])
def test_a_picture_with_print_goes_on_around_itself(light, around):
    """A transparent border of any width gets the background of the picture inside."""
    window = np.dstack([PRINT if light else INK] * 3 + [np.full_like(PRINT, 255)])
    grey = GreyConverter().convert(np.pad(window, ((around, around), (around, around), (0, 0))))
    assert (grey[:around] == (255 if light else 0)).all()
    np.testing.assert_array_equal(grey[around:-around, around:-around], window[..., 0])


def test_frames_stay_comparable():
    """A brighter image raises the white level, which never falls: darker images stay darker."""
    converter = GreyConverter()
    levels = [
        int(converter.convert(np.full((8, 8), level, np.uint16)).max())
        for level in (1000, 500, 4000, 1000)
    ]
    assert levels == [249, 125, 249, 62]


def test_frames_keep_their_ground():
    """The second frame is mostly print; the background of the first frame is still used."""
    converter = GreyConverter()
    for alpha, grey in ((INK, PRINT), (PRINT, INK)):
        clear = np.dstack([np.zeros_like(INK), alpha])
        np.testing.assert_array_equal(converter.convert(clear), grey)


@given(
    hnp.arrays(
        st.sampled_from([np.uint8, np.uint16, np.int16, np.int32, np.float32, np.bool_]),
        hnp.array_shapes(min_dims=2, max_dims=2, max_side=20).flatmap(
            lambda shape: st.sampled_from([shape, *[(*shape, depth) for depth in (1, 2, 3, 4)]])
        ),
    )
)
@example(np.float32([[1.1754944e-38]]))
@example(np.float32([[-1.1754944e-38, 0]]))
@example(np.float32([[-3e38, 3e38]]))
def test_no_pixels_are_too_much(pixels):
    grey = GreyConverter().convert(pixels)
    assert grey.dtype == np.uint8
    assert grey.shape == pixels.shape[:2]


@pytest.mark.parametrize(("kinds", "pages"), [
    ([2, 2], [0, 1]), ([0, 1, 1], [0]), ([2, 4, 2], [0, 2]), ([1, 1], [0, 1]), ([None], [0]),
])  # fmt: skip
def test_copies_and_masks_of_a_tiff_are_no_pages(tmp_path, kinds, pages):
    """Bits of NewSubfileType mark images: 1 for a thumbnail, 2 for a page, 4 for a mask."""
    path, data = tmp_path / "pages.tif", io.BytesIO()
    # Write to memory: given a path, Pillow's writer seeks in a file that it has closed.
    with TiffImagePlugin.AppendingTiffWriter(data, True) as file:
        for number, kind in enumerate(kinds):
            tags = TiffImagePlugin.ImageFileDirectory_v2()
            if kind is not None:
                tags[254] = kind
            Image.new("L", (40, 30), 10 * number).save(file, "tiff", tiffinfo=tags)
            file.newFrame()
    path.write_bytes(data.getvalue())
    with Document(path, dpi=100) as document:
        assert [int(document.page(index).grey[0, 0]) for index in range(len(document))] == [
            10 * number for number in pages
        ]
