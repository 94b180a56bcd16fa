"""The bridges of examples/bridges, each with a program of its kind at the other end."""

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

from ..waiting import until

pytestmark = pytest.mark.usefixtures("patient_boards")

BRIDGES = Path(__file__).parents[2] / "examples" / "bridges"
DOT = np.eye(64, dtype=np.float32)[27]
LINE = np.where(np.arange(64) // 4 == 8, 0, 255).astype(np.uint8) * np.ones((64, 1), np.uint8)


@pytest.fixture
def puts(monkeypatch):
    """What a bridge has put, as its session has it."""
    given, put = [], st.Session.put

    def note(session, pattern, *rest):
        put(session, pattern, *rest)
        given.append(np.asarray(pattern.image if isinstance(pattern, st.Frame) else pattern))

    monkeypatch.setattr(st.Session, "put", note)
    return given


@pytest.fixture
def bridge():
    """Start one in a thread; it must have ended by the end of the test."""
    threads = []

    def start(name, *arguments):
        main = runpy.run_path(str(BRIDGES / f"{name}_bridge.py"))["main"]
        threads.append(threading.Thread(target=main, args=arguments, daemon=True))
        threads[-1].start()
        return threads[-1]

    yield start
    for each in threads:
        each.join(60)
        assert not each.is_alive()


def has(puts, pattern):
    return any(np.array_equal(each, pattern) for each in [*puts])


@pytest.mark.parametrize("path", sorted(BRIDGES.glob("*.py")), ids=lambda path: path.stem)
def test_a_bridge_is_short_and_uses_public_names(path):
    lines = path.read_text("utf-8").splitlines()
    assert len(lines) <= 50
    assert [each for each in lines if "smarttouch as" in each or "from smarttouch" in each] == [
        "import smarttouch as st"
    ]


def test_osc(bridge, puts, capsys):
    clients = pytest.importorskip("pythonosc.udp_client")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        port = line.getsockname()[1]
    client = clients.SimpleUDPClient("127.0.0.1", port)
    running = bridge("osc", "memory:", "0.6", None, str(port))
    with client:
        while not (has(puts, DOT) and has(puts, LINE) and has(puts, np.zeros(64))):
            assert running.is_alive()
            client.send_message("/smarttouch/electrodes", DOT.tolist())
            client.send_message("/smarttouch/image", [64, 64, *LINE.ravel().tolist()])
            client.send_message("/smarttouch/electrodes", [2.0])
            client.send_message("/smarttouch/image", [3])
            client.send_message("/elsewhere", [])
            time.sleep(0.05 if not has(puts, LINE) else 1.0)
        client.send_message("/smarttouch/stop", [])
        running.join(60)
    out = capsys.readouterr().out
    assert out.startswith("WARNING: anybody on this machine")
    assert "left out: /elsewhere" in out
    assert int(out.splitlines()[-1].split()[0]) > 0


def test_lsl(bridge, puts, capsys):
    pylsl = pytest.importorskip("pylsl")
    name = f"smarttouch-test-{uuid.uuid4().hex}"
    outlet = pylsl.StreamOutlet(pylsl.StreamInfo(name, "Tactile", 64, 60, "float32", name))
    running = bridge("lsl", name, "memory:", "0.6")
    (found, *_) = pylsl.resolve_byprop("name", "smarttouch-markers", timeout=60)
    markers = pylsl.StreamInlet(found)
    markers.open_stream(timeout=60)
    until(outlet.have_consumers)
    seen = None
    while seen is None or not has(puts, DOT):
        assert running.is_alive()
        outlet.push_sample(DOT.tolist())
        outlet.push_sample([2.0] * 64)
        seen = seen or markers.pull_sample(timeout=0.02)[0]
    assert seen[0].startswith("pattern ")
    del outlet
    running.join(60)
    out = capsys.readouterr().out
    assert out.startswith("WARNING: anybody on this network")
    assert "left out: " in out
    assert int(out.splitlines()[-1].split()[0]) > 0


HEADER = "std_msgs/Header header\n"
TYPES = (
    "\n===\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id"
    "\n===\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec"
)
RAW = "uint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data"


@pytest.mark.parametrize("encoding", ["mono8", "rgb8", "bgr8", "png"])
def test_ros_images(bridge, puts, capsys, tmp_path, encoding):
    writers = pytest.importorskip("mcap_ros2.writer")
    path, step_ns = tmp_path / "bag.mcap", 30_000_000
    colors = np.repeat(LINE[:, :, None], 3, axis=2)
    image = LINE if encoding in ("mono8", "png") else colors
    message = {"header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}}
    if encoding == "png":
        kind, words, file = "CompressedImage", "string format\nuint8[] data", io.BytesIO()
        Image.fromarray(LINE).save(file, "PNG")
        message |= {"format": "png", "data": file.getvalue()}
    else:
        kind, words = "Image", RAW
        message |= {"height": 64, "width": 64, "encoding": encoding, "is_bigendian": 0}
        message |= {"step": image.strides[0], "data": image.tobytes()}
    with path.open("wb") as file:
        writer = writers.Writer(file)
        schema = writer.register_msgdef(f"sensor_msgs/msg/{kind}", HEADER + words + TYPES)
        for number in range(20):
            time_ns = 10**18 + step_ns * number
            writer.write_message("/camera", schema, message, time_ns, time_ns)
        writer.finish()
    begun_s = time.monotonic()
    bridge("mcap", str(path), "/camera", "memory:", "0.6").join(60)
    assert time.monotonic() - begun_s >= 19 * step_ns / 1e9
    assert len(puts) == 20
    np.testing.assert_array_equal(puts[0].reshape(64, 64, -1)[:, :, 0], LINE)
    out = capsys.readouterr().out
    assert out.startswith("20 images, ")
    assert int(out.split()[2]) > 0
