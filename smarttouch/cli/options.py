"""Options that commands share. `RunOptions` builds the parts of a run. Help is plain text."""

import inspect
import sys
import tempfile
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from typer.core import TyperGroup

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import SmartTouchError, choice_of, require_within
from smarttouch.base.files import require_folder
from smarttouch.views.printable_output import draws

if TYPE_CHECKING:
    from smarttouch.profile import Profile
    from smarttouch.running.config import RunConfig
    from smarttouch.running.display import Display
    from smarttouch.running.step_records import Listener
    from smarttouch.sources.source_contract import Source

_T = TypeVar("_T")
_MOST_BYTES = 256_000_000  # largest standard input


def option(says: str, metavar: str | None = None, *names: str, **more: Any) -> Any:
    """Return a typer option, to annotate a parameter of a command."""
    return typer.Option(*names, help=says, metavar=metavar, **more)


def output_file(says: str, metavar: str, *names: str) -> Any:
    """Return a typer option for an output file, whose folder must exist."""
    return option(says, metavar, *names, callback=_in_a_folder)


def _in_a_folder(path: Path | None) -> Path | None:
    require_folder(path)
    return path


def argument(says: str, metavar: str | None = None, **more: Any) -> Any:
    """Return a typer argument, to annotate a parameter of a command."""
    return typer.Argument(help=says, metavar=metavar, **more)


class OptionGroup:
    """Base of frozen dataclasses whose fields are options, annotated for typer."""


def takes_options(command: Callable[..., _T]) -> Callable[..., _T]:
    """Let a command receive each option group as one object (decorator)."""
    taken: list[inspect.Parameter] = []
    groups: dict[str, tuple[Any, list[str]]] = {}
    for parameter in inspect.signature(command).parameters.values():
        if inspect.isclass(parameter.annotation) and issubclass(parameter.annotation, OptionGroup):
            fields = [*inspect.signature(parameter.annotation).parameters.values()]
            groups[parameter.name] = parameter.annotation, [field.name for field in fields]
            taken += fields
        else:
            taken.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))

    def expanded(**given: Any) -> _T:
        for name, (group, names) in groups.items():
            given[name] = group(**{field: given.pop(field) for field in names})
        return command(**given)

    expanded.__name__, expanded.__doc__ = command.__name__, command.__doc__
    expanded.__annotations__ = {parameter.name: parameter.annotation for parameter in taken}
    # Typer reads __signature__. Type checkers do not know this attribute, so set it by vars.
    vars(expanded)["__signature__"] = inspect.Signature(taken)
    return expanded


def read_form(
    form: Callable[..., Any], text: str, error: type[SmartTouchError], but: Collection[str] = ()
) -> tuple[str, dict[str, Any]]:
    """Parse ``NAME?OPTIONS`` into name and options: parameters of ``form`` that have a default."""
    from smarttouch.base.urls import options_of, read_options

    name, accepted = read_options(form, text, error, but)
    if "?" in name:
        known = ", ".join(sorted(options_of(form, but)))
        raise error(f"{name!r} has an unknown option: choose {known}")
    return name, accepted


def parse_mode(mode: str) -> Mode:
    """Parse the name of a mode. Color mode is rejected: only a source can choose this mode."""
    return choice_of("mode", mode, [known for known in Mode if known is not Mode.COLOR])


def parse_afferent(mode: str) -> Afferent:
    """Parse the name of an afferent class."""
    return Afferent[choice_of("mode", mode, Afferent.__members__)]


def require_site(profile: "Profile", site: int) -> None:
    """Raise SmartTouchError unless the array has this site."""
    words = f"site {site} of {profile.name}"
    require_within(SmartTouchError, "site", site, 0, len(profile.electrodes) - 1, words)


