"""Opening of textures by name, file or text."""

import re
from pathlib import Path

from smarttouch.errors import PageError
from smarttouch.texture.grating import Grating
from smarttouch.texture.relief import Relief
from smarttouch.texture.relief_file import load_heights, print_heights
from smarttouch.texture.texture import Texture
from smarttouch.url_options import joined_options, read_options

_NUMBER = r"([0-9]*\.?[0-9]+)"


def open_texture(
    spec: str,
    *,
    # dpi, width_mm: scale of a file that does not say; width of a text
    dpi: float | None = None,
    width_mm: float | None = None,
    # way between two pulses on what is high and wide; measured if not given
    grain_mm: float | None = None,
    tiled: bool = False,  # repeat it without end
    light_on_dark: bool = False,  # whether bright parts are high
) -> Texture:
    """Open a texture: a grating, a text, an image or a height map.

    ``grating:4mm``, ``grating:4mm,30deg``, ``text:STRING``, or a file: an image (ink is high), or a
    height map (16 bits or floating point, or .npy: bright is high). Options may stand behind it, as
    in ``wood.png?dpi=300&tiled``.
    """
    place, in_url = read_options(open_texture, spec, PageError)
    if in_url:
        given = {
            "dpi": dpi, "width_mm": width_mm, "grain_mm": grain_mm, "tiled": tiled or None,
            "light_on_dark": light_on_dark or None,
        }  # fmt: skip
        given = {name: value for name, value in given.items() if value is not None}
        return open_texture(place, **joined_options(spec, given, in_url, PageError))
    kind, _, rest = spec.partition(":")
    if kind == "grating" and ":" in spec:
        given = {
            "dpi": dpi, "width_mm": width_mm, "grain_mm": grain_mm, "tiled": tiled,
            "light_on_dark": light_on_dark,
        }  # fmt: skip
        for name, value in given.items():
            if value:
                message = f"{name} is for images, and {spec} is exact: leave it out"
                raise PageError(message, about=name)
        return _grating(spec, rest)
    if kind == "text" and ":" in spec:
        if dpi is not None:
            message = "dpi is for images, and a text has no resolution of its own: give its width"
            raise PageError(message, about="dpi", remedy="width_mm")
        heights = print_heights(rest, width_mm)
    else:
        heights = load_heights(Path(spec), dpi, width_mm)
    return Relief(heights, grain_mm, tiled, light_on_dark)


def _grating(spec: str, rest: str) -> Texture:
    match = re.fullmatch(rf"\s*{_NUMBER}\s*(mm)?\s*(,\s*([-+]?){_NUMBER}\s*(deg|°)?)?\s*", rest)
    if match is None:
        message = f"{spec!r} is no grating: write grating:4mm or grating:4mm,30deg"
        raise PageError(message, about="grating")
    pitch_mm, sign, angle = float(match[1]), match[4], float(match[5] or 0)
    return Grating(pitch_mm, -angle if sign == "-" else angle)
