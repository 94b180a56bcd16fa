"""Settings of a command under a name: ``--save`` keeps them, ``--as`` uses them."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smarttouch.cli.option_groups import OptionGroup
from smarttouch.cli.standard_input import is_standard_input
from smarttouch.errors import SavedRunError

if TYPE_CHECKING:
    from smarttouch.cli.run_options import RunOptions
    from smarttouch.imaging.mapping import Tone
    from smarttouch.running.config import RunConfig
    from smarttouch.running.saved import SavedRun


_NOT_KEPT = (
    "save", "settings", "intensity", "quiet", "plain", "speak", "json_file", "felt", "finger",
    "anatomy", "frames", "record", "foxglove", "window", "plot", "output", "overwrite", "password",
    "tables",
)  # fmt: skip
"""Names of options that are given anew for each run."""
_PLACES = ("source", "texture", "profile", "motion", "force", "follow")
"""Names of options whose values may name a file."""


def _use(context: typer.Context, name: str | None) -> str | None:
    """Let kept settings stand for the options that are not given."""
    if name is None:
        return None
    from smarttouch.running.saved import load_options, load_run

    command = _command(context)
    if command == "live":
        context.default_map = as_options(load_run(name))
    else:
        known = {each.name for each in context.command.params if each.name} - {*_NOT_KEPT}
        context.default_map = load_options(name, command, known)
    return name


def _command(context: typer.Context) -> str:
    """Return the name of a command, with those of the groups it is in."""
    above = context.parent
    if above is None or above.parent is None:
        return str(context.info_name)
    return f"{above.info_name} {context.info_name}"


def use_option(*names: str) -> Any:
    """Return the option that uses kept settings, by its names."""
    return typer.Option(
        *names,
        metavar="NAME",
        is_eager=True,
        callback=_use,
        help="Use kept settings; given options win.",
    )


@dataclass(frozen=True, kw_only=True)
class SavedSettings(OptionGroup):
    """Options that keep the settings of a command, and use them again."""

    save: Annotated[
        str | None,
        typer.Option("--save", metavar="NAME", help="Keep settings, but the intensity."),
    ] = None
    settings: Annotated[str | None, use_option("--settings", "--as")] = None

    def keep(self, context: typer.Context) -> None:
        """Keep the options that were given, under a name if there is one."""
        if self.save is None:
            return
        _require_kept_source(context)
        from smarttouch.running.saved import SavedOptions, save_options

        given = {
            key: _from_anywhere(key, value)
            for key, value in context.params.items()
            if key not in _NOT_KEPT and _is_given(context, key) and value is not None
        }
        saved = SavedOptions(command=_command(context), options=given)
        replaced = self.save == context.params["settings"]
        _say(self.save, save_options(self.save, saved, overwrite=replaced))

    def keep_run(
        self,
        context: typer.Context,
        run: "RunOptions",
        config: "RunConfig",
        sensor: str | None,
        options: dict[str, Any],
    ) -> None:
        """Keep the settings of a run, under a name if there is one."""
        if self.save is None:
            return
        _require_kept_source(context)
        from smarttouch.running.saved import SavedRun, save_run

        saved = SavedRun(
            source=sensor,
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
        _say(self.save, save_run(self.save, saved, overwrite=self.save == self.settings))


def _is_given(context: typer.Context, key: str) -> bool:
    """Return whether an option was given, or is among the settings that are used."""
    source = context.get_parameter_source(key)
    return source is not None and source.name in ("COMMANDLINE", "DEFAULT_MAP")


def _from_anywhere(key: str, value: Any) -> Any:
    """Return the value of an option, with the whole path of a file that it names."""
    from smarttouch.running.saved import from_anywhere

    if isinstance(value, Path):
        return str(value.absolute())
    if key not in _PLACES or not isinstance(value, str):
        return value
    # Options may stand behind its name.
    file = any(Path(each).is_file() for each in (value, value.rpartition("?")[0]))
    return str(Path(value).absolute()) if file else from_anywhere(value)


def _require_kept_source(context: typer.Context) -> None:
    if is_standard_input(context):
        raise SavedRunError(
            "what comes by standard input cannot be kept: give a file, or keep nothing",
            about="source",
            problem="impossible",
            remedy="save",
        )


def _say(name: str, path: Path) -> None:
    typer.echo(f"kept as {name!r} in {path}; intensity is given anew for each run", err=True)


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
