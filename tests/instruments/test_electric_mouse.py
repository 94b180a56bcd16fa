"""Electric mouse: rate and place of its pulses, and motions that evoke no pulses."""

import math
from itertools import count, takewhile

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import SmartTouchError, SourceError
from smarttouch.instruments.electric_mouse import (
    JUMP_MM,
    Deadband,
    MouseSource,
    TexturePicture,
    open_texture_source,
)
from smarttouch.instruments.hand_motion import START_S, HandMotion, SweepMotion
from smarttouch.instruments.relief import open_texture
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile

from ..support.checks import numbers_in, raises
from ..support.runs import until
from ..views.conftest import running
from ..views.test_window import connect, receive
from .conftest import object_file

GRATING = open_texture("grating:4mm")


class Played(HandMotion):
    """Motion through the places of a list, one place for each frame."""

    def __init__(self, places, resolution_mm=0.0, force_n=None):
        super().__init__("a test")
        self._places = iter(places)
        self.resolution_mm = resolution_mm
        self.origin_mm = (0.0, 0.0)
        self.knows_force = force_n is not None
        self.force_n = math.nan if force_n is None else force_n

    def read(self, time_ns):
        return next(self._places, None)


def frames_of(source):
    """Return all frames of a source that is read 100 times a second."""
    return list(takewhile(bool, (source.read(10_000_000 * k) for k in count())))


def pulses(source):
    """Read a source to its end; return the activation of its class, (frames, E)."""
    return np.array([each.activation[source.mode.afferents[0]] for each in frames_of(source)])


@pytest.mark.parametrize(("speed", "want_hz"), [(40, 10), (80, 20), (180, 45), (280, None)])
def test_each_electrode_pulses_spatial_frequency_times_speed_up_to_a_bound(mouse, speed, want_hz):
    motion = SweepMotion(speed, (90.0, 0.0))
    motion.origin_mm = (15.3, 20.3)
    source = MouseSource(GRATING, motion, mouse, press_n=1.0)
    begin, seconds = round(100 * START_S), 90 / speed
    asked = pulses(source)
    pulses_hz = asked[begin : begin + round(100 * seconds) + 1].sum(axis=0) / seconds
    if want_hz is not None:
        assert pulses_hz == pytest.approx([want_hz] * 64, abs=1.01 / seconds)
        assert source.notes == []
    else:
        assert 30 < pulses_hz.mean() < 50.5
        left_out, most_hz = numbers_in(source.notes[0])
        assert left_out > 0
        assert most_hz == 50
        # The limit is 50 Hz, so an electrode never pulses in two successive frames of 10 ms.
        assert not (asked[1:] * asked[:-1]).any()


WAYS = [("right", "disc"), ("to and fro", "disc"), ("left", "cross"), ("bent", "cross"),
        ("circle", "disc")]  # fmt: skip


@pytest.mark.parametrize(("way", "kind"), WAYS)
def test_an_object_stays_put_while_the_hand_moves(tmp_path, mouse, kind, way):
    """Pulses come over the whole inked area and nowhere else, on any path of the hand."""
    time_s = np.linspace(0, 2, 201)
    turn = math.pi * time_s
    x, y = {
        "right": (40 * time_s, 20 + 0 * time_s),
        "left": (80 - 40 * time_s, 20 + 0 * time_s),
        "bent": (40 * time_s, 20 + 6 * np.sin(turn)),
        "circle": (40 + 12 * np.sin(turn), 20 + 12 * np.cos(turn)),
        "to and fro": (40 + 14 * np.sin(2 * turn), 19 + time_s),
    }[way]
    texture = open_texture(str(object_file(tmp_path / "o.png", kind)))
    motion = Played(np.column_stack([x, y]).tolist())
    places = np.concatenate([
        (frame.pose.x_mm, frame.pose.y_mm) + mouse.electrodes.position_mm[frame.activation[0] > 0]
        for frame in frames_of(MouseSource(texture, motion, mouse, press_n=1.0))
    ])  # fmt: skip
    assert len(places) > 50
    size_mm = 10 if kind == "disc" else 14
    assert (places.min(axis=0) + places.max(axis=0)) / 2 == pytest.approx([40, 20], abs=0.7)
    assert np.ptp(places, axis=0) == pytest.approx([size_mm, size_mm], abs=2.5)
    # A pulse is late by at most a frame, in which the fastest hand moves 0.9 mm.
    ink = 255 - texture.draw(0, 0, (400, 800), 0.1)
    near = [ink[max(0, r - 9) : r + 10, c - 9 : c + 10].max()
            for c, r in (places * 10).astype(int)]  # fmt: skip
    assert min(near) == 255


