"""Files that pages name and do not make: each is made when a command first names it."""

import re
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from smarttouch import Recorder, load_profile, open_display, open_source, run
from smarttouch.base.files import data_folder

WORDS = "A few words, to be read."


def make_named(text: str, folder: Path) -> None:
    """Make those files in a folder that a text names, and that are not there."""
    for name, make in FILES.items():
        path = folder / name
        if re.search(rf"(?<![\w./-]){re.escape(name)}", text) and not path.exists():
            path.parent.mkdir(exist_ok=True)
            make(path)


def _page(path: Path) -> None:
    grey = cv2.imread(str(data_folder("sample_images") / "photo.png"), cv2.IMREAD_GRAYSCALE)
    Image.fromarray(grey).save(path, dpi=(300, 300))


def _experiment(path: Path) -> None:
    example = Path(__file__).parent.parent / "examples/own_experiment.py"
    path.write_text(example.read_text("utf-8"), "utf-8")


def _book(path: Path) -> None:
    page = Image.open(data_folder("sample_images") / "page.png").convert("L")
    page.save(path, save_all=True, append_images=[page] * 4)


def _clip(path: Path) -> None:
    video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 30, (64, 64))
    for number in range(60):
        image = np.full((64, 64, 3), 255, np.uint8)
        image[:, number : number + 8] = 0
        video.write(image)
    video.release()


def _motion(path: Path) -> None:
    times_s = np.arange(0, 1, 0.001)
    rows = (f"{t:.3f},{8 * np.sin(60 * np.pi * t):.3f},0.3" for t in times_s)
    path.write_text("\n".join(["time_s,displacement_um,force_n", *rows]) + "\n", encoding="utf-8")


def _recording(path: Path) -> None:
    profile = load_profile("electric-mouse")
    with open_source("text:a", profile) as source, open_display("simulated:", profile) as display:
        run(source, display, seconds=0.3, listeners=[Recorder(path)])


def _array(path: Path) -> None:
    places = [f"{2 * (at % 8)},{2 * (at // 8)}" for at in range(64)]
    path.write_text("\n".join(["x_mm,y_mm", *places]) + "\n", "utf-8")


FILES = {
    "array.csv": _array,
    "gap.py": _experiment,
    "photo.jpg": _page,
    "scan.png": _page,
    "scan.tif": _page,
    "cloth.png": _page,
    "photo.txt": lambda path: path.write_text(WORDS, encoding="utf-8"),
    "book.pdf": _book,
    "clip.mp4": _clip,
    "recorded.csv": _motion,
    "recordings/line-1.mcap": _recording,
}
