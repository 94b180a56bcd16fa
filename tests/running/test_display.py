"""A display that was stopped stays at zero, whoever drives its board."""

import pytest

import smarttouch as st
from smarttouch.base.errors import BoardStoppedError


@pytest.mark.parametrize(
    "url", ["memory:", "simulated:", "link:/dev/null", "etactilekit:/dev/null"]
)
@pytest.mark.parametrize("stop", [st.Display.stop, lambda display: display.stopping.ask("a key")])
def test_one_that_was_stopped_opens_no_more(url, stop):
    display = st.open_display(url)
    stop(display)
    for _ in range(2):
        with pytest.raises(BoardStoppedError):
            display.board.open()


@pytest.mark.parametrize("stop", [st.Display.stop, lambda display: display.stopping.ask("a key")])
def test_a_stop_holds_where_the_program_drives_the_board(stop):
    display = st.open_display("memory:")
    source = st.open_source("text:a", display.profile)
    steps = st.steps(source, display.profile, intensity=0.05)
    with display.board as board:
        board.send(next(steps).sequence)
        stop(display)
        with pytest.raises(BoardStoppedError):
            board.send(next(steps).sequence)
    with pytest.raises(BoardStoppedError):
        st.run(st.open_source("text:a", display.profile), display, seconds=0.1)
