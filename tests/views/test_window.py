"""Tests of window pages: refused requests, rights to steer, and pages that hang."""

import http.client
import io
import json
import random
from contextlib import ExitStack, closing, suppress
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect as open_socket

from smarttouch.base.afferent import Mode
from smarttouch.base.events import Note, RunFailed, TrialEvent
from smarttouch.base.stopping import StopRequest
from smarttouch.pages.page_and_lines import Page
from smarttouch.running.loop import Controls, ControlState
from smarttouch.sources.source_contract import Sheet
from smarttouch.views import connected_pages
from smarttouch.views.connected_pages import LOST_S, MOST_PAGES, Steering
from smarttouch.views.window import sheet_png
from smarttouch.views.window_server import MOST_MESSAGE_BYTES

from ..support.runs import until


def connect(run, *, origin=None, token=None):
    """Return the socket of a page, by default with the right origin and token."""
    place = urlsplit(run.address)
    secret = place.path.split("/")[1] if token is None else token
    return open_socket(
        f"ws://{place.netloc}/{secret}/socket",
        origin=f"http://{place.netloc}" if origin is None else origin or None,
        compression=None,
        proxy=None,
    )


def ask(run, method, path, **headers):
    place = urlsplit(run.address)
    with closing(http.client.HTTPConnection(place.hostname, place.port, timeout=10)) as line:
        line.request(method, path.replace("SECRET", place.path.split("/")[1]), headers=headers)
        answer = line.getresponse()
        answer.read()
        return answer


def receive(socket, kind):
    """Return the next message of a kind. Answer each earlier update with "seen"."""
    while True:
        message = json.loads(socket.recv(timeout=20))
        if message["type"] == kind:
            return message
        if message["type"] == "update":
            # At the end of a run the server can be closed while updates are still unread.
            with suppress(ConnectionClosed):
                socket.send("seen")


def test_only_this_page_of_this_machine_is_served(running):
    with running() as run:
        own = f"http://{urlsplit(run.address).netloc}"
        stranger = "http://example.org"
        for method, path, headers, status in (
            ("GET", "/SECRET/live.html", {}, 200),
            ("GET", "/SECRET/live.html", {"Origin": own}, 200),
            ("GET", "/SECRET/../live.py", {}, 404),
            ("GET", "/SECRET/%2e%2e/live.py", {}, 404),
            ("GET", "/live.html", {}, 403),
            ("GET", "/", {}, 403),
            ("GET", "/SECREX/live.html", {}, 403),
            ("GET", "/SECRET/live.html", {"Host": "example.org"}, 403),
            ("GET", "/SECRET/live.html", {"Origin": stranger}, 403),
            ("POST", "/SECRET/stop", {}, 403),
            ("POST", "/SECRET/stop", {"Origin": stranger}, 403),
            ("POST", "/SECRET/stop", {"Origin": "null"}, 403),
            ("POST", "/stop", {"Origin": own}, 403),
        ):
            assert ask(run, method, path, **headers).status == status, (path, headers)
        answer = ask(run, "GET", "/SECRET/live.html")
        assert "default-src 'none'" in answer.headers["content-security-policy"]
        for wrong in ({"origin": stranger}, {"origin": ""}, {"token": "x" * 32}):
            with pytest.raises(InvalidStatus) as refused:
                connect(run, **wrong)
            assert refused.value.response.status_code == 403
        upgrade = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13"}
        upgrade |= {"Sec-WebSocket-Key": "MDEyMzQ1Njc4OTAxMjM0NQ==", "Origin": own}
        assert ask(run, "GET", "/SECRET/socket", Host="example.org", **upgrade).status == 403
        assert run.window.pages == 0
        assert not run.stop.event.is_set()


def test_what_is_no_message_ends_a_page_and_nothing_else(running):
    noise = random.Random(1)
    with running() as run:
        before = run.state()
        wrong = [
            "", "seen ", "do", "do ", "do more ", "do most", "do level:", "do level:x",
            "do mode:PC", "do mode:nothing", "do key:q", "do key:", "do stop",
            "steer 1", "move 0 0", "stop now", "{}", "x" * (MOST_MESSAGE_BYTES + 1), b"stop",
            noise.randbytes(200),
            *("".join(map(chr, noise.choices(range(1, 0xD800), k=40))) for _ in range(5)),
        ]  # fmt: skip
        for message in wrong:
            with connect(run) as socket:
                receive(socket, "hello")
                socket.send(message)
                with pytest.raises(ConnectionClosed):
                    receive(socket, "nothing")
        with connect(run) as socket, suppress(ConnectionClosed):
            while True:
                socket.send("seen")
        until(lambda: run.window.pages == 0)
        count = len(run.results)
        until(lambda: len(run.results) > count)
        assert run.state() == before


def test_a_page_does_not_show_a_failed_run_as_being_at_zero(running):
    with running() as run, connect(run) as socket:
        run.window.event(RunFailed(0, "lift the finger"))
        run.window.close()
        assert receive(socket, "ended") == {
            "type": "ended", "reason": "lift the finger", "failed": True
        }  # fmt: skip


