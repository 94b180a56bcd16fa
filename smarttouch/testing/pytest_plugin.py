"""Pytest fixture that replays your recordings: ``def test_it(replays): replays("run.mcap")``."""

from collections.abc import Callable

import pytest

# Rewrite asserts of the contracts, so that failures show the compared values.
pytest.register_assert_rewrite(
    *(f"smarttouch.testing.{module}" for module in ("driver_contract", "source_contracts"))
)


@pytest.fixture(scope="session")
def replays() -> Callable[..., None]:
    """Return a function that fails unless a replay reproduces all recorded sequences exactly.

    Call it with the path of a recording, and options of
    `smarttouch.running.replay_check.check_recording`.
    """

    def assert_it_replays(path: str, **same: object) -> None:
        __tracebackhide__ = True
        from smarttouch.running.replay_check import assert_replays

        assert_replays(path, **same)

    return assert_it_replays