def test_at_rest_nothing_is_felt(mouse):
    """Ten seconds of jitter, by one count of the mouse along each axis, evoke no pulse."""
    random = np.random.default_rng(4)
    count_mm = 25.4 / 800
    for texture in (GRATING, open_texture("grating:0.5mm,20deg")):
        jumps = count_mm * random.integers(-1, 2, (1000, 2))
        source = MouseSource(texture, Played([(0, 0), *jumps], count_mm), mouse, press_n=1.0)
        assert pulses(source).sum() == 0
        # Jitter evokes no pulse after the hand has moved and come to rest.
        there = [(0.4 * k, 0.1 * k) for k in range(100)]
        way = [*there, (39.6, 9.9), (39.6, 9.9), *(jumps + np.array([39.6, 9.9]))]
        source = MouseSource(texture, Played(way, count_mm), mouse, press_n=1.0)
        asked = pulses(source)
        assert asked[:100].sum() > 100
        assert asked[101:].sum() == 0


def test_a_place_that_is_found_again_is_no_way(mouse):
    apart = JUMP_MM + 0.5
    way = [(0, 0), (0.5, 0), (0.5 + apart, 0), (0.5 + apart, 0), (0.5 + apart, apart)]
    assert pulses(MouseSource(GRATING, Played(way), mouse, press_n=1.0))[2:].sum() == 0
    way[2:] = [(0.5 + JUMP_MM - 0.5, 0)]
    assert pulses(MouseSource(GRATING, Played(way), mouse, press_n=1.0))[2].all()


def test_a_late_frame_is_one_pulse_and_counted(mouse):
    source = MouseSource(GRATING, Played([(0.1, 0), (12.1, 0)]), mouse, press_n=1.0)
    assert pulses(source)[1].tolist() == [1.0] * 64
    assert source.merged == 2 * 64
    assert numbers_in(source.notes[0]) == [128]


def test_what_is_left_out_is_reported_once(mouse):
    told = []
    way = [(2.5 * k, 0) for k in range(100)]
    source = MouseSource(GRATING, Played(way), mouse, rate_hz=20, press_n=1.0)
    source.emit = lambda event: told.append((event.time_ns, str(event)))
    pulses(source)
    assert len(told) == 1
    assert numbers_in(told[0][1]) == [10]


def test_the_contents_of_a_frame(mouse):
    motion = Played([(0, 0), (3, 1), (3, 1)], force_n=0.4)
    source = MouseSource(GRATING, motion, mouse, Mode.SAI, rate_hz=50)
    frames = [source.read(20_000_000 * k) for k in range(3)]
    assert (frames[1].pose.x_mm, frames[1].pose.y_mm) == (3, 1)
    assert [each.number for each in frames] == [0, 1, 1]
    assert frames[2].image is frames[1].image
    assert (source.frames, source.knows_force, frames[1].force_n) == (2, True, 0.4)
    assert frames[1].period_us == 20_000
    rows = frames[1].activation.any(axis=1)
    assert rows.tolist() == [each is Afferent.SAI for each in Afferent]
    shape = (mouse.optics.sensor_rows, mouse.optics.sensor_columns)
    np.testing.assert_array_equal(frames[1].image, GRATING.draw(-5.0, -7.0, shape, 0.25))


@pytest.mark.parametrize(("options", "allowed"), [
    *(({"rate_hz": each}, (10, 200)) for each in (5, 201)),
    *(({"mode": each}, ("RA", "SAI", "PC")) for each in (Mode.NATURAL, Mode.COLOR)),
])  # fmt: skip
def test_the_impossible_is_refused(mouse, options, allowed):
    (value,) = options.values()
    with raises(SourceError, value=value, allowed=allowed):
        MouseSource(GRATING, Played([]), mouse, **options)


def test_jitter_on_a_slow_motion_is_no_motion_back():
    steady, random = Deadband(0.03), np.random.default_rng(5)
    x = [steady.follow(0.01 * k + 0.03 * random.integers(-1, 2), 0.0)[0] for k in range(1000)]
    assert (np.diff(x) >= 0).all()
    assert x[-1] > 9.7


def test_a_run_without_pulses_is_an_error(mouse, tmp_path):
    empty = TexturePicture(mouse, load_bank(mouse), (Afferent.RA,), open_texture("grating:4mm"))
    empty.deliver(np.zeros(0, np.uint32), np.zeros(0, np.float32), np.zeros((0, 64), np.int16))
    assert (empty.picture((0.0, 0.0), (20, 20), 1.0) == 255).all()
    with raises(SmartTouchError):
        empty.save(tmp_path / "felt.png")
    assert not (tmp_path / "felt.png").exists()


__all__ = ["running"]


@pytest.fixture
def profile():
    return load_profile("electric-mouse")


@pytest.fixture
def grating(profile):
    return open_texture_source("grating:4mm?motion=page", profile)


def poses(run):
    """Return all positions of the hand so far, rounded to mm."""
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


def test_a_run_without_a_window_is_refused(grating):
    with grating, raises(SourceError, value=("motion=page", "window")):
        grating.read(0)
