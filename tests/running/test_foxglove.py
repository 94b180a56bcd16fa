"""The layout for Foxglove: it names topics and values that recordings have."""

import json
from pathlib import Path

from smarttouch.running.recording_format import SCHEMAS

LAYOUT = Path(__file__).parents[2] / "docs" / "how-to" / "foxglove-layout.json"


def test_the_layout_names_what_there_is():
    layout = json.loads(LAYOUT.read_text("utf-8"))
    paths = []
    for panel in layout["configById"].values():
        paths += [panel["imageMode"]["imageTopic"]] if "imageMode" in panel else []
        paths += [panel["topicToRender"]] if "topicToRender" in panel else []
        paths += [path["value"] for path in panel.get("paths", ())]
    assert len(paths) == 6
    for path in paths:
        topic, _, key = path.partition(".")
        assert topic in SCHEMAS
        assert not key or key in SCHEMAS[topic][1]

    def panels(part):
        if isinstance(part, str):
            return [part]
        return [*panels(part["first"]), *panels(part["second"])]

    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
