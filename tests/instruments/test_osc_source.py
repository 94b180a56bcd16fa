"""OSC: what other programs send is delivered, silence and invalid messages are not."""

import hmac
import random
import socket
import sys
import time

import numpy as np
import pytest

import smarttouch as st
from smarttouch.base.afferent import Mode
from smarttouch.base.errors import SourceError
from smarttouch.instruments import osc_source, pushed_stimuli
from smarttouch.testing import StimulusContract

from ..raising import raises
from ..waiting import until

bundles = pytest.importorskip("pythonosc.osc_bundle_builder")
messages = pytest.importorskip("pythonosc.osc_message_builder")


def built(address, *values):
    builder = messages.OscMessageBuilder(f"/smarttouch/{address}")
    for each in values:
        builder.add_arg(each)
    return builder.build()


SILENT_S = pushed_stimuli.SILENT_S


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    """Nothing falls silent while a busy machine lets a test wait."""
    monkeypatch.setattr(pushed_stimuli, "SILENT_S", 1000)


def free_port(address="127.0.0.1"):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind((address, 0))
        return free.getsockname()[1]


@pytest.fixture
def port():
    return free_port()


@pytest.fixture
def source(profile, port):
    with st.open_source(f"osc:{port}", profile) as opened:
        yield opened


@pytest.fixture
def send(source, port):
    """Return a sender of a packet, from a socket that is known; it waits until that is taken."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.connect(("127.0.0.1", port))
        until(lambda: line.getsockname()[1] in source._programs._seen)

        def sent(data):
            before = source.given + source.wrong
            line.send(data)
            while source.given + source.wrong == before:
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


def test_a_class_gets_what_is_addressed_to_it(source, send, profile):
    """In a bundle each class has its own; a message without a class is for all three."""
    own = np.random.default_rng(1).random((3, 64)).astype(np.float32)
    bundle = bundles.OscBundleBuilder(bundles.IMMEDIATELY)
    for name, levels in zip(("ra", "SAI", "pc"), own, strict=True):
        bundle.add_content(built(f"{name}/electrodes", *levels.tolist()))
    send(bundle.build().dgram)
    np.testing.assert_array_equal(source.read(0).activation, own)
    bundle = bundles.OscBundleBuilder(bundles.IMMEDIATELY)
    for each in (
        built("electrodes", *own[0].tolist()),
        built("sai/clear"),
        built("PC/point", 0, 0),
    ):
        bundle.add_content(each)
    send(bundle.build().dgram)
    expected = np.array([own[0], np.zeros(64), own[0]], np.float32)
    expected[2, 0] = 1
    np.testing.assert_array_equal(source.read(0).activation, expected)
    for wrong in ("rb/clear", "ra/sai/clear", "ra/", "/clear"):
        send(built(wrong).dgram)
    assert source.wrong == 4


@pytest.mark.parametrize(("query", "mode", "active_ns", "period_us"), [
    ("", Mode.NATURAL, 0, None), ("?follow", Mode.RA, 20_000_000, 5000),
    ("", Mode.COLOR, 20_000_000, 5000),
])  # fmt: skip
def test_what_wakes_the_loop(profile, query, mode, active_ns, period_us):
    """What follows silence does, and each that is followed; others keep the profile's rates."""
    with st.open_source(f"osc:{free_port()}{query}", profile) as source:
        source.afferents = mode.afferents
        assert source.patience_ns(0) > 0
        source.push(np.ones((3, 64), np.float32))
        assert source.news.is_set()
        assert source.patience_ns(0) == 0
        stimulus = source.read(0)
        assert stimulus.period_us == period_us
        assert np.flatnonzero(stimulus.activation[:, 0]).tolist() == [*mode.afferents]
        assert source.patience_ns(0) == active_ns
        source.push(np.zeros((3, 64), np.float32))
        assert source.patience_ns(5_000_000) == 0
        source.read(5_000_000)
        assert source.patience_ns(5_000_000) > 0


def test_silence_is_nothing(source, send, monkeypatch):
    monkeypatch.setattr(pushed_stimuli, "SILENT_S", SILENT_S)
    now_ns = time.monotonic_ns()
    monkeypatch.setattr(time, "monotonic_ns", lambda: now_ns)
    send(built("point", 0.0, 0.0).dgram)
    assert felt(source) == ([0], False)
    for after_s, found in ((0.49, ([0], False)), (0.51, ([], True)), (9.0, ([], True))):
        now_ns += round(1e9 * after_s)
        assert felt(source) == found
        now_ns -= round(1e9 * after_s)
    assert source.dropped_frames == 0


