"""Lines come one after another, and whatever goes wrong comes where it went wrong."""

import threading

import pytest

from smarttouch.base.errors import ReadingError
from smarttouch.reading.line_feed import AHEAD, BEHIND, LineFeed


def test_lines_are_there_before_all_are_ready(make_line):
    go_on = threading.Event()
    lines = [make_line(), make_line()]

    def slowly():
        yield lines[0]
        go_on.wait(60)
        yield lines[1]

    feed = LineFeed(slowly()).start()
    assert feed.wait_for(0, 10) is lines[0]
    assert feed.line(1) is None
    assert not feed.ended(1)
    go_on.set()
    assert feed.wait_for(1, 10) is lines[1]
    assert feed.wait_for(2, 10) is None
    assert feed.ended(2)
    assert not feed.ended(1)


def test_an_error_comes_after_the_lines_before_it(make_line):
    torn = ReadingError("page 2 is torn")

    def broken():
        yield make_line()
        raise torn

    feed = LineFeed(broken()).start()
    assert feed.wait_for(0, 10) is not None
    with pytest.raises(ReadingError) as caught:
        feed.wait_for(1, 10)
    assert caught.value is torn
    assert feed.line(0) is not None


def test_of_a_book_only_what_lies_near_is_prepared_and_kept(make_line):
    line, made = make_line(), []

    def book():
        for number in range(1000):
            made.append(number)
            yield line

    feed = LineFeed(book()).start()
    assert feed.wait_for(AHEAD, 10) is line
    assert not feed.wait_for_end(0.05)
    assert len(made) <= AHEAD + 2
    feed.reach(500)
    assert feed.wait_for(500 + AHEAD, 10) is line
    feed.reach(500)
    assert feed.earliest == 500 - BEHIND
    assert feed.line(500 - BEHIND) is line
    assert feed.line(499 - BEHIND) is None
    assert len(made) <= 500 + AHEAD + 2
    feed.close()
    assert feed.wait_for_end(10)


def test_closed_it_prepares_no_more_and_lets_go_of_where_lines_come_from(make_line):
    made, let_go, go_on = [], [], threading.Event()

    def endless():
        try:
            while True:
                made.append(make_line())
                yield made[-1]
                go_on.wait(60)
        finally:
            let_go.append(True)

    feed = LineFeed(endless()).start()
    feed.wait_for(0, 10)
    feed.close()
    go_on.set()
    assert feed.wait_for_end(10)
    assert len(made) <= 2
    assert let_go


def test_what_is_at_work_when_closed_is_waited_for_at_the_end(make_line, monkeypatch):
    waited, go_on = [], threading.Event()
    monkeypatch.setattr("atexit.register", waited.append)

    def slow():
        yield make_line()
        go_on.wait(60)

    feed = LineFeed(slow()).start()
    feed.wait_for(0, 10)
    feed.close()
    go_on.set()
    waited[0](60)
    assert feed.wait_for_end(0)
