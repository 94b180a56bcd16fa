"""Images and activations over a local socket: taken from programs of this user, and no others."""

import shutil
import socket
import subprocess
import time

import numpy as np
import pytest

import smarttouch as st
from smarttouch.base.errors import SourceError
from smarttouch.instruments import pushed_stimuli
from smarttouch.lab import check_recording
from smarttouch.testing import SourceContract, StimulusContract

from ..raising import raises
from ..waiting import until


def pgm(image, most=255):
    height, width = image.shape
    return b"P5\n%d %d\n%d\n" % (width, height, most) + image.astype(np.uint8).tobytes()


def connect(source):
    address = (source.device if hasattr(source, "device") else source._device).address
    line = socket.socket(socket.AF_UNIX if isinstance(address, str) else socket.AF_INET)
    line.connect(address)
    return line


@pytest.fixture(params=["0", "{}/touch"])
def place(request, tmp_path):
    return request.param.format(tmp_path)


@pytest.fixture
def images(profile, place):
    with st.open_source(f"socket:{place}", profile) as opened:
        yield opened


@pytest.fixture
def stimuli(profile, place, monkeypatch):
    monkeypatch.setattr(pushed_stimuli, "SILENT_S", 1000)
    with st.open_source(f"socket:{place}?activation", profile) as opened:
        yield opened


def test_images_arrive_in_whatever_pieces(images):
    """Before the first there is white paper, which is stale."""
    first = images.read(0)
    assert first.stale
    assert (first.image == 255).all()
    sent = [np.random.default_rng(each).integers(0, 256, (40, 30)) for each in range(3)]
    with connect(images) as line:
        for number, image in enumerate(sent, 1):
            data = pgm(image)
            for at in range(0, len(data), 500):
                line.sendall(data[at : at + 500])
            until(lambda number=number: images.read(0).number == number)
            frame = images.read(0)
            np.testing.assert_array_equal(frame.image, image)
            assert not frame.stale
    with connect(images) as line:
        line.sendall(b"P5\n# a comment\n3\t2\n15\n" + bytes([0, 1, 15, 15, 15, 255]))
        until(lambda: images.read(0).number == 4)
    assert images.read(0).image.tolist() == [[0, 17, 255], [255, 255, 255]]


def test_activations_are_of_all_classes_or_of_each(stimuli):
    own = np.random.default_rng(1).integers(0, 256, (3, 64))
    with connect(stimuli) as line:
        for number, image in enumerate((own, own[:1]), 1):
            line.sendall(pgm(image))
            until(lambda number=number: stimuli.given == number)
            expected = np.broadcast_to(image / np.float32(255), (3, 64))
            np.testing.assert_allclose(stimuli.read(0).activation, expected)
        line.sendall(pgm(own[:2]))
        until(lambda: stimuli.wrong == 1)
    stimuli.close()
    assert "1 activations" in stimuli.notes[0]
    assert (stimuli.frames, stimuli.dropped_frames) == (2, 0)


@pytest.mark.parametrize("data", [
    b"P6\n2 2\n255\n" + bytes(12), b"GET / HTTP/1.1\r\n\r\n", b"P5\n0 2\n255\n",
    b"P5" + b"\n" * 2000, b"P5\n9999 9999\n255\n", b"P5\n2 2\n65535\n" + bytes(8),
])  # fmt: skip
def test_who_sends_anything_else_is_closed_and_the_next_comes(stimuli, data):
    with connect(stimuli) as line:
        line.sendall(data)
        assert line.recv(1) == b""
    with connect(stimuli) as line:
        line.sendall(pgm(np.full((1, 64), 255)))
        until(lambda: stimuli.given == 1)
    assert any("1 connections were closed" in each for each in stimuli.notes)


CLIENT = """
import socket, sys
line = socket.socket(socket.AF_UNIX if "/" in sys.argv[1] else socket.AF_INET)
try:
    line.connect(sys.argv[1] if "/" in sys.argv[1] else ("127.0.0.1", int(sys.argv[1])))
    line.sendall(b"P5\\n64 1\\n255\\n" + b"\\xff" * 64)
    print(line.recv(1) == b"", flush=True)
except OSError:
    print(True, flush=True)
"""


def test_another_user_is_refused(stimuli, other_account):
    address = stimuli.device.address
    with other_account("-c", CLIENT, address if isinstance(address, str) else address[1]) as other:
        assert other.stdout.readline() == "True\n"
    assert stimuli.given == 0
    if not isinstance(address, str):
        until(lambda: stimuli.device.refused == 1)
    with connect(stimuli) as line:
        line.sendall(pgm(np.full((1, 64), 255)))
        until(lambda: stimuli.given == 1)