def test_invalid_messages_change_nothing(source, send):
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
    with raises(SourceError, about="address", value=place):
        st.open_source(f"osc:{place}", profile)


@pytest.mark.usefixtures("source")
def test_a_port_that_is_taken_is_refused(port, profile):
    with raises(SourceError, about="address"):
        st.open_source(f"osc:{port}", profile)


def test_what_is_no_host_is_refused(profile):
    with raises(SourceError, about="address", value="a..b:9000"):
        st.open_source("osc:a..b:9000", profile)


@pytest.mark.parametrize("address", ["0.0.0.0", "[::]", "192.0.2.1"])
def test_other_machines_need_a_key(profile, address):
    with raises(SourceError, about="key", value=address.strip("[]")):
        st.open_source(f"osc:{address}:9000", profile)


def test_a_system_that_does_not_show_who_sends_needs_a_key(profile, monkeypatch, tmp_path):
    monkeypatch.setattr(osc_source, "UDP_TABLES", (tmp_path / "none", tmp_path / "none6"))
    with raises(SourceError, about="key"):
        st.open_source("osc:9000", profile)


@pytest.fixture
def key(tmp_path):
    path = tmp_path / "key"
    path.write_bytes(b" 0123456789abcdef\n")
    path.chmod(0o600)
    return path


@pytest.mark.parametrize(("content", "mode", "expected"), [
    (b"0123456789abcde\n", 0o600, {"value": 15, "allowed": 16}),
    (b"0123456789abcdef", 0o640, {}),
    (b"0123456789abcdef", 0o604, {}),
    (bytes(4097), 0o600, {}),
])  # fmt: skip
def test_a_key_is_long_and_its_owner_s_alone(profile, key, content, mode, expected):
    key.write_bytes(content)
    key.chmod(mode)
    with raises(SourceError, **expected):
        st.open_source(f"osc:{free_port()}?key={key}", profile)


def signed(packet, key=b"0123456789abcdef", after_s=0):
    data = (time.time_ns() + int(1e9 * after_s)).to_bytes(8, "big") + packet
    return built("signed", hmac.digest(key, data, "sha256") + data).dgram


@pytest.mark.parametrize("address", ["127.0.0.1", "0.0.0.0"])
def test_with_a_key_each_packet_is_signed_and_taken_once(profile, key, address):
    place = ("127.0.0.1", free_port(address))
    source = st.open_source(f"osc:{address}:{place[1]}?key={key}", profile)
    point = built("point", 0.0, 0.0).dgram
    first, later = signed(point), signed(built("point", 1.0, 1.0).dgram)
    with source, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        refused = (
            point, b"", b"x", signed(point, b"0123456789abcdeF"), signed(point, after_s=60),
            signed(point, after_s=-60), first[:-4] + b"abcd", built("signed", b"abc").dgram,
            built("signed", "a").dgram, built("signed").dgram,
        )  # fmt: skip
        for each in refused:
            line.sendto(each, place)
        until(lambda: source.refused == len(refused))
        assert felt(source) == ([], True)
        line.sendto(first, place)
        until(lambda: source.given == 1)
        assert felt(source) == ([0], False)
        line.sendto(later, place)
        until(lambda: source.given == 2)
        for each in (first, later):
            line.sendto(each, place)
        until(lambda: source.refused == len(refused) + 2)
        assert felt(source) == ([63], False)
        line.sendto(signed(b"nonsense"), place)
        until(lambda: source.wrong == 1)
    assert any(str(len(refused) + 2) in each for each in source.notes)


HEAD = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid\n"
ENTRY = (
    "{0:5d}: {1}:{2:04X} 00000000:0000 07 00000000:00000000 00:00000000 00000000 {3:5d}"
    "        0 {4} 2 0000000000000000 0         \n"
)
OURS, OTHER = 1000, 65534