ProfileOption = Annotated[
    str | None, option("Use this profile (default: the board's own).", "NAME|FILE")
]
ArrayOption = Annotated[
    str, option("Use this profile; smarttouch profiles lists them.", "NAME|FILE")
]
ClassOption = Annotated[str, option("Choose the class to stimulate: RA, SAI or PC.", "CLASS")]
ModeOption = Annotated[
    str, option("Choose the class to stimulate: RA, SAI, PC or natural.", "CLASS")
]
JsonOption = Annotated[Path | None, output_file("Write the results as JSON.", "FILE", "--json")]
ForceOption = Annotated[
    str | None,
    option("Measure finger force with hx711:PORT or loadcell:PORT, or assume fixed:N.", "URL"),
]


@dataclass(frozen=True, kw_only=True)
class RunOptions(OptionGroup):
    """Options of all commands that run a source, as the user typed them."""

    board: Annotated[
        str | None,
        option(
            "Drive this board: simulated: (default), emulator:, kajimoto61:PORT, "
            "etactilekit:PORT, link:PORT.",
            "URL",
        ),
    ] = None
    profile: ProfileOption = None
    force: ForceOption = None
    intensity: Annotated[
        float | None, option("Set the maximum intensity, 0 to 1. Real boards start at 0.", "0..1")
    ] = None
    seconds: Annotated[float | None, option("End the run after this time.", "S")] = None
    felt: Annotated[
        Path | None,
        output_file("Draw the page, the pulses and the spikes of a simulated finger.", "PNG"),
    ] = None
    record: Annotated[Path | None, output_file("Record the whole run.", "MCAP")] = None
    json_file: JsonOption = None
    window: Annotated[bool, option("Show and steer the run in a browser.", None, "--window")] = (
        False
    )
    plain: Annotated[
        bool | None,
        option(
            "Print one line for each event, without drawing, for screen readers.", None, "--plain"
        ),
    ] = None
    set_: Annotated[
        list[str] | None,
        option(
            "Change a setting: rate_hz=HZ, scan=points, hold=charge|energy, softness=0..1, "
            "balance, light_on_dark, line_cue, seed=N, note=WORDS, finger=[ANATOMY:]SEED, "
            "vibrators=WAV, paced=no (as fast as possible).",
            "NAME=VALUE",
            "--set",
        ),
    ] = None

    @property
    def files(self) -> list[Path]:
        """Files that a run writes."""
        return [path for path in (self.felt, self.record, self.json_file) if path is not None]

    @property
    def board_url(self) -> str:
        """URL of the board: from the options, from the profile, or simulated."""
        return self.board or (self._chosen and self._chosen.defaults.board) or "simulated:"

    @property
    def on_a_finger(self) -> bool:
        """Whether a finger may be on the board."""
        from smarttouch.boards.open import may_touch_a_finger

        return may_touch_a_finger(self.board_url)

    @property
    def is_watched(self) -> bool:
        """Whether a person watches the run: a screen or window shows it, and no file is written."""
        return (self.window or (draws() and not self.plain)) and not self.files

    @cached_property
    def _chosen(self) -> "Profile | None":
        from smarttouch.profile import load_profile

        return None if self.profile is None else load_profile(self.profile)

    def load_profile(self) -> "Profile":
        """Return the chosen profile, or the board's default."""
        from smarttouch.boards.open import default_profile
        from smarttouch.profile import load_profile

        return self._chosen or load_profile(default_profile(self.board_url))

    def display(self, profile: "Profile") -> "Display":
        """Return a display that is not open yet."""
        from smarttouch.running.display import Display

        return Display(self.board_url, profile)

    def config(self, mode: str, **more: Any) -> "RunConfig":
        """Return the configuration of a run. --set can replace the defaults in ``more``."""
        from smarttouch.running.config import RunConfig

        return RunConfig(**({"mode": mode, "paced": True} | more | self.settings()))

    def settings(self) -> dict[str, Any]:
        """Return the settings of `RunConfig` that the options define."""
        from smarttouch.running.config import RunConfig

        texts = [text for text in self.set_ or () if text.partition("=")[0] not in _NOT_OF_CONFIG]
        named = {"seconds": self.seconds, "intensity": self.intensity}
        settings = {name: value for name, value in named.items() if value is not None}
        return settings | RunConfig.read(texts)

    def _set(self, name: str) -> str | None:
        parts = (text.partition("=") for text in self.set_ or ())
        return next((value for key, _, value in parts if key == name), None)

    @property
    def vibrators(self) -> str | None:
        """WAV file or sound card for a vibrator that stimulates PC; None without a vibrator."""
        return self._set("vibrators")

    def finger(self, usual: str = "branched", seed: int = 1) -> tuple[str, int]:
        """Return anatomy and seed of the simulated finger."""
        text = self._set("finger") or usual
        anatomy, _, seed_text = text.rpartition(":")
        return (anatomy or usual, int(seed_text)) if seed_text.isdecimal() else (text, seed)

    def _outputs(self) -> "Iterator[Listener]":
        """Yield a listener for each requested output."""
        if self.felt is not None:
            from smarttouch.views.delivered_drawing import DeliveredPicture

            anatomy, seed = self.finger()
            yield DeliveredPicture(self.felt, seed, anatomy)
        if self.record is not None:
            from smarttouch.running.recorder import Recorder

            yield Recorder(self.record)
        if self.vibrators is not None:
            from smarttouch.views.vibrator import Vibrator

            yield Vibrator(self.vibrators)

    def start(
        self,
        source: "Source",
        profile: "Profile",
        config: "RunConfig",
        ready: "Display | None" = None,
        **more: Any,
    ) -> None:
        """Run a source in the terminal until the run ends; see `run_in_terminal`."""
        from smarttouch.views.terminal_session import run_in_terminal

        if self.on_a_finger:
            display = self.display(source.narrowed(profile))
        else:
            display = ready or self.display(profile)
        run_in_terminal(
            source, display, config, [*self._outputs()], force=self.force,
            json_file=self.json_file, files=self.files, window=self.window,
            draws=self.felt is not None,
            plain=profile.defaults.plain if self.plain is None else self.plain, **more,
        )  # fmt: skip


