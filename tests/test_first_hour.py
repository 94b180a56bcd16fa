"""The first hour of docs/tutorial, step by step, as a reader would go through it."""

import os

import pytest

from .documented import ROOT, Reader
from .forks import Forked
from .whole import WHOLE

pytestmark = pytest.mark.usefixtures("patient_boards")


@pytest.mark.skipif(
    not WHOLE and "SMARTTOUCH_EXAMPLES" not in os.environ,
    reason="long: with SMARTTOUCH_WHOLE=1, as in .ci/run",
)
def test_every_step_works(tmp_path):
    reader = Reader(tmp_path, Forked)
    reader.read(ROOT / "docs" / "tutorial" / "first-hour.md")
    assert len(reader.done) >= 8
    assert reader.not_run == []
    made = tmp_path / "first-hour"
    assert (made / "felt.png").stat().st_size > 5_000
    assert (made / "hello.mcap").stat().st_size > 10_000
