"""Six kinds of documents and a PDF, made from one text, give its words and pages of Braille."""

import subprocess

import pytest

from smarttouch.braille.cell_pages import laid_out, load_cells, write_cells
from smarttouch.braille.code_tables import open_table
from smarttouch.reading.document_cells import load_material
from smarttouch.reading.recognition import RecognitionOptions

from ..pages.test_structured_text import needs_pandoc
from ..pages.test_text_layer import pdf
from ..whole import sample
from .liblouis import needs_liblouis

pytestmark = needs_liblouis
SOURCE = """---
title: The Garden Book
author: Ann Author
---

# Fruits and their prices

Of all fruits the *pear* is the one that **keeps** longest. It is 12 km to town.

## What to do in spring

1. Dig the beds.
2. Sow:
    - carrots in rows, as far apart as a palm is wide
    - peas
3. Wait.

| Fruit | 1990  | 1997 |
|-------|-------|------|
| Apple | 3     | 4    |
| Plum, dried for winter | 1,204 | 12,345 |

### Last words

“Thyme”, she wrote, grows in dry places.
"""
TITLE_PAGE = "# The Garden Book\n\nAnn Author\n"
TEXT = """The Garden Book
Ann Author
Fruits and their prices
Of all fruits the pear is the one that keeps longest. It is 12 km to town.
What to do in spring
1. Dig the beds.
2. Sow:
carrots in rows, as far apart as a palm is wide
peas
3. Wait.
Fruit; 1990; 1997
Apple; 3; 4
Plum, dried for winter; 1,204; 12,345
Last words
"Thyme", she wrote, grows in dry places."""
# Headings, paragraphs, emphasis, lists, a table, and the numbers of pages, as Braille Formats has
# them: centered, cell 5, cell 7; 3-1; word indicators; 1-5 and 3-5; 1-3; at the end of the page.
PAGES = """\
       ,THE ,GARDEN ,BOOK

  ,ANN ,AUTHOR

    ,FRUITS AND THEIR PRICES

  ,OF ALL FRUITS THE .1PEAR IS
THE ONE THAT ^1KEEPS LONGEST4
,IT IS #AB KM TO TOWN4

    ,WHAT TO DO IN SPRING

#A4 ,DIG THE BEDS4
                              #A
#B4 ,SOW3
  CARROTS IN ROWS1 AS FAR APART
    AS A PALM IS WIDE
  PEAS
#C4 ,WAIT4

,FRUIT2 #AIIJ2 #AIIG
,APPLE2 #C2 #D
,PLUM1 DRIED FOR WINTER2 #A1BJD2
  #AB1CDE

      ,LAST WORDS
  8,THYME01 SHE WROTE1 GROWS IN
                              #B
DRY PLACES4
"""
PAGES += "\n" * 12 + "#C".rjust(32) + "\n"
OF_PDF = """\
  ,THE ,GARDEN ,BOOK
  ,OF ALL THE FRUITS THE PEAR IS
THE ONE THAT KEEPS BEST4 ,IT IS
#AB KM TO TOWN4 ,THYME1 SHE
WROTE1 GROWS IN PLACES THAT ARE
DRY1 AND SO DOES SAGE4
  ,FRUIT2 #AIIJ2 #AIIG
  ,APPLE2 #C2 #D
  ,PLUM1 DRIED2 #A1BJD2 #AB1CDE
"""
OF_PDF += "\n" * 4 + "#A".rjust(32) + "\n"


def brf(path, load=load_cells):
    """Return a file's BRF, of 32 cells by 14 lines, and its cells as text."""
    table = open_table("en-1")
    loaded = load(str(path), table)
    made = path.with_suffix(".brf")
    write_cells(made, laid_out(loaded, 32, 14), loaded.document(table))
    return made.read_text("ascii").replace("\f", ""), table.to_text("\n".join(loaded.paragraphs))


@needs_pandoc
@pytest.mark.parametrize("kind", sample(["docx", "html", "epub", "md", "odt"]))
def test_a_document(tmp_path, kind):
    path = tmp_path / f"document.{kind}"
    if kind == "md":
        path.write_text(SOURCE)
    else:
        # A publication has a page of its title.
        source = TITLE_PAGE + SOURCE.partition("\n---\n")[2] if kind == "epub" else SOURCE
        command = ["pandoc", "-f", "markdown", "-s", "-t", kind, "-o", path]
        subprocess.run(command, input=source, text=True, check=True)
    pages, text = brf(path)
    assert text == TEXT
    assert pages == PAGES


def test_a_pdf_of_columns_and_a_table(tmp_path):
    pytest.importorskip("pypdfium2")
    columns = [
        ["Of all the fruits the pear", "is the one that keeps best.", "It is 12 km to town."],
        ["Thyme, she wrote, grows in", "places that are dry, and", "so does sage."],
    ]
    table = [("Fruit", "1990", "1997"), ("Apple", "3", "4"), ("Plum, dried", "1,204", "12,345")]
    path = pdf(
        tmp_path / "document.pdf",
        (40, 270, "The Garden Book"),
        *((40 + 180 * c, 240 - 14 * k, line) for c in (0, 1) for k, line in enumerate(columns[c])),
        *((40 + 120 * c, 170 - 14 * k, row[c]) for k, row in enumerate(table) for c in range(3)),
    )

    def load(place, code):
        return load_material(place, RecognitionOptions(), code, False, lambda _: None)

    pages, text = brf(path, load)
    rows = ["; ".join(row) for row in table]
    assert text.split("\n") == ["The Garden Book", " ".join(columns[0] + columns[1]), *rows]
    assert pages == OF_PDF