def test_a_page_that_has_lost_its_connection_can_stop(running):
    with running() as run:
        origin = f"http://{urlsplit(run.address).netloc}"
        assert ask(run, "POST", "/SECRET/stop", Origin=origin).status == 204
        # The server answers after the board is at zero, so the board gets no more sequences.
        count = len(run.board.driver.sequences)
        assert run.ended() == "the window"
        assert len(run.board.driver.sequences) == count


def test_current_is_zero_when_the_page_that_steers_hangs(running):
    with running(lost_s=LOST_S) as run, connect(run) as socket:
        receive(socket, "hello")
        socket.send("steer")
        # The page stays connected but no longer confirms updates.
        last = until(
            lambda: next((each for each in [*run.results.values()] if not each.step.level), None)
        )
        assert not last.sequence.current_ua.any()
        assert run.state().paused


def test_a_page_that_reads_nothing_holds_nobody_up(running):
    with running() as run, connect(run), connect(run) as reader:
        receive(reader, "hello")
        count = len(run.results)
        while len(run.results) < count + 25:
            assert receive(reader, "update")
            reader.send("seen")
        assert not run.state().paused


def test_what_would_reveal_the_answer_is_not_sent(running):
    with running(blind=True) as run, connect(run) as socket:
        assert receive(socket, "hello")["blind"]
        run.window.event(TrialEvent(0, "the answer"))
        run.window.event(Note(1, "no answer"))
        told = []
        while "no answer" not in told:
            update = receive(socket, "update")
            assert {*update} == {"type", "state"}
            # The dose, the number of sequences and the work share would also reveal the answer.
            assert not {"dose_s", "dose_mc", "sequences", "work_share"} & {*update["state"]}
            told += [each["text"] for each in update["state"]["events"]]
            socket.send("seen")
        assert "the answer" not in told


def update_where(socket, holds):
    """Return the first update for which the predicate ``holds`` is true."""
    while True:
        socket.send("seen")
        if holds(update := receive(socket, "update")):
            return update


def test_no_more_pages_than_so_many_are_open(running):
    with running() as run, ExitStack() as stack:
        for _ in range(MOST_PAGES):
            receive(stack.enter_context(connect(run)), "hello")
        with pytest.raises(ConnectionClosed):
            receive(stack.enter_context(connect(run)), "hello")


@pytest.mark.parametrize("asked", ["pause", "none"])
def test_what_asks_for_no_current_stops_where_another_page_steers(running, asked):
    with running() as run, connect(run) as socket, connect(run) as other:
        socket.send("do less")
        update_where(socket, lambda each: each["state"]["steers"] == "you")
        for ignored in ("less", "resume", asked):
            assert run.thread.is_alive()
            other.send(f"do {ignored}")
        assert run.ended() == "the window"


@pytest.mark.parametrize("level", ["1.5", "-0.1", "nan", "inf"])
def test_a_level_beyond_the_limit_is_refused_in_words(running, level):
    with running() as run, connect(run) as socket:
        socket.send(f"do level:{level}")
        update = update_where(socket, lambda each: "refused" in each)
        assert level in update["refused"]
        assert update["state"]["force_n"] == run.source.profile.force.full_n
        assert run.state().level == 1
        socket.send("do level:0.25")
        until(lambda: run.state().level == 0.25)


def test_a_large_page_is_reduced_and_a_small_one_sent_as_it_is():
    for shape, width in (((400, 3200), 1600), ((300, 200), 200)):
        png = sheet_png(Sheet(1, Page(np.zeros(shape, np.uint8), 0.1)))
        assert Image.open(io.BytesIO(png)).width == width


def test_the_page_that_is_read_is_served_where_there_is_one(running, monkeypatch):
    with running() as run:
        assert ask(run, "GET", "/SECRET/sheet.png").status == 404
        page = Page(np.zeros((300, 200), np.uint8), 0.1)
        monkeypatch.setattr(type(run.source), "sheet", Sheet(1, page))
        answer = ask(run, "GET", "/SECRET/sheet.png")
        assert (answer.status, answer.headers["content-type"]) == (200, "image/png")


@pytest.mark.parametrize("alone", [True, False])
def test_a_page_that_falls_silent_steers_no_longer(monkeypatch, alone):
    now_s = [100.0]
    monkeypatch.setattr(connected_pages.time, "monotonic", lambda: now_s[0])
    controls = Controls(ControlState(Mode.RA, 0.5), (Mode.RA, Mode.SAI))
    pages = Steering(controls, StopRequest(), {}, alone=alone)
    pages.steer(1)
    for wait_s, alive, steers in ((0.9, 1, 1), (0.9, 2, 1), (0.2, 2, None)):
        now_s[0] += wait_s * LOST_S
        pages.note_alive(alive)
        pages.look_after()
        assert pages.page == steers
    assert controls.state(0).paused is alone
