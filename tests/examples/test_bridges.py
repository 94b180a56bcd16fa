"""Tests of the programs in examples/bridges, with real OSC, LSL and MCAP senders."""

import io
import runpy
import socket
import threading
import time
import uuid
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import smarttouch as st

from ..support.runs import until

BRIDGES = Path(__file__).parents[2] / "examples" / "bridges"
DOT = np.eye(64, dtype=np.float32)[27]
LINE = np.where(np.arange(64) // 4 == 8, 0, 255).astype(np.uint8) * np.ones((64, 1), np.uint8)


@pytest.fixture
def puts(monkeypatch):
    """Patterns that a bridge has passed to `Session.put`."""
    given, put = [], st.Session.put

    def note(session, pattern):
        put(session, pattern)
        given.append(np.asarray(pattern.image if isinstance(pattern, st.Frame) else pattern))

    monkeypatch.setattr(st.Session, "put", note)
    return given


def start(name, *arguments):
    main = runpy.run_path(str(BRIDGES / f"{name}.py"))["main"]
    bridge = threading.Thread(target=main, args=arguments, daemon=True)
    bridge.start()
    return bridge


def has(puts, pattern):
    return any(np.array_equal(each, pattern) for each in [*puts])


def test_osc(puts, capsys):
    clients = pytest.importorskip("pythonosc.udp_client")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        port = line.getsockname()[1]
    bridge = start("osc_bridge", "memory:", "0.6", None, str(port))
    with clients.SimpleUDPClient("127.0.0.1", port) as client:
        while not (has(puts, DOT) and has(puts, LINE) and has(puts, np.zeros(64))):
            assert bridge.is_alive()
            client.send_message("/smarttouch/electrodes", DOT.tolist())
            client.send_message("/smarttouch/image", [64, 64, *LINE.ravel().tolist()])
            for wrong in ("/smarttouch/electrodes", "/smarttouch/image", "/elsewhere"):
                client.send_message(wrong, [2.0])
            time.sleep(1.0 if has(puts, LINE) else 0.05)
        client.send_message("/smarttouch/stop", [])
        bridge.join(60)
    out = capsys.readouterr().out
    assert out.startswith("WARNING: anybody on this machine")
    assert "unknown /elsewhere: " in out
    assert int(out.splitlines()[-1].split()[0]) > 0


def test_lsl(puts, capsys):
    pylsl = pytest.importorskip("pylsl")
    name = f"smarttouch-test-{uuid.uuid4().hex}"
    outlet = pylsl.StreamOutlet(pylsl.StreamInfo(name, "Tactile", 64, 60, "float32", name))
    bridge = start("lsl_bridge", name, "memory:", "0.6")
    (found, *_) = pylsl.resolve_byprop("name", "smarttouch-markers", timeout=60)
    markers, marker = pylsl.StreamInlet(found), None
    markers.open_stream(timeout=60)
    until(outlet.have_consumers)
    while marker is None or not has(puts, DOT):
        assert bridge.is_alive()
        for sample in (DOT, 2 * DOT):
            outlet.push_sample(sample.tolist())
        marker = marker or markers.pull_sample(timeout=0.02)[0]
    assert marker[0].startswith("pattern ")
    del outlet
    bridge.join(60)
    out = capsys.readouterr().out
    assert out.startswith("WARNING: anybody on this network")
    assert "a sample was ignored: " in out
    assert int(out.splitlines()[-1].split()[0]) > 0


STAMP = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
TYPES = """
===
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
===
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec"""
RAW = "uint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n"


@pytest.mark.parametrize("encoding", ["mono8", "bgr8", "png"])
def test_ros_images(puts, capsys, tmp_path, encoding):
    writers = pytest.importorskip("mcap_ros2.writer")
    image = np.repeat(LINE[:, :, None], 3, axis=2) if encoding == "bgr8" else LINE
    kind, words, message = "Image", RAW, {"header": STAMP, "data": image.tobytes()}
    message |= {"height": 64, "width": 64, "encoding": encoding, "is_bigendian": 0}
    message["step"] = image.strides[0]
    if encoding == "png":
        kind, words, file = "CompressedImage", "string format\n", io.BytesIO()
        Image.fromarray(LINE).save(file, "PNG")
        message = {"header": STAMP, "format": "png", "data": file.getvalue()}
    with (tmp_path / "bag.mcap").open("wb") as file:
        writer = writers.Writer(file)
        text = f"std_msgs/Header header\n{words}uint8[] data{TYPES}"
        schema = writer.register_msgdef(f"sensor_msgs/msg/{kind}", text)
        for number in range(20):
            time_ns = 10**18 + 30_000_000 * number
            writer.write_message("/camera", schema, message, time_ns, time_ns)
        writer.finish()
    begun_s = time.monotonic()
    start("mcap_playback", tmp_path / "bag.mcap", "/camera", "memory:", "0.6").join(60)
    assert time.monotonic() - begun_s >= 0.57
    np.testing.assert_array_equal(puts[0].reshape(64, 64, -1)[:, :, 0], LINE)
    count, _, delivered, *_ = capsys.readouterr().out.split()
    assert int(count) == len(puts) == 20
    assert int(delivered) > 0