@pytest.mark.parametrize(("tables", "verdicts"), [
    ([[(9, OURS, 1)]] * 3, "?++"),
    ([[(9, OTHER, 1)]] * 2, "--"),
    ([[(8, OURS, 1)], []], "--"),
    # It was another's, and what it sent then is still to be read.
    ([[(9, OTHER, 1)], [(9, OURS, 2)], [(9, OURS, 2)]], "-?+"),
    # A port of two users, and one that was closed and opened again between two looks.
    ([[(9, OURS, 1)], [(9, OURS, 1), (9, OTHER, 2)], [(9, OURS, 1)]], "?-?"),
    ([[(9, OURS, 1)], [(9, OURS, 2)], [(9, OURS, 2)]], "??+"),
])  # fmt: skip
def test_a_socket_is_ours_before_a_packet_and_after_it(tmp_path, monkeypatch, tables, verdicts):
    """Each table is read just after a packet came from port 9: ours, new or foreign."""
    paths = tmp_path / "udp", tmp_path / "udp6"
    monkeypatch.setattr(osc_source, "UDP_TABLES", paths)
    monkeypatch.setattr(osc_source.os, "geteuid", lambda: OURS)
    for path in paths:
        path.write_text(HEAD)
    programs = osc_source.OwnPrograms()
    found = ""
    for number, entries in enumerate(tables):
        packet = osc_source.Packet(b"", 9, time.time_ns())
        for place, path in zip(("0100007F", "0" * 32), paths, strict=True):
            mine = entries[::2] if place == "0100007F" else entries[1::2]
            path.write_text(HEAD + "".join(ENTRY.format(number, place, *each) for each in mine))
        programs.look()
        found += {True: "+", None: "?", False: "-"}[programs.are_sending(packet)]
    assert found == verdicts


SENDER = """
import socket, sys, time
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
    line.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    if len(sys.argv) > 2:
        line.bind(("127.0.0.1", int(sys.argv[2])))
    while True:
        line.sendto(bytes.fromhex(sys.stdin.readline()), ("127.0.0.1", int(sys.argv[1])))
"""


@pytest.mark.parametrize("shares", [False, True])
def test_another_user_is_refused(source, port, send, other_account, shares):
    """With a port of its own, and with one that it shares with a program of ours."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours:
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        ours.bind(("127.0.0.1", 0))
        beside = [ours.getsockname()[1]] if shares else []
        with other_account("-c", SENDER, port, *beside) as process:
            for count in range(1, 6):
                process.stdin.write(built("point", 0.0, 0.0).dgram.hex() + "\n")
                process.stdin.flush()
                until(lambda count=count: source.refused == count)
                time.sleep(0.12)
    assert felt(source) == ([], True)
    send(built("point", 1.0, 1.0).dgram)
    assert felt(source) == ([63], False)


LEAVER = """
import socket, sys
for port in sys.stdin:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", int(port)))
        print("bound", flush=True)
        for _ in range(30):
            line.sendto(bytes.fromhex(sys.argv[2]), ("127.0.0.1", int(sys.argv[1])))
"""


def test_a_port_that_another_user_leaves_to_us_brings_nothing(source, port, other_account):
    """Its packets wait while a program of ours takes the port: by the port they would be ours."""
    here = ("127.0.0.1", port)
    packets = [built("point", at, at).dgram for at in (0.0, 1.0)]
    taken, take = [], source._take
    source._take = lambda data: taken.append(data) or take(data)
    with other_account("-c", LEAVER, here[1], packets[0].hex()) as process:
        for _ in range(10):
            other, before = free_port(), source.given
            process.stdin.write(f"{other}\n")
            process.stdin.flush()
            assert process.stdout.readline() == "bound\n"
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours:
                until(lambda ours=ours, other=other: is_bound(ours, other))
                while source.given == before:
                    ours.sendto(packets[1], here)
                    time.sleep(0.005)
    assert set(taken) == {packets[1]}


def is_bound(line, port):
    try:
        line.bind(("127.0.0.1", port))
    except OSError:
        return False
    return True


def test_without_the_extra_it_says_which(profile, monkeypatch):
    monkeypatch.setitem(sys.modules, "pythonosc.osc_packet", None)
    with raises(SourceError, about="extra"):
        st.open_source("osc:9000", profile)


def test_classes_that_differ_come_out_of_the_board(source, send, profile):
    """Mode color drives all three, each with its own electrodes."""
    own = np.zeros((3, 64), np.float32)
    own[[0, 1, 2], [9, 18, 36]] = 1
    bundle = bundles.OscBundleBuilder(bundles.IMMEDIATELY)
    for name, levels in zip(("ra", "sai", "pc"), own.tolist(), strict=True):
        bundle.add_content(built(f"{name}/electrodes", *levels))
    send(bundle.build().dgram)
    results = []
    st.run(source, "simulated:", mode="color", seconds=0.3, listeners=[results.append])
    np.testing.assert_array_equal(results[-1].step.tactile.activation, own)
    assert {each for result in results for each in result.sequence.site.tolist()} > {9, 18}
    assert results[-1].sequence.slots == 3


class TestStimuli(StimulusContract):
    ends = False

    def make(self, profile):
        self.source = st.open_source(f"osc:{free_port()}", profile)
        return self.source

    def make_impossible(self, profile):
        st.open_source("osc:nowhere", profile)

    def pause(self):
        self.source._take(built("point", 0.5, 0.5, float(self.source.given % 2)).dgram)
