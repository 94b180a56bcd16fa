"""Lines of pages as we lay them out, beside Tesseract's own layout of the same page.

Run ``python -m tests.benchmarks.layouts FOLDER OUTPUT``: lines and words of both, how far the
texts agree, and error rates where ``PAGE.txt`` says what stands there; OUTPUT gets both texts.
"""

import sys
from pathlib import Path

from smarttouch.base.errors import SmartTouchError
from smarttouch.pages.document import open_document
from smarttouch.reading.legibility import character_error_rate
from smarttouch.reading.recognition import (
    PAGE,
    RecognitionOptions,
    recognize,
    recognized_lines,
    upright_page,
)


def quiet(note: str) -> None:
    """Take a note, and say nothing."""


def main() -> None:
    """Print a line for each page of a folder."""
    folder, output = map(Path, sys.argv[1:3])
    output.mkdir(exist_ok=True)
    options = RecognitionOptions()
    for path in sorted(folder.iterdir()):
        try:
            with open_document(path) as document:
                page = document.page(0)
        except SmartTouchError:
            continue
        prepared = upright_page(1, page, options, quiet)
        ours = [text for _, text in recognized_lines(prepared, options, quiet)]
        theirs = recognize(prepared.page.grey, layout=PAGE).split("\n")
        texts = {"ours": "\n".join(ours), "Tesseract's": "\n".join(theirs)}
        truth = path.with_suffix(".txt")
        told = [path.name]
        for name, text in texts.items():
            (output / f"{path.stem} {name}.txt").write_text(text)
            told.append(f"{name} {len(text.splitlines())} lines {len(text.split())} words")
            if truth.exists():
                told[-1] += f" error {character_error_rate(truth.read_text(), text):.3f}"
        if ours and theirs:
            agreement = 1 - character_error_rate(*texts.values())
            told.append(f"agreement {agreement:.2f}")
        print("; ".join(told), flush=True)


if __name__ == "__main__":
    main()