def test_netcat_and_a_shell_are_a_client(stimuli):
    address = stimuli.device.address
    if isinstance(address, str) or shutil.which("bash") is None:
        pytest.skip("needs a port and bash")
    script = "{ printf 'P5\\n64 1\\n255\\n'; head -c 64 /dev/zero | tr '\\0' '\\377'; sleep 9; }"
    command = f"{script} > /dev/tcp/127.0.0.1/{address[1]}"
    with subprocess.Popen(["bash", "-c", command]) as client:
        until(lambda: stimuli.given == 1)
        client.kill()
    assert (stimuli.read(0).activation == 1).all()


@pytest.mark.parametrize(("place", "words"), [
    ("", "''"), ("x", "'x'"), ("65536", "65536"), ("/none/there", "/none/there"),
    ("/dev/null", "/dev/null"),
])  # fmt: skip
def test_what_is_no_place_is_refused(profile, place, words):
    with raises(SourceError, about="address", value=words):
        st.open_source(f"socket:{place}", profile)


def test_a_place_that_is_taken_is_refused_and_one_that_was_left_is_not(profile, tmp_path):
    with st.open_source("socket:0", profile) as first, raises(SourceError, about="address"):
        st.open_source(f"socket:{first._device.address[1]}", profile)
    path = tmp_path / "touch"
    with st.open_source(f"socket:{path}", profile):
        with raises(SourceError, about="address"):
            st.open_source(f"socket:{path}", profile)
        assert path.stat().st_mode & 0o777 == 0o600
    assert not path.exists()
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(path))
    with st.open_source(f"socket:{path}", profile) as source:
        connect(source).close()


def test_a_system_that_does_not_show_who_connects_needs_a_path(profile, monkeypatch, tmp_path):
    monkeypatch.setattr("smarttouch.instruments.socket_source.TCP_TABLES", (tmp_path / "none",))
    with raises(SourceError, about="address"):
        st.open_source("socket:9000", profile)


@pytest.mark.parametrize("follow", [False, True])
def test_an_image_wakes_the_loop_after_silence_and_where_each_is_followed(profile, follow):
    usual_ns = round(1e9 / profile.pulse.rate_hz)
    with st.open_source(f"socket:0?follow={follow}", profile) as images:
        images.afferents = (st.Afferent.RA,)
        assert images.patience_ns(0) == 0
        assert images.read(0).stale
        assert images.patience_ns(0) > 0
        with connect(images) as line:
            line.sendall(pgm(np.full((40, 30), 255)))
            assert images.news.wait(60)
            assert images.patience_ns(0) == 0
            frame = images.read(0)
            assert frame.period_us == (round(1e6 / profile.limits.rate_hz) if follow else None)
            assert images.patience_ns(5_000_000) == follow * (usual_ns - 5_000_000)
            assert images.patience_ns(usual_ns) == 0
            images.afferents = tuple(st.Afferent)
            assert images.patience_ns(5_000_000) == 0
            assert images.read(0).period_us is None


def test_images_that_are_followed_are_pulses_of_their_own_also_in_a_recording(profile, tmp_path):
    path = tmp_path / "run.mcap"
    display = st.open_display("memory:", profile)
    checker = np.kron(np.indices((8, 8)).sum(0) % 2, np.ones((8, 8))) * 255
    with st.open_source("socket:0?follow", profile) as images, connect(images) as line:
        images.read(0)
        line.sendall(pgm(checker))
        images._device.stale_s = 1000
        until(lambda: not images.read(0).stale)
        recorder = st.Recorder(path)
        st.run(images, display, seconds=0.2, force="fixed:0.9", listeners=[recorder])
    assert {each.period_us for each in display.board.sequences} == {5_000}
    assert sum(each.slots for each in display.board.sequences) > 0
    report = check_recording(path)
    assert report.exact
    assert report.sequences == len(display.board.sequences)


def test_owners_of_both_ends_are_known():
    with socket.create_server(("127.0.0.1", 0)) as server:
        before = pushed_stimuli.own_sockets()
        with socket.create_connection(server.getsockname()) as line, server.accept()[0] as other:
            assert pushed_stimuli.is_from_us(other)
            assert pushed_stimuli.is_from_us(line)
            assert pushed_stimuli.lead_to_us(pushed_stimuli.own_sockets() - before)
    assert not pushed_stimuli.lead_to_us(pushed_stimuli.own_sockets() - before)


class TestImages(SourceContract):
    ends = False

    def make(self, profile):
        return st.open_source("socket:0", profile)

    def make_impossible(self, profile):
        st.open_source("socket:nowhere", profile)


class TestStimuli(StimulusContract):
    ends = False

    def make(self, profile):
        source = st.open_source("socket:0?activation&follow", profile)
        self.lines.append(connect(source))
        self.sent = 0
        self.pause()
        until(lambda: source.given)
        return source

    @pytest.fixture(autouse=True)
    def _closes(self):
        self.lines = []
        yield
        for each in self.lines:
            each.close()

    def pause(self):
        self.sent += 1
        self.lines[-1].sendall(pgm(np.full((3, 64), self.sent)))
        time.sleep(0.002)

    def make_impossible(self, profile):
        st.open_source("socket:nowhere?activation", profile)
