"""OSC: what other programs send is felt, and silence and nonsense are not."""

import random
import socket
import sys
import time

import numpy as np
import pytest

import smarttouch as st
from smarttouch.drawing import osc
from smarttouch.errors import SourceError

from ..raising import raises

bundles = pytest.importorskip("pythonosc.osc_bundle_builder")
messages = pytest.importorskip("pythonosc.osc_message_builder")


def built(address, *values):
    builder = messages.OscMessageBuilder(f"/smarttouch/{address}")
    for each in values:
        builder.add_arg(each)
    return builder.build()


SILENT_S = osc.SILENT_S


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    """Nothing falls silent while a busy machine lets a test wait."""
    monkeypatch.setattr(osc, "SILENT_S", 1000)


@pytest.fixture
def source(profile):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with st.open_source(f"osc:{port}", profile) as opened:
        yield opened


@pytest.fixture
def send(source):
    """Return a sender of a packet; it waits until that is taken."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.connect(source._line.getsockname())

        def sent(data):
            before = source._given + source.wrong
            line.send(data)
            while source._given + source.wrong == before:
                time.sleep(0.001)

        yield sent


def felt(source):
    stimulus = source.read(0)
    return np.flatnonzero(stimulus.activation[0]).tolist(), stimulus.stale


def test_it_listens_on_this_machine_alone(source):
    assert source._line.getsockname()[0] == "127.0.0.1"
    assert felt(source) == ([], True)


def test_points_and_images(source, send):
    send(built("point", 0.0, 0.0).dgram)
    assert felt(source) == ([0], False)
    send(built("point", 1, 1, 0.5).dgram)
    assert source.read(0).activation[2, 63] == np.float32(0.5)
    send(built("point", 0.5, 0.5, 1.0, 1.5).dgram)
    assert felt(source)[0] == [27, 28, 35, 36]
    bundle = bundles.OscBundleBuilder(bundles.IMMEDIATELY)
    bundle.add_content(built("point", 0.0, 0.0))
    bundle.add_content(built("point", 1.0, 0.0))
    send(bundle.build().dgram)
    assert felt(source)[0] == [0, 7]
    levels = [float(each == 9) for each in range(64)]
    send(built("electrodes", *levels).dgram)
    assert felt(source)[0] == [9]
    send(built("clear").dgram)
    assert felt(source) == ([], False)
    image = np.zeros((8, 8), np.uint8)
    image[2, 5] = 255
    send(built("image", 8, 8, image.tobytes()).dgram)
    assert felt(source)[0] == [21]
    image = np.zeros((80, 80), np.uint8)
    image[40:] = 255
    send(built("image", 80, 80, image.tobytes()).dgram)
    np.testing.assert_allclose(source.read(0).activation[0].reshape(8, 8)[:, 3], [0] * 4 + [1] * 4)
    assert source.wrong == 0
    assert source.frames == 8


def test_silence_is_nothing(source, send, monkeypatch):
    send(built("point", 0.0, 0.0).dgram)
    assert felt(source) == ([0], False)
    heard_s = time.monotonic()
    monkeypatch.setattr(osc, "SILENT_S", SILENT_S)
    monkeypatch.setattr(osc.time, "monotonic", lambda: heard_s + 0.51)
    assert felt(source) == ([], True)
    assert SILENT_S == 0.5


def test_nonsense_changes_nothing(source, send):
    send(built("point", 0.0, 0.0).dgram)
    noise, wrong = random.Random(1), 0
    for data in (
        b"", b"x", *(noise.randbytes(noise.randrange(1, 300)) for _ in range(100)),
        *(built(*each).dgram for each in (
            ("point",), ("point", 2.0, 0.0), ("point", float("nan"), 0.0), ("point", "a", "b"),
            ("electrodes", 1.0), ("electrodes", *[2.0] * 64), ("electrodes", b"abc"),
            ("image", 8, 8), ("image", 0, 0, b"x"), ("image", -8, -8, bytes(64)),
            ("image", 100_000, 100_000, b"x"), ("nothing", 1.0),
        )),
    ):  # fmt: skip
        send(data)
        wrong += 1
    assert felt(source)[0] == [0]
    assert source.wrong == wrong
    source.close()
    assert str(wrong) in source.notes[0]


@pytest.mark.parametrize("place", ["", "x", "0", "65536", "127.0.0.1:", "²"])
def test_what_is_no_port_is_refused(profile, place):
    with raises(SourceError, about="address", problem="malformed", value=place):
        st.open_source(f"osc:{place}", profile)


def test_a_port_that_is_taken_is_refused(source, profile):
    port = source._line.getsockname()[1]
    with raises(SourceError, about="address", problem="unavailable"):
        st.open_source(f"osc:{port}", profile)


def test_what_is_no_host_is_refused(profile):
    with raises(SourceError, about="address", problem="unavailable", value="a..b:9000"):
        st.open_source("osc:a..b:9000", profile)


def test_without_the_extra_it_says_which(profile, monkeypatch):
    monkeypatch.setitem(sys.modules, "pythonosc.osc_packet", None)
    with raises(SourceError, about="osc", problem="missing"):
        st.open_source("osc:9000", profile)


def test_a_point_comes_out_of_the_board(source, send, profile):
    send(built("point", 0.4, 0.4).dgram)
    results = []
    display = st.open_display("simulated:", profile)
    st.run(source, display, seconds=0.3, listeners=[results.append])
    assert {each for result in results for each in result.sequence.site.tolist()} == {27}
