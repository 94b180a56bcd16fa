"""Style of all figures: colors that color-blind readers can distinguish, axes and file formats."""

import sys
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smarttouch.base.errors import SmartTouchError, import_extra
from smarttouch.base.files import write_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CATHODIC, ANODIC = "#b35806", "#542788"  # ends of Matplotlib's color map PuOr
SIGNED_MAP = "PuOr_r"  # orange: cathodic or depolarizing; purple: the opposite
GREY = "#707070"
SERIES_COLORS = ("#d55e00", "#009e73", "#0072b2", "#cc79a7", "#e69f00", "#56b4e9")
"""Colors of Okabe and Ito's set (2008); the first two also mark RA and PC."""
DPI = 200

FORMATS = ("png", "pdf", "svg")


def new_figure(width_in: float, height_in: float) -> "Figure":
    """Return an empty figure. If pyplot is imported, use pyplot: notebooks show its figures."""
    plain: Any = import_extra("matplotlib.figure", "a figure", "plot").Figure
    pyplot = sys.modules.get("matplotlib.pyplot")
    figure: Figure = (plain if pyplot is None else pyplot.figure)(
        figsize=(width_in, height_in), layout="constrained"
    )
    return figure


def require_drawable(path: Path) -> None:
    """Raise SmartTouchError if the file format is unknown or matplotlib is missing."""
    if path.suffix.lower().lstrip(".") not in FORMATS:
        raise SmartTouchError(f"cannot draw {path}: its name must end in .{' or .'.join(FORMATS)}")
    new_figure(1, 1)


def plain(axes: Any, title: str = "", x: str = "", y: str = "") -> None:
    """Label axes, and hide the upper and right spines."""
    axes.set_title(title, loc="left", fontsize=9, pad=9)
    axes.set_xlabel(x, fontsize=8)
    axes.set_ylabel(y, fontsize=8)
    axes.tick_params(labelsize=7)
    axes.spines[["top", "right"]].set_visible(False)


def save(figure: "Figure", path: Path) -> None:
    """Write a figure in the format that the file extension names."""
    require_drawable(path)
    from matplotlib import rc_context

    content = BytesIO()
    with rc_context({"svg.fonttype": "none"}):  # keep text searchable and editable
        figure.savefig(content, dpi=DPI, format=path.suffix.removeprefix("."))
    write_bytes(path, content.getvalue())
