"""What 1.0.0rc1 had and this version has not, with what to use instead; goes with the next version.

The same tables are on the page "Install", section "From 1.0rc1".
"""

from typing import Any

COMMANDS = {
    "report": "give the output of smarttouch devices and the text of the error",
    "recordings view": "open the file in Foxglove",
    "recordings repair": "a damaged file opens up to its last whole chunk",
    "recordings export": "load_recording(FILE).arrays in Python gives the arrays",
    "calibrate level": "set the level with the keys + and - during a run",
}
OPTIONS = {
    "--stream": "run examples/bridges/lsl.py",
    "--robust": "leave it out",
    "--three-state": "leave it out; the profile's output.kind decides",
}
URLS = {
    "draw": "use socket:PATH, or Session.put in Python",
    "lsl": "run examples/bridges/lsl.py",
    "mcap": "run examples/bridges/ros.py",
    "osc": "run examples/bridges/osc.py",
    "vibrators": "use the option --vibrators FILE.wav",
}
PROFILE_KEYS = {
    "kernels.objective": "remove it; kernels are designed for nodes",
    "kernels.anatomy": "remove it; kernels are designed for nodes",
    "kernels.fingers": "remove it; kernels are designed for nodes",
    "perception.level": "remove it, and set the level with the keys during a run",
    "perception.anatomy": "remove it, and choose the simulated finger with --finger",
    "skin.layers": "remove it; set medium = 'half-space' and conductivity_s_per_m",
    "skin.spread": "remove it; kernels are designed for the nominal finger",
}


def instead_of(table: dict[str, str], name: str) -> str | None:
    """Return the sentence that tells what to use instead of a name; None if it was not removed."""
    instead = table.get(name)
    return instead and f"{name} was removed after 1.0.0rc1: {instead}"


def without_removed(profile: dict[str, Any]) -> dict[str, Any]:
    """Return the table of a profile in a recording without removed keys that changed no kernel."""
    for key in PROFILE_KEYS:
        *parents, last = key.split(".")
        table = profile
        for parent in parents:
            table = table.get(parent, {})
        if table.get(last) != "finger" and not (last == "layers" and table.get(last)):
            table.pop(last, None)
    return profile
