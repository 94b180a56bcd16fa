"""Order of the gallery: what a new reader needs first."""

ORDER = (
    "first_touch",
    "image_to_skin",
    "own_array",
    "own_kernels",
    "whole_frames",
    "one_finger",
    "array_study",
    "natural_mode",
    "electric_mouse",
    "primary_colors",
    "frequency_discrimination",
    "paper_figures",
    "paper_effects",
    "activating_function",
    "strength_duration",
    "read_a_page",
    "braille_page",
    "record_and_replay",
    "safety_gate",
    "own_board",
    "live_camera",
    "own_stimulus",
    "own_imaging",
    "own_experiment",
    "irregular_array",
    "analyze_recording",
    "show_patterns",
    "two_intervals",
    "own_feed",
    "errors",
)


def position(filename: str) -> int:
    """Return the place of a script; one that has none is an error of the build."""
    return ORDER.index(filename.removesuffix(".py"))
