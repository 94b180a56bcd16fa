"""Images of rendered text under the array, for reading without an optical sensor."""

from smarttouch.imaging.sensor_registration import PIXELS_PER_CELL
from smarttouch.profile import Profile

FEWEST_ROWS = 4  # fewest rows on which letters can be distinguished
SAMPLES_PER_PITCH = 4  # number of pulses of an electrode while the text moves by one pitch
_PRESS = 1.1  # force of a virtual finger that reads, relative to the profile's full force


def profile_for_reading(profile: Profile) -> Profile:
    """Return a copy of a profile in which a frame shows exactly the area of the array, at scale 1.

    Rendered text is not seen by a sensor, so the copy has no magnification, rotation, offset,
    homography or flat field.
    """
    width_mm, height_mm = profile.electrodes.extent_mm
    pixel_mm = pixel_pitch_mm(profile)
    columns, rows = round(width_mm / pixel_mm), round(height_mm / pixel_mm)
    optics = profile.optics.model_copy(
        update={
            "sensor_columns": columns,
            "sensor_rows": rows,
            "field_width_mm": columns * pixel_mm,
            "field_height_mm": rows * pixel_mm,
            "magnification": 1.0,
            "rotation_deg": 0.0,
            "offset_x_mm": 0.0,
            "offset_y_mm": 0.0,
            "homography": None,
            "flat_field": None,
        }
    )
    return profile.model_copy(update={"optics": optics})


def pixel_pitch_mm(profile: Profile) -> float:
    """Return the pixel size of the image under the array, mm."""
    return min(profile.electrodes.cell_mm) / PIXELS_PER_CELL


def usual_speed_mm_s(profile: Profile, rate_hz: float | None = None) -> float:
    """Return the speed, mm/s, at which text moves a pitch in `SAMPLES_PER_PITCH` pulse periods."""
    rate_hz = profile.pulse.rate_hz if rate_hz is None else rate_hz
    return profile.electrodes.cell_mm[0] * rate_hz / SAMPLES_PER_PITCH


def reading_force_n(profile: Profile) -> float:
    """Return the force of a virtual finger, N, sufficient for full intensity."""
    return _PRESS * profile.force.full_n


def rows_of(profile: Profile) -> int:
    """Return the number of rows of electrodes of an array."""
    return len({round(float(y), 3) for y in profile.electrodes.position_mm[:, 1]})
