"""Order of programs within a section of the gallery: as `docs/gallery.md` names them."""

import re
from pathlib import Path

ORDER = re.findall(r"examples/(\w+)\.py", (Path(__file__).parents[1] / "gallery.md").read_text())


def position(path: str) -> int:
    """Return the place of a program; one that the page lacks is an error of the build."""
    return ORDER.index(Path(path).stem)
