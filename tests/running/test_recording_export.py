"""Files written for other programs hold what was recorded."""

import csv
import re
from pathlib import Path

import cv2
import numpy as np

from smarttouch.base.errors import RecordingError
from smarttouch.running.recording_files import export, is_sound, repair
from smarttouch.running.recording_reader import Recording

from ..raising import raises


def table(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_all_is_written(tmp_path, golden):
    path = golden("regulated")
    steps = list(Recording(path).steps())
    folder = tmp_path / "out" / "run"
    written = export(path, folder)
    assert {each.name for each in written} == {each.name for each in folder.iterdir()}
    rows, events = (table(folder / f"{name}.csv") for name in ("steps", "events"))
    assert len(rows) == len(steps)
    for row, recorded in zip(rows, steps, strict=True):
        assert float(row["force_n"]) == recorded.step.input.force_n
        image = cv2.imread(str(folder / row["image"]), cv2.IMREAD_UNCHANGED)
        assert np.array_equal(image, recorded.step.input.image)
    assert len(list((folder / "frames").iterdir())) == len({row["image"] for row in rows})
    assert [row["sent"] for row in rows].count("-1") == 1
    words = [words for _, words in Recording(path).events()]
    assert words
    assert [row["words"] for row in events] == words
    with np.load(folder / "run.npz") as arrays:
        assert arrays["activation"].shape == (len(steps), 3, 64)
        for index, recorded in enumerate(steps):
            slots = slice(*arrays["first_slot"][index : index + 2])
            was = recorded.step.sequence
            assert np.array_equal(arrays["current_ua"][slots], was.current_ua)
            assert np.array_equal(arrays["site"][slots], was.site)
            assert int(rows[index]["slots"]) == was.slots
        measured = sum(len(recorded.step.observed) for recorded in steps)
        assert len(arrays["volts_step"]) == measured > 3
        assert len(arrays["volts"]) == sum(
            len(volts) for recorded in steps for _, volts in recorded.step.observed
        )


PAGE = Path(__file__).parents[2] / "docs/reference/recorded-data.md"


def described():
    """Return shape and type of each array, as the page has them."""
    rows = re.findall(r"^\| `(\w+)` \| \(([^)]*)\) (\w+) \|", PAGE.read_text("utf-8"), re.MULTILINE)
    return {name: (shape.replace(" ", ""), kind) for name, shape, kind in rows}


def test_the_page_describes_what_is_exported(tmp_path, golden):
    """Each array with shape and type, and each column."""
    path = golden("regulated")
    export(path, tmp_path / "out")
    page = described()
    with np.load(tmp_path / "out" / "run.npz") as arrays:
        found = dict(arrays)
    assert {*found} == {*page}
    sizes = {
        "N": len(found["step"]), "N+1": len(found["step"]) + 1, "S": len(found["site"]),
        "E": 64, "V": len(found["volts"]), "M": len(found["volts_step"]), "3": 3,
    }  # fmt: skip
    for name, array in found.items():
        shape, kind = page[name]
        assert array.shape == tuple(sizes[each] for each in shape.split(",") if each)
        assert ("str" if array.dtype.kind == "U" else array.dtype.name) == kind
    columns = {name for name, (shape, _) in page.items() if shape == "N,"}
    with (tmp_path / "out" / "steps.csv").open(newline="") as file:
        header = next(csv.reader(file))
    assert {*header} == columns | {"slots", "strongest_ua", "image"}


def test_nothing_is_overwritten(tmp_path, recording):
    (tmp_path / "mine.txt").write_text("precious")
    with raises(RecordingError, about="file", value=tmp_path):
        export(recording, tmp_path)
    with raises(RecordingError, about="file", value=tmp_path / "mine.txt"):
        export(recording, tmp_path / "mine.txt")
    (tmp_path / "run-repaired.mcap").write_text("precious")
    (tmp_path / "run.mcap").write_bytes(recording.read_bytes()[:-100])
    with raises(
        RecordingError, about="file", value=tmp_path / "run-repaired.mcap", remedy="output"
    ):
        repair(tmp_path / "run.mcap")
    assert (tmp_path / "run-repaired.mcap").read_text() == "precious"


def test_an_empty_recording_is_exported(tmp_path, record):
    export(record(tmp_path / "run.mcap", [], ["stopped"]), tmp_path / "out")
    assert table(tmp_path / "out" / "steps.csv") == []
    assert table(tmp_path / "out" / "events.csv") == [{"time_ns": "5000000", "words": "stopped"}]


def test_a_damaged_one_is_repaired_without_its_damage(tmp_path, recording, damaged):
    path = tmp_path / "run.mcap"
    path.write_bytes(damaged)
    assert is_sound(recording)
    assert not is_sound(path)
    mended = repair(path, tmp_path / "new.mcap")
    assert mended.damaged_chunks == 1
    assert is_sound(mended.path)
    assert [each.index for each in Recording(mended.path).steps()] == [
        each.index for each in Recording(path).steps()
    ]
    assert Recording(mended.path).about["repaired_from"] == "run.mcap"
