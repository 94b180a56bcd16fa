"""Helpers to read the messages of a recording, change them, and write a new recording."""

import json

from mcap.writer import Writer

from smarttouch.running.recording_format import digest_of
from smarttouch.running.recording_reader import RecordedRun


def take_apart(path):
    """Return a recording's metadata, and topic, content, time and index of each message."""
    recording = RecordedRun(path)
    return recording.about, [
        (topic, json.loads(each.data), each.log_time, each.sequence)
        for topic, each in recording.messages()
    ]


def put_together(path, about, messages):
    """Write a recording from metadata and messages, with valid checksums and a valid digest."""
    about = about | {"digest": digest_of(about)}
    with path.open("wb") as file:
        writer, channels = Writer(file), {}
        writer.start(profile="smarttouch", library="forged")
        writer.add_metadata("smarttouch", about)
        for topic, content, time_ns, index in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", 0)
            writer.add_message(
                channels[topic], log_time=time_ns, publish_time=time_ns, sequence=index,
                data=json.dumps(content).encode(),
            )  # fmt: skip
        writer.finish()
