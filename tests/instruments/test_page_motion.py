"""The pointer over a run's page is the hand on a texture."""

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from smarttouch.base.errors import SourceError
from smarttouch.instruments.electric_mouse import open_texture_source
from smarttouch.profile import load_profile

from ..raising import raises
from ..views.conftest import running
from ..views.test_window import connect, receive
from ..waiting import until

__all__ = ["running"]


@pytest.fixture
def profile():
    return load_profile("electric-mouse")


@pytest.fixture
def grating(profile):
    return open_texture_source("grating:4mm?motion=page", profile)


def poses(run):
    """Return where the hand has been, rounded to millimeters."""
    return {
        (round(each.input.pose.x_mm), round(each.input.pose.y_mm))
        for each in [*run.results.values()]
    }


def test_the_page_that_steers_moves_the_hand_and_ridges_pulse(running, grating):
    with running(grating) as run, connect(run) as socket, connect(run) as other:
        assert receive(socket, "hello")["moves"]
        sheet = receive(socket, "update")["sheet"]
        assert sheet["size_mm"] == pytest.approx([150, 100], abs=0.1)
        assert sheet["corner_mm"] == [-75, -50]
        assert poses(run) == {(0, 0)}
        socket.send("move 10 -5")
        until(lambda: run.window.steering.page is not None)
        other.send("move 60 40")
        for x in range(10, 31):
            socket.send(f"move {x} -5")
            until(lambda at=x: at - 2 < max(poses(run))[0])
        assert {y for _, y in poses(run)} <= {0, -5}
        assert any(np.any(each.tactile.activation) for each in [*run.results.values()])


@pytest.mark.parametrize("sent", ["move", "move 1", "move a b", "move nan 0", "move 77 0"])
def test_a_place_that_is_not_on_the_texture_ends_the_page(running, grating, sent):
    with running(grating) as run, connect(run) as socket:
        socket.send(sent)
        with pytest.raises(ConnectionClosed):
            receive(socket, "never")
        assert poses(run) == {(0, 0)}


def test_without_the_secret_or_something_to_move_nothing_moves(running, grating):
    with running(grating) as run, pytest.raises(InvalidStatus):
        connect(run, token="another")
    with running() as run, connect(run) as socket:
        socket.send("move 0 0")
        with pytest.raises(ConnectionClosed):
            receive(socket, "never")


def test_a_run_without_a_window_is_refused(grating):
    with grating, raises(SourceError, value=("motion=page", "window")):
        grating.read(0)
