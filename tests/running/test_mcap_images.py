"""Images of other programs' files, written by their own writers, come out at their times."""

import base64
import json
from io import BytesIO

import numpy as np
import pytest
from mcap.writer import Writer
from PIL import Image

import smarttouch as st
from smarttouch.base.errors import SmartTouchError, SourceError
from smarttouch.running.mcap_images import McapImages
from smarttouch.testing.source_contracts import SourceContract

from ..raising import raises

IMAGES = [np.random.default_rng(each).integers(0, 256, (12, 10), np.uint8) for each in range(6)]
TIMES_NS = [10**18 + round(each * 1e9) for each in (0, 0.1, 0.2, 0.5, 0.6, 0.65)]
ROS_HEADER = "std_msgs/Header header\n"
ROS_TYPES = (
    "\n===\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id"
    "\n===\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec"
)
ROS_RAW = (
    f"{ROS_HEADER}uint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n"
    f"uint8[] data{ROS_TYPES}"
)
ROS_COMPRESSED = f"{ROS_HEADER}string format\nuint8[] data{ROS_TYPES}"
STAMP = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}


def png(image):
    file = BytesIO()
    Image.fromarray(image).save(file, "PNG")
    return file.getvalue()


def write_ros(path, kind="Image", encoding="mono8", images=IMAGES, topic="/camera"):
    """Write a bag as ROS 2 does."""
    writers = pytest.importorskip("mcap_ros2.writer")
    with path.open("wb") as file:
        writer = writers.Writer(file)
        text = ROS_RAW if kind == "Image" else ROS_COMPRESSED
        schema = writer.register_msgdef(f"sensor_msgs/msg/{kind}", text)
        for image, time_ns in zip(images, TIMES_NS, strict=False):
            given = {"header": STAMP, "data": image.tobytes()}
            if kind == "Image":
                height, width = image.shape[:2]
                given |= {"height": height, "width": width, "encoding": encoding}
                given |= {"is_bigendian": 0, "step": image.strides[0]}
            else:
                given |= {"format": "png", "data": png(image)}
            writer.write_message(topic, schema, given, log_time=time_ns, publish_time=time_ns)
        writer.finish()


def write_json(path, topics=("/camera",)):
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("foxglove.CompressedImage", "jsonschema", b"{}")
        for topic in topics:
            channel = writer.register_channel(topic, "json", schema)
            for image, time_ns in zip(IMAGES, TIMES_NS, strict=True):
                text = {"format": "png", "data": base64.b64encode(png(image)).decode()}
                writer.add_message(channel, time_ns, json.dumps(text).encode(), time_ns)
        writer.finish()


def write_protobuf(path):
    foxglove = pytest.importorskip("foxglove")
    pytest.importorskip("mcap_protobuf")
    from foxglove.channels import RawImageChannel
    from foxglove.messages import RawImage

    context = foxglove.Context()
    with foxglove.open_mcap(path, context=context):
        channel = RawImageChannel("/camera", context=context)
        for image, time_ns in zip(IMAGES, TIMES_NS, strict=True):
            given = RawImage(width=10, height=12, encoding="mono8", step=10, data=image.tobytes())
            channel.log(given, log_time=time_ns)


def read_all(clip):
    clip.open()
    found, times_ns = [], []
    for number in range(100):
        due_ns = clip.due_ns(number)
        image = clip.next()
        if image is None:
            break
        found.append(image)
        times_ns.append(due_ns)
        assert clip.due_ns(number) == due_ns
    return found, times_ns


@pytest.mark.parametrize("write", [
    write_ros, lambda path: write_ros(path, "CompressedImage"), write_json, write_protobuf,
])  # fmt: skip
def test_images_come_at_the_times_of_their_messages(tmp_path, write):
    path = tmp_path / "run.mcap"
    write(path)
    images, times_ns = read_all(McapImages(path))
    np.testing.assert_array_equal(images, IMAGES)
    assert times_ns == [each - TIMES_NS[0] for each in TIMES_NS]


