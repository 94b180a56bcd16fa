"""Pages at the nerve by two observers: the study in short."""

import json
from dataclasses import replace

import numpy as np
import pytest
from studies.reading_pages import (
    BEFORE,
    OBSERVERS,
    PageRow,
    Setting,
    profile,
    rows_of,
    step_by_spikes,
    table,
    with_interval,
    worst,
)

from smarttouch.base.errors import ReadingError


@pytest.mark.parametrize("step_mm", [0.25, 0.5, 1.0])
def test_the_speed_is_known_from_what_passes_from_column_to_column(step_mm):
    electrodes, random = profile().electrodes, np.random.default_rng(1)
    line = np.repeat(random.random((8, 40)) < 0.4, 2, axis=1)
    row = np.rint(electrodes.position_mm[:, 1] / 2 + 3.5).astype(int)
    values = []
    for x_mm in np.arange(10, 60, step_mm):
        at = np.rint(electrodes.position_mm[:, 0] + x_mm).astype(int)
        values.append(line[row, np.clip(at, 0, 79)].astype(np.float32))
    assert step_by_spikes(np.array(values)) == pytest.approx(step_mm, rel=0.1)


def test_a_page_is_read_and_kept(tmp_path):
    kept, setting = tmp_path / "pages.jsonl", replace(BEFORE, size=0.75)
    try:
        rows = rows_of(kept, "text:a quiet place indeed", "paper", (1,), setting)
    except ReadingError as error:
        if "Tesseract" in str(error):
            pytest.skip(str(error))
        raise
    assert set(rows[0].errors) > set(OBSERVERS)
    assert all(error >= 0 for error in rows[0].errors.values())
    assert 0 <= rows[0].silent_points <= 1
    assert len(kept.read_text().splitlines()) == 1
    assert [
        json.dumps(each.errors)
        for each in rows_of(kept, "text:a quiet place indeed", "paper", (1,), setting)
    ] == [json.dumps(rows[0].errors)]
    assert len(list(table(rows))) == 1


def test_the_worse_anatomy_counts():
    def row(anatomy, setting, error):
        return PageRow("page", anatomy, 1, setting, {OBSERVERS[0]: error}, 0.0, 0.0, 0.0)

    full, less = Setting(), Setting(0.7)
    rows = [row("paper", full, 0.0), row("branched", full, 1.0), row("paper", less, 0.2)]
    assert worst([*rows, row("branched", less, 0.1)]) == {full: 1.0, less: 0.2}


def test_medians_have_intervals():
    assert with_interval([0.5]) == "0.50"
    assert with_interval([0.0, 0.1, 0.2, 0.3]).startswith("0.15 (0.0")
