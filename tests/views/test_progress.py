"""What is left is estimated from what is done, and counts down between two steps."""

from types import SimpleNamespace

import pytest

from smarttouch.views.progress import _TimeLeft


@pytest.mark.parametrize(("completed", "done_s", "elapsed", "words"), [
    (0, 0.0, 7.0, "…"), (10, 20.0, 20.0, "about 3:00 left"), (10, 20.0, 81.0, "about 1:59 left"),
    (10, 20.0, 260.0, "soon done"),
])  # fmt: skip
def test_time_left(completed, done_s, elapsed, words):
    task = SimpleNamespace(
        completed=completed, total=100, elapsed=elapsed, fields={"done_s": done_s}
    )
    assert _TimeLeft().render(task).plain == words