@pytest.mark.parametrize(("encoding", "given"), [
    ("8UC1", lambda gray: gray),
    ("mono16", lambda gray: gray.astype(np.uint16) * 256 + 7),
    ("rgb8", lambda gray: np.stack([gray, gray // 2, gray // 3], -1)),
    ("bgr8", lambda gray: np.stack([gray // 3, gray // 2, gray], -1)),
    ("bgra8", lambda gray: np.stack([gray // 3, gray // 2, gray, gray], -1)),
])  # fmt: skip
def test_encodings_of_ros(tmp_path, encoding, given):
    """Red is .299, green .587 and blue .114 of gray; rows may be longer than their pixels."""
    write_ros(tmp_path / "0.mcap", encoding=encoding, images=[given(each) for each in IMAGES])
    images, _ = read_all(McapImages(tmp_path / "0.mcap"))
    for image, gray in zip(images, IMAGES, strict=True):
        color = encoding not in ("8UC1", "mono16")
        expected = 0.299 * gray + 0.587 * (gray // 2) + 0.114 * (gray // 3) if color else gray
        assert np.abs(image - expected).max() <= 1


def test_a_bag_is_a_folder_of_files_and_may_be_cut(tmp_path):
    """Its parts follow each other; what a killed recorder left is read to its end."""
    for name in ("bag_0.mcap", "bag_1.mcap"):
        write_ros(tmp_path / name)
    images, _ = read_all(McapImages(tmp_path))
    assert len(images) == 12
    cut = tmp_path / "bag_1.mcap"
    cut.write_bytes(cut.read_bytes()[:-300])
    images, _ = read_all(McapImages(cut, "/camera"))
    assert len(images) == 6


@pytest.mark.parametrize(("topic", "words"), [
    (None, ["2 topics", "/a, /b"]), ("/c", ["/c", "/a, /b"]),
])  # fmt: skip
def test_topics_are_named(tmp_path, topic, words):
    write_json(tmp_path / "run.mcap", ("/a", "/b"))
    with raises(SourceError, about="topic") as error:
        McapImages(tmp_path / "run.mcap", topic).open()
    assert all(each in str(error.value) for each in words)


@pytest.mark.parametrize(("images", "encoding"), [
    ([IMAGES[0].astype(np.float32)], "32FC1"), ([IMAGES[0][:, :3]], "rgb8"),
    ([np.zeros((1, 1), np.uint8)], "mono8"),
])  # fmt: skip
def test_images_that_are_none_are_one_sentence(tmp_path, images, encoding):
    write_ros(tmp_path / "run.mcap", encoding=encoding, images=images)
    clip = McapImages(tmp_path / "run.mcap")
    clip.open()
    with raises(SourceError, about="image", value="run.mcap"):
        clip.next()


@pytest.mark.parametrize("make", [
    lambda path: None, lambda path: path.mkdir(), lambda path: path.write_bytes(b"x" * 99),
])  # fmt: skip
def test_what_is_no_file_of_images_is_one_sentence(tmp_path, profile, make):
    make(tmp_path / "run.mcap")
    with pytest.raises(SmartTouchError) as error:
        st.open_source(f"mcap:{tmp_path / 'run.mcap'}", profile)
    assert "\n" not in str(error.value)


class TestUnpaced(SourceContract):
    @pytest.fixture(autouse=True)
    def file(self, tmp_path):
        self.path = tmp_path / "run.mcap"
        write_json(self.path)

    def make(self, profile):
        return st.open_source(f"mcap:{self.path}?topic=/camera&unpaced", profile)

    def make_impossible(self, profile):
        st.open_source(f"mcap:{self.path}.not", profile)


class TestPaced(TestUnpaced):
    def make(self, profile):
        return st.open_source(f"mcap:{self.path}", profile)

    def pause(self):
        import time

        time.sleep(0.02)
