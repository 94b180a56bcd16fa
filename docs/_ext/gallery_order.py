"""Sort key for the programs of the gallery: their order in `docs/gallery.md`."""

import re
from pathlib import Path

ORDER = re.findall(r"examples/(\w+)\.py", (Path(__file__).parents[1] / "gallery.md").read_text())


def position(path: str) -> int:
    """Return the index of a program in `ORDER`, or raise ValueError, which fails the build."""
    return ORDER.index(Path(path).stem)
