"""``smarttouch profiles``: what is shipped, at a glance."""


def profiles() -> None:
    """List the shipped profiles."""
    from rich.console import Console
    from rich.table import Table

    from smarttouch.profile import DEFAULT_PROFILE, load_profile, profile_names
    from smarttouch.resources import data_folder

    table = Table(title="Profiles", title_justify="left")
    for heading in ("name", "what it is", "electrodes", "board", "pulse", "rate"):
        table.add_column(heading)
    for name in profile_names():
        profile = load_profile(name)
        star = " (default)" if name == DEFAULT_PROFILE else ""
        table.add_row(
            name + star,
            profile.title,
            str(len(profile.electrodes)),
            profile.output.kind,
            f"{profile.pulse.width_us} µs",
            f"{profile.pulse.rate_hz:g} Hz",
        )
    console = Console()
    console.print(table)
    console.print(
        f"Copy one from {data_folder('calibration')} to make your own, and give its file "
        "to --profile.",
        style="dim",
        soft_wrap=True,
    )