_NOT_OF_CONFIG = ("finger", "vibrators")  # names for --set that are not settings of `RunConfig`


def or_standard_input(ctx: typer.Context, value: str | None) -> str | None:
    """Return an argument. For ``-``, write standard input to a file and return the path of this
    file. The file is removed when the command ends."""
    return str(ctx.with_resource(_file_of_standard_input())) if value == "-" else value


@contextmanager
def _file_of_standard_input() -> Iterator[Path]:
    stream = getattr(sys.stdin, "buffer", None)
    data = sys.stdin.read().encode() if stream is None else stream.read(_MOST_BYTES + 1)
    if not data:
        raise SmartTouchError(
            "standard input is empty: give a file, or pipe a text or a page into the command"
        )
    if len(data) > _MOST_BYTES:
        raise SmartTouchError(
            f"standard input is larger than {_MOST_BYTES / 1e6:,.0f} MB: give a file"
        )
    with tempfile.TemporaryDirectory(prefix="smarttouch-") as folder:
        path = Path(folder) / "standard input"
        path.write_bytes(data)
        yield path


class PlainGroup(TyperGroup):
    """Group of commands whose help has no boxes and no colors."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """List each command with the first sentence of its help."""
        with formatter.section("Commands"):
            formatter.write_dl(
                [
                    (name, " ".join((command.help or "").split("\n\n")[0].split()))
                    for name, command in self.commands.items()
                ]
            )


class Commands(typer.Typer):
    """Command-line program whose help has no boxes and no colors, for screen readers."""

    def __init__(self, **settings: Any) -> None:
        context = {"help_option_names": ["-h", "--help"]}
        settings |= {"cls": PlainGroup, "pretty_exceptions_enable": False}
        super().__init__(rich_markup_mode=None, context_settings=context, **settings)
