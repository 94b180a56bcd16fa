"""``smarttouch profiles``: what is shipped, at a glance."""

from smarttouch import terminal


def profiles() -> None:
    """List the shipped profiles."""
    from rich.table import Table

    from smarttouch.profile import DEFAULT_PROFILE, list_profiles, load_profile
    from smarttouch.resources import data_folder

    table = Table(box=None, pad_edge=False)
    for heading in ("name", "what it is", "board"):
        table.add_column(heading, no_wrap=heading == "name")
    for name in list_profiles():
        profile = load_profile(name)
        star = " (default)" if name == DEFAULT_PROFILE else ""
        pulse = profile.pulse
        table.add_row(
            name + star,
            profile.title,
            f"{profile.output.kind}, {pulse.width_us} µs, {pulse.rate_hz:g} Hz",
        )
    console = terminal.console()
    console.print(table)
    console.print(
        f"Copy one from {data_folder('calibration')} to make your own, and give its file "
        "to --profile.",
        style="dim",
        soft_wrap=True,
    )
