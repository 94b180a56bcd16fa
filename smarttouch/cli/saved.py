"""Settings of ``smarttouch live`` under a name: ``--save`` keeps them, ``--as`` uses them."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from smarttouch.cli.run_options import RunOptions
    from smarttouch.imaging.mapping import Tone
    from smarttouch.running.config import RunConfig
    from smarttouch.running.saved import SavedRun


def _use(context: typer.Context, name: str | None) -> str | None:
    """Let kept settings stand for the options that are not given."""
    if name is not None:
        from smarttouch.running.saved import load_run

        context.default_map = as_options(load_run(name))
    return name


SaveOption = Annotated[
    str | None,
    typer.Option("--save", metavar="NAME", help="Keep these settings, all but the intensity."),
]
UseOption = Annotated[
    str | None,
    typer.Option(
        "--as",
        metavar="NAME",
        is_eager=True,
        callback=_use,
        help="Settings kept before; options given beside it win.",
    ),
]


def as_options(saved: "SavedRun") -> dict[str, Any]:
    """Return kept settings by the names of options."""
    config, options = saved.config, dict(saved.source_options)
    if isinstance(size := options.get("size"), tuple):
        options["size"] = "x".join(map(str, size))
    names = (
        "mode", "scan", "seconds", "softness", "light_on_dark", "measure", "hold", "balance",
        "subject", "note",
    )  # fmt: skip
    given = {
        "source": saved.source,
        "rate_hz": config.rate_hz,
        "seed": config.seed or None,
        **{name: getattr(saved, name) for name in ("board", "vibrators", "force", "profile")},
        **{name: getattr(config, name) for name in names},
        **options,
    }
    return {name: value for name, value in given.items() if value is not None}


def used_tone(name: str | None) -> "Tone | None":
    """Return the tone of kept settings, for which there is no option."""
    from smarttouch.running.saved import load_run

    return None if name is None else load_run(name).config.tone


def keep(
    name: str | None,
    used: str | None,
    run: "RunOptions",
    config: "RunConfig",
    source: str | None,
    options: dict[str, Any],
) -> None:
    """Keep settings under a name, if one is given; those that are used may be replaced."""
    if name is None:
        return
    from smarttouch.running.saved import SavedRun, save_run

    saved = SavedRun(
        source=source,
        board=run.board,
        vibrators=run.vibrators,
        force=run.force,
        profile=run.profile,
        source_options={
            key: value if isinstance(value, bool | int | float | tuple) else str(value)
            for key, value in options.items()
            if value is not None
        },
        config=config,
    )
    path = save_run(name, saved, overwrite=name == used)
    typer.echo(f"kept as {name!r} in {path}; intensity is given anew for each run", err=True)
