"""Runs that a page of the window may ask for: sources and boards that are offered."""

import contextlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from smarttouch.base.errors import SmartTouchError, SourceError
from smarttouch.boards.open import may_touch_a_finger

MOST_WORDS = 500  # longest text that a page may ask for, in characters
_MOST_FILES = 30
_PAGES = {".png", ".jpg", ".jpeg", ".txt", ".pdf"}


@dataclass(frozen=True)
class RunChoice:
    """Source and board of a run; ``confirmed``: a person said that a finger may be on the board."""

    source: str
    board: str
    confirmed: bool = False


@dataclass(frozen=True)
class RunChoices:
    """Sources and boards that pages are offered: those of the command, files beside it, words.

    A page may show any words, but open no other file: whoever has its address can ask.
    """

    first: RunChoice
    sources: tuple[str, ...]

    @classmethod
    def beside(cls, first: RunChoice, folder: Path) -> "RunChoices":
        """Return what is offered beside a command's own run: pages in a folder, too."""
        pages: list[str] = []
        with contextlib.suppress(OSError):  # a folder that cannot be read offers nothing
            files = sorted(each for each in folder.iterdir() if each.suffix.lower() in _PAGES)
            pages += [f"page:{each.name}" for each in files[:_MOST_FILES] if each.is_file()]
        return cls(first, tuple(dict.fromkeys((first.source, *pages, "draw:"))))

    @property
    def boards(self) -> list[str]:
        """URLs of boards that need no confirmation."""
        return list(dict.fromkeys((self.first.board, "emulator:")))

    def message(self) -> dict[str, Any]:
        """Return what a page shows of it, for JSON."""
        return {"sources": self.sources, "boards": self.boards, "words": MOST_WORDS}

    def parse(self, text: str) -> RunChoice:
        """Return a choice from a page's JSON; raises ValueError for anything else."""
        try:
            given = json.loads(text)
        except RecursionError:
            raise ValueError(text) from None
        if not isinstance(given, dict) or given.keys() != {"source", "board", "confirmed"}:
            raise ValueError(text)
        choice = RunChoice(**given)
        strings = isinstance(choice.source, str) and isinstance(choice.board, str)
        if not strings or not isinstance(choice.confirmed, bool):
            raise ValueError(text)
        return choice

    def require(self, choice: RunChoice) -> None:
        """Raise unless a page may run what it chose."""
        words = choice.source.removeprefix("text:")
        if choice.source not in self.sources and words == choice.source:
            raise SourceError(
                f"the window offers no source {choice.source!r}: choose one of the list, or type "
                "words",
                about="source",
            )
        if not words.strip() or len(words) > MOST_WORDS:
            raise SourceError(
                f"a text of {len(words)} characters cannot be shown: type 1 to {MOST_WORDS}",
                about="source",
            )
        if "=" in words and choice.source not in self.sources:
            raise SourceError(
                "words in the window have no options: leave out what has a =", about="source"
            )
        if choice.board in self.boards:
            return
        if "?" in choice.board:
            raise SmartTouchError(
                f"the board {choice.board!r} is not offered: leave out its options", about="board"
            )
        if not may_touch_a_finger(choice.board):
            # One of a plug-in may write a file that its URL names.
            raise SmartTouchError(
                f"the board {choice.board!r} is not offered: choose one of the list, or a real one",
                about="board",
            )
        if not choice.confirmed:
            raise SmartTouchError(
                f"a finger may be on {choice.board}: confirm that, and that current through it is "
                "intended",
                about="board",
            )
