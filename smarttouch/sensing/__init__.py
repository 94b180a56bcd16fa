"""Where frames come from: a finger over a page, and later cameras and files."""

from typing import Any

from smarttouch.errors import SensorError
from smarttouch.profile import Profile
from smarttouch.registry import find_opener
from smarttouch.sensing.frame import Sensor


def open_sensor(url: str, profile: Profile, **options: Any) -> Sensor:
    """Open a sensor by its URL, ``page:FILE`` or ``text:STRING``.

    Parameters
    ----------
    url : str
        Kind and place of the sensor.
    profile : Profile
        Its optics and the finger's force.
    **options
        What the kind of sensor takes; see its module.

    Raises
    ------
    SensorError
        If there is no such kind or it cannot be opened.
    """
    opener, rest = find_opener("smarttouch.sensors", url, SensorError)
    sensor: Sensor = opener(rest, profile, **options)
    return sensor
