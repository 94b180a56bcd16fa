"""Blocks of text with headings, lists, tables and emphasis."""

from dataclasses import dataclass
from enum import IntFlag, StrEnum


class Emphasis(IntFlag):
    """Type of a character in print, as liblouis numbers them."""

    PLAIN = 0
    ITALIC = 1
    UNDERLINE = 2
    BOLD = 4


class BlockKind(StrEnum):
    """What a block of text is."""

    HEADING = "heading"
    PARAGRAPH = "paragraph"
    ITEM = "item"
    """Of a list."""
    ROW = "row"
    """Of a table; its cells are parted by semicolons."""
    PAGE = "page"
    """Where a page of print begins; its text is the page's number."""


@dataclass(frozen=True)
class Run:
    """Characters of one emphasis, or the number of a page of print that begins there."""

    text: str
    emphasis: Emphasis = Emphasis.PLAIN
    page: bool = False


BETWEEN = Run("; ")  # what parts the cells of a row


@dataclass(frozen=True)
class Block:
    """Heading, paragraph, item or row; its level counts from 1 for headings, from 0 for items.

    ``continued`` if it goes on with the block before a page of print, ``head`` if it is a row of a
    table's head.
    """

    kind: BlockKind
    level: int
    runs: tuple[Run, ...]
    continued: bool = False
    head: bool = False

    @property
    def text(self) -> str:
        """Its words, without emphasis."""
        return "".join(run.text for run in self.runs)


@dataclass(frozen=True)
class StructuredText:
    """Blocks of a document in order, and its metadata, empty where it has none."""

    blocks: tuple[Block, ...]
    title: str = ""
    author: str = ""
    language: str = ""
    date: str = ""
