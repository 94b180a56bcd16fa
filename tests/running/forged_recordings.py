"""Forged recordings: whole files with one impossible thing in them."""

import json
import random

from mcap.writer import Writer

from smarttouch.running.recording_reader import Recording

STRANGE = (
    None, True, False, 0, -1, 1, 2, 255, 65_535, 65_536, 2**31, 2**63, -(2**63), 10**30, 10**400,
    0.5, -0.5, 1e-300, 1e30, 1e308, -1e308, float("nan"), float("inf"), float("-inf"), "", "RA",
    "XX", "\0", "\x1b]0;x\x07", "é" * 40, "A" * 70_000, "AAAA", [], [0], [None], ["RA"], [[]],
    [1e30] * 64, [0] * 64, [-1] * 8, {}, {"a": 1}, "[" * 20_000,
)  # fmt: skip


def take_apart(path):
    """Return a recording's metadata, and the topics, contents and indexes of its messages."""
    recording = Recording(path)
    return recording.about, [
        (topic, json.loads(each.data), each.log_time, each.sequence)
        for topic, each in recording.messages()
    ]


def put_together(path, about, messages):
    """Write a recording, with checksums that hold."""
    with path.open("wb") as file:
        writer, channels = Writer(file), {}
        writer.start(profile="smarttouch", library="forged")
        writer.add_metadata("smarttouch", about)
        for topic, content, time_ns, index in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", 0)
            data = content if isinstance(content, bytes) else json.dumps(content).encode()
            writer.add_message(
                channels[topic], log_time=time_ns, publish_time=time_ns, sequence=index, data=data
            )
        writer.finish()


def changed(content, chance):
    """Return JSON content with one value, anywhere in it, made strange."""
    content = json.loads(json.dumps(content))
    places = [(content, key) for key in content]
    for table, key in places:
        inner = table[key]
        if isinstance(inner, dict):
            places += [(inner, each) for each in inner]
        elif isinstance(inner, list) and len(inner) < 100:
            places += [(inner, each) for each in range(len(inner))]
    table, key = chance.choice(places)
    if isinstance(table, dict) and chance.random() < 0.1:
        del table[key]
    else:
        table[key] = chance.choice(STRANGE)
    return content


def forge(path, parts, seed):
    """Write the mutant of a recording that a seed stands for; return what was done to it."""
    chance = random.Random(seed)
    about, messages = dict(parts[0]), list(parts[1])
    what = chance.choice(("settings", "profile", "about", "message", "message", "order"))
    if what in ("settings", "profile"):
        about[what] = json.dumps(changed(json.loads(about[what]), chance))
    elif what == "about":
        key = chance.choice(sorted(about))
        about[key] = chance.choice(("", "[" * 5000, "null", "9" * 5000, "[]", "{}", "-1", "1e99"))
    elif what == "message":
        # The earlier, the more depends on it.
        at = int(len(messages) * chance.random() ** 3)
        topic, content, time_ns, index = messages[at]
        messages[at] = (topic, changed(content, chance), time_ns, index)
        what += f" {topic}"
    else:
        at, other = (chance.randrange(len(messages)) for _ in range(2))
        messages[at], messages[other] = messages[other], messages[at]
    put_together(path, about, messages)
    return what


def damage(data, seed):
    """Return the bytes of a file with some of them changed, cut off or doubled."""
    chance = random.Random(seed)
    broken = bytearray(data)
    how = chance.randrange(4)
    if how == 0:
        return bytes(broken[: chance.randrange(len(broken))])
    if how == 1:
        first, last = sorted(chance.randrange(len(broken)) for _ in range(2))
        return bytes(broken[:last] + broken[first:])
    for _ in range(chance.choice((1, 1, 2, 20))):
        # The head of a file says more than the rest of it.
        at = int(len(broken) * chance.random() ** chance.choice((1, 4)))
        broken[at] = chance.randrange(256)
    return bytes(broken)
