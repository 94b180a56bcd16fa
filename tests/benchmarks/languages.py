"""Twenty texts in twenty languages: into cells by liblouis, back, and compared.

Run ``python -m tests.benchmarks.languages``: a table of the language's tag, the table of liblouis
that it gets, the number of cells, and what is other in the text that comes back. "Warned" is what
``smarttouch braille --back`` says of it by itself.
"""

from smarttouch.base.errors import BrailleError
from smarttouch.braille.code_tables import open_table

TEXTS = {
    "en-2": "All human beings are born free and equal in dignity and rights.",
    "de-1": "Alle Menschen sind frei und gleich an Würde und Rechten geboren.",
    "fr-2": "Tous les êtres humains naissent libres et égaux en dignité et en droits.",
    "es": "Todos los seres humanos nacen libres e iguales; dotados como están de razón.",
    "it": "Tutti gli esseri umani nascono liberi ed eguali in dignità e diritti.",
    "pt-BR": "Todos os seres humanos nascem livres e iguais. São dotados de razão.",
    "nl": "Alle mensen worden vrij en gelijk in waardigheid en rechten geboren.",
    "sv": "Alla människor är födda fria och lika i värde och rättigheter.",
    "da": "Alle mennesker er født frie og lige i værdighed og rettigheder.",
    "nb": "Alle mennesker er født frie og med samme menneskeverd og menneskerettigheter.",
    "pl": "Wszyscy ludzie rodzą się wolni i równi pod względem swej godności i swych praw.",
    "cs": "Všichni lidé rodí se svobodní a sobě rovní co do důstojnosti a práv.",
    "hu": "Minden emberi lény szabadon születik és egyenlő méltósága és joga van.",
    "tr": "Bütün insanlar hür, haysiyet ve haklar bakımından eşit doğarlar.",
    "ru": "Все люди рождаются свободными и равными в своём достоинстве и правах.",
    "el": "Όλοι οι άνθρωποι γεννιούνται ελεύθεροι και ίσοι στην αξιοπρέπεια.",
    "he": "כל בני האדם נולדו בני חורין ושווים בערכם ובזכויותיהם.",
    "ar": "يولد جميع الناس أحراراً متساوين في الكرامة والحقوق.",
    "hi": "सभी मनुष्यों को गौरव और अधिकारों के मामले में समानता प्राप्त है।",
    "zh": "人人生而自由，在尊严和权利上一律平等。",
}
_YEAR = " (1948)"


def compared(text, again):
    """Return in words how a text that came back differs."""
    if again == text:
        return "equal"
    if again == text.lower():
        return "equal but for capitals, which the code does not mark"
    ours, theirs = text.lower().split(), again.lower().split()
    wrong = [pair for pair in zip(ours, theirs, strict=False) if len(set(pair)) > 1]
    first = "`, `".join(f"{one}` as `{other}" for one, other in wrong[:2])
    capitals = "" if again[0] == text[0] else "no capitals; "
    return f"{capitals}{len(wrong)} of {len(ours)} words other: `{first}`"


def rows():
    """Yield tag, table, cells and result of each text."""
    for tag, words in TEXTS.items():
        table, text = open_table(tag), words + _YEAR
        cells = table.to_cells(text)
        try:
            again = table.to_text(cells)
        except BrailleError:
            result = "refused"
        else:
            result = compared(text, again)
            result += ", warned" * (table.doubt(cells, again) is not None)
        yield tag, table.name, len(cells), result


if __name__ == "__main__":
    print("| language | table | cells | the text that comes back |\n|---|---|---|---|")
    for row in rows():
        print("|", " | ".join(map(str, row)), "|")
