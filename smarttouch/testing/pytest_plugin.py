"""Pytest fixture for a user's own recordings: ``def test_it(replays): replays("run.mcap")``."""

from collections.abc import Callable

import pytest

# Let failed asserts of the contracts show the compared values.
pytest.register_assert_rewrite(
    *(f"smarttouch.testing.{module}" for module in ("driver_contract", "source_contracts"))
)


@pytest.fixture(scope="session")
def replays() -> Callable[..., None]:
    """Return a function that fails unless a recording's sequences are reproduced exactly.

    Its arguments are the path of a recording, and options of
    `smarttouch.running.check_recording.check_recording`.
    """

    def assert_it_replays(path: str, **same: object) -> None:
        __tracebackhide__ = True
        from smarttouch.running.check_recording import assert_replays

        assert_replays(path, **same)

    return assert_it_replays
