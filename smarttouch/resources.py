"""Paths of the data that ships with the package."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def data_folder(name: str) -> Path:
    """Return a shipped data folder, ``calibration`` or ``sample_images``.

    A wheel carries the folders inside the package; in a checkout (an editable
    install) they lie beside it.
    """
    inside = _PACKAGE / name
    return inside if inside.is_dir() else _PACKAGE.parent / name
