"""Paths of the data that ships with the package."""

from pathlib import Path


def data_folder(name: str) -> Path:
    """Return a shipped data folder, ``calibration`` or ``sample_images``.

    A wheel has the folders inside the package; in a checkout they lie beside it.
    """
    from importlib.resources import files

    package = Path(str(files("smarttouch"))).resolve()
    inside = package / name
    return inside if inside.is_dir() else package.parent / name
