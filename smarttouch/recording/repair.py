"""Repair of a cut or damaged recording, as a new file that every reader of MCAP accepts."""

from dataclasses import dataclass
from pathlib import Path

from smarttouch.errors import RecordingError
from smarttouch.files import owner_only, unwritable
from smarttouch.recording.reader import Recording
from smarttouch.recording.schemas import LAST, METADATA
from smarttouch.recording.writer import new_writer
from smarttouch.version import __version__


@dataclass(frozen=True)
class Repaired:
    """Result of a repair: what the new file holds; chunks left out because they are damaged."""

    path: Path
    messages: int
    steps: int
    seconds: float
    damaged_chunks: int


def is_sound(path: Path) -> bool:
    """Return whether a recording has its end, and all its chunks are intact."""
    recording = Recording(path)
    if recording.whole:
        for _ in recording.messages():
            pass
    return recording.whole


def repair(path: Path, output: Path | None = None) -> Repaired:
    """Write the readable part of a recording into a new file; the old one stays as it is.

    The new file is ``NAME-repaired.mcap`` beside the old one if not given. Raises RecordingError if
    the old one is not from SmartTouch, the new one exists, or the disk is full.
    """
    recording = Recording(path)
    output = path.with_name(f"{path.stem}-repaired.mcap") if output is None else output
    messages = steps = 0
    try:
        with open(output, "xb", opener=owner_only) as file:
            writer = new_writer(file)
            writer.start(profile=METADATA, library=f"smarttouch {__version__}")
            writer.add_metadata(METADATA, {**recording.about, "repaired_from": path.name})
            channels: dict[str, int] = {}
            for topic, message in recording.messages():
                if topic not in channels:
                    channel = recording.channels[message.channel_id]
                    schema = recording.schemas.get(channel.schema_id)
                    schema_id = 0
                    if schema is not None:
                        schema_id = writer.register_schema(
                            schema.name, schema.encoding, schema.data
                        )
                    channels[topic] = writer.register_channel(
                        topic, channel.message_encoding, schema_id
                    )
                writer.add_message(
                    channels[topic],
                    log_time=message.log_time,
                    publish_time=message.publish_time,
                    sequence=message.sequence,
                    data=message.data,
                )
                messages += 1
                steps += topic == LAST
            writer.finish()
    except FileExistsError:
        raise RecordingError(
            f"{output} exists: give another file", about="file", remedy="output"
        ) from None
    except OSError as error:
        raise unwritable(RecordingError, output, error) from None
    return Repaired(output, messages, steps, recording.duration_s, recording.damaged_chunks)
