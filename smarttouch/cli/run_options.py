"""Options of every command that runs, defined once, and the parts of a run made by them."""

from contextlib import nullcontext
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from smarttouch.base.command_options import option
from smarttouch.base.files import require_folder
from smarttouch.base.terminal import draws
from smarttouch.cli.options import (
    ForceOption,
    JsonOption,
    OptionGroup,
    ProfileOption,
    QuietOption,
    parse_finger,
)

if TYPE_CHECKING:
    from smarttouch.profile import Profile
    from smarttouch.running.config import RunConfig
    from smarttouch.running.display import Display
    from smarttouch.sources.source_contract import Source


@dataclass(frozen=True, kw_only=True)
class RunOptionGroup(OptionGroup):
    """Options of a run, as typed."""

    board: Annotated[
        str | None,
        option(
            "Drive this board: simulated: (usual), emulator:, kajimoto61:PORT, "
            "etactilekit:PORT, link:PORT.",
            "URL",
        ),
    ] = None
    vibrators: Annotated[
        str | None,
        option("Drive PC by a vibrator: a new WAV file or sound:.", "WAV|sound:"),
    ] = None
    set_: Annotated[
        list[str] | None,
        option(
            "Change a setting of the run: rate_hz=HZ, scan=points (or auto), hold=charge (or "
            "energy), softness=0..1, balance, light_on_dark, seed=N, note=WORDS, paced=no "
            "(simulated: as fast as it can).",
            "NAME=VALUE",
            "--set",
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
        option(
            "Draw what the sensor saw, what was delivered and how a simulated finger responds.",
            "PNG",
        ),
    ] = None
    finger: Annotated[
        str | None,
        option(
            "Choose the simulated finger, such as 2, paper or paper:2; the anatomy is "
            "branched, paper or a file.",
            "[ANATOMY:]SEED",
            show_default=False,
        ),
    ] = None
    record: Annotated[Path | None, option("Record the whole run.", "MCAP")] = None
    json_file: JsonOption = None
    window: Annotated[
        bool, option("Open a page in the browser that shows and steers the run.", None, "--window")
    ] = False
    quiet: QuietOption = False
    plain: Annotated[
        bool | None,
        option(
            "Print one line for each event and draw nothing, for screen readers.", None, "--plain"
        ),
    ] = None

    def __post_init__(self) -> None:
        for output in (self.felt, self.record, self.json_file):
            require_folder(output)

    @property
    def board_url(self) -> str:
        """URL of the board: that given, that of the profile given, or the simulated one."""
        return self.board or (self._chosen and self._chosen.defaults.board) or "simulated:"

    @property
    def takes_usual_profile(self) -> bool:
        """True if no profile is given, and the board asks for none of its own."""
        from smarttouch.boards.open import default_profile
        from smarttouch.profile import DEFAULT_PROFILE

        return self.profile is None and default_profile(self.board_url) == DEFAULT_PROFILE

    @property
    def on_a_finger(self) -> bool:
        """True if there may be a finger on the board."""
        from smarttouch.boards.open import may_touch_a_finger

        return may_touch_a_finger(self.board_url)

    @property
    def is_watched(self) -> bool:
        """True if the run is only watched, on a screen or in a window, and kept in no file."""
        kept = (self.felt, self.record, self.json_file)
        on_screen = draws() and not (self.quiet or self.plain)
        return (on_screen or self.window) and kept == (None,) * len(kept)

    @cached_property
    def _chosen(self) -> "Profile | None":
        from smarttouch.profile import load_profile

        return None if self.profile is None else load_profile(self.profile)

    def load_profile(self) -> "Profile":
        """Return the profile that was asked for, or the board's usual one."""
        from smarttouch.boards.open import default_profile
        from smarttouch.profile import load_profile

        return self._chosen or load_profile(default_profile(self.board_url))

    def display(self, profile: "Profile") -> "Display":
        """Return the display, not opened yet."""
        from smarttouch.running.display import Display

        return Display(self.board_url, profile)

    def config(self, mode: str, **more: Any) -> "RunConfig":
        """Return the configuration of a run that somebody watches; --set replaces what a command
        has as usual."""
        from smarttouch.running.config import RunConfig

        return RunConfig(**({"mode": mode, "paced": True} | more | self.settings()))

    def settings(self) -> dict[str, Any]:
        """Return the settings of `RunConfig` that were given."""
        from smarttouch.running.config import RunConfig

        own = {"seconds": self.seconds, "intensity": self.intensity}
        given = {name: value for name, value in own.items() if value is not None}
        return given | RunConfig.read(self.set_ or ())

    def one_finger(self, usual: str = "branched") -> tuple[str, int]:
        """Return anatomy and seed of the simulated finger."""
        return parse_finger(self.finger or usual, usual)

    def start(
        self,
        source: "Source",
        profile: "Profile",
        config: "RunConfig",
        ready: "Display | None" = None,
        **more: Any,
    ) -> None:
        """Run a source in the terminal until its end, as `run_in_terminal` does with `more`."""
        from smarttouch.sources.force import open_force
        from smarttouch.views.terminal_session import Outputs, run_in_terminal

        plain = profile.defaults.plain if self.plain is None else self.plain
        anatomy, seed = self.one_finger()
        given: dict[str, Any] = {
            each.name: getattr(self, each.name, None) for each in fields(Outputs)
        }
        outputs = Outputs(**given | {"finger": seed, "anatomy": anatomy, "plain": plain})
        with nullcontext() if self.force is None else open_force(self.force, profile) as force:
            if self.on_a_finger:
                display = self.display(source.narrowed(profile))
            else:
                display = ready or self.display(profile)
            run_in_terminal(source, display, config, outputs, force=force, **more)
