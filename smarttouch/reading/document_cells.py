"""Documents as Braille cells, page by page on all cores; one that was interrupted goes on."""

import hashlib
import json
import os
import shutil
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from smarttouch.base.errors import ReadingError
from smarttouch.base.files import make_folder, unwritable, write_bytes
from smarttouch.base.version import __version__
from smarttouch.braille.block_layout import text_of_cells
from smarttouch.braille.cell_pages import Loaded, file_of, load_cells
from smarttouch.braille.cells import BLANK
from smarttouch.braille.code_tables import BrailleTable, open_table
from smarttouch.pages.file_kinds import FileKind, file_kind
from smarttouch.reading.braille_lines import Braille
from smarttouch.reading.material import EmptyPages, ReadingMaterial
from smarttouch.reading.recognition import RecognitionOptions

_SLOW_S = 0.5  # time of the first page from which the others are worth processes of their own
_PARTS = ".pages"  # ending of the folder of finished pages, beside the output

Progress = Callable[[str], None]


@dataclass(frozen=True)
class PageCells:
    """A page as cells, a line for each paragraph, and what was said."""

    number: int
    paragraphs: list[str]
    notes: list[str]


def load_material(
    place: str,
    options: RecognitionOptions,
    table: BrailleTable,
    leave_out: bool,
    progress: Progress,
    output: Path | None = None,
) -> Loaded:
    """Load cells from an image or a PDF as `document_cells`, from all else as `load_cells`."""
    file = file_of(place)
    if file is None or file_kind(file) is not FileKind.PAGES:
        return load_cells(place, table, leave_out)
    notes: list[str] = []
    source = ReadingMaterial(place, options, notes.append)
    return replace(document_cells(Braille(table.name), source, progress, output), notes=notes)


def document_cells(
    braille: Braille, source: ReadingMaterial, progress: Progress, output: Path | None = None
) -> Loaded:
    """Return a document as cells; ``progress`` is called as pages are done.

    Several pages of print keep their numbers.

    With an ``output``, finished pages are kept in a folder beside it until `forget_pages`, and are
    used again by another run with the same document and options.
    """
    numbers = source.numbers()
    files: dict[int, Path] = {}
    if output is not None and len(numbers) > 1:
        files = _files(braille, source, numbers, output.with_name(output.name + _PARTS))
    found = {number: kept for number, path in files.items() if (kept := _kept(path))}
    if found:
        progress(f"{len(found)} of {len(numbers)} pages were done before")
    missing = [number for number in dict.fromkeys(numbers) if number not in found]
    for each in _made(braille, source, missing, progress):
        if each.number in files:
            _keep(each, files[each.number])
        found[each.number] = each
        if len(numbers) > 1:
            progress(f"page {each.number} done, {len(found)} of {len(numbers)}")
    empty, pages = EmptyPages(source.note), [found[number] for number in numbers]
    paragraphs, begins = list[str](), dict[int, str]()
    about, printed = source.about()
    for page in pages:
        for words in page.notes:
            source.note(words)
        empty.add(page.number, any(each.strip(BLANK) for each in page.paragraphs))
        if page.number in printed:
            begins[len(paragraphs)] = printed[page.number]
        paragraphs += page.paragraphs
    empty.conclude()
    shaped = text_of_cells(paragraphs, open_table(braille.table), begins, about)
    return Loaded(paragraphs, None, [], shaped)


def forget_pages(output: Path) -> None:
    """Remove the pages that were kept for an output."""
    shutil.rmtree(output.with_name(output.name + _PARTS), ignore_errors=True)


def _made(
    braille: Braille, source: ReadingMaterial, numbers: Sequence[int], progress: Progress
) -> Iterator[PageCells]:
    """Yield pages as they are done: by this process where they take little time."""
    start = time.monotonic()
    for done, number in enumerate(numbers):
        if not done and len(numbers) > 1:
            progress(f"page {number} is being read")
        elif done and (time.monotonic() - start) / done > _SLOW_S:
            yield from _by_processes(braille, source, numbers[done:])
            return
        yield _page(braille, source, number)


def _by_processes(
    braille: Braille, source: ReadingMaterial, numbers: Sequence[int]
) -> Iterator[PageCells]:
    from joblib import Parallel, delayed, parallel_config

    # What its notes are said to stays here.
    plain = ReadingMaterial(source.name, source.options)
    # Workers of a program that was killed end soon.
    with parallel_config("loky", idle_worker_timeout=10):
        many = Parallel(n_jobs=-1, return_as="generator_unordered", max_nbytes=None)
    made = many(delayed(_page)(braille, plain, number, alone=True) for number in numbers)
    try:
        yield from made
    finally:
        with warnings.catch_warnings():
            # Pages that were under way are thrown away.
            warnings.simplefilter("ignore", UserWarning)
            made.close()


def _page(braille: Braille, source: ReadingMaterial, number: int, alone: bool = False) -> PageCells:
    """Return a page as cells; ``alone`` if each core has a process of its own."""
    if alone:
        import cv2

        cv2.setNumThreads(1)
    notes: list[str] = []
    options = replace(source.options, pages=str(number))
    material = ReadingMaterial(source.name, options, notes.append)
    ((_, page),) = material.pages()
    return PageCells(number, braille.page_cells(material, number, page), notes)


def _files(
    braille: Braille, source: ReadingMaterial, numbers: Sequence[int], folder: Path
) -> dict[int, Path]:
    """Return the files of pages, named by all that their cells depend on."""
    try:
        make_folder(folder)
    except OSError as error:
        raise unwritable(ReadingError, folder, error) from None
    state = Path(source.name).stat()
    options = asdict(replace(source.options, pages=None))
    depends_on = [
        __version__, source.name, state.st_size, state.st_mtime_ns, options, asdict(braille),
    ]  # fmt: skip
    key = hashlib.sha256(json.dumps(depends_on, sort_keys=True).encode()).hexdigest()[:24]
    return {number: folder / f"{key}-{number}.json" for number in numbers}


def _keep(page: PageCells, path: Path) -> None:
    # A run that is killed leaves no half a page.
    half = path.with_suffix(f".{os.getpid()}.part")
    write_bytes(half, json.dumps(asdict(page)).encode(), ReadingError)
    half.replace(path)


def _kept(path: Path) -> PageCells | None:
    try:
        kept = json.loads(path.read_bytes())
        return PageCells(kept["number"], kept["paragraphs"], kept["notes"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
