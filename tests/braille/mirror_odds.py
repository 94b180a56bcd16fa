"""Cells of Braille counted in sentences, to know Braille from its mirror image.

``python -m tests.braille.mirror_odds`` prints the table of `smarttouch.braille.sides`; it needs
liblouis, and nothing in it is random.
"""

from collections import Counter
from itertools import pairwise

from smarttouch.braille.cells import BLANK
from smarttouch.braille.code_tables import open_table
from smarttouch.braille.sides import DIGITS

TEXTS = {
    "en-1 en-2":
    "All human beings are born free and equal in dignity and rights. They know how to think "
    "and should act towards one another as brothers and sisters would. The old woman opened "
    "the window, looked at the garden and said that it would rain before the evening came.",
    "de-0 de-2":
    "Alle Menschen sind frei geboren und gleich an Würde und Rechten. Sie können denken und "
    "sollen einander wie Brüder begegnen. Die alte Frau öffnete das Fenster, sah in den "
    "Garten und sagte, dass es am Abend noch regnen werde.",
    "fr-1 fr-2":
    "Tous les hommes naissent libres et égaux en dignité et en droits. La vieille femme "
    "ouvrit la fenêtre, regarda le jardin et dit qu'il allait pleuvoir avant le soir. Nous "
    "irons demain au marché.",
    "es":
    "Todos los hombres nacen libres e iguales en dignidad y derechos. La mujer abrió la "
    "ventana, miró el jardín y dijo que iba a llover antes de la noche. Mañana iremos todos "
    "juntos al mercado.",
    "ru":
    "Все люди рождаются свободными и равными в своём достоинстве и правах. Старая женщина "
    "открыла окно, посмотрела в сад и сказала, что вечером будет дождь. Завтра мы пойдём на "
    "рынок за хлебом и молоком.",
    "zhcn-g1.ctb zh-chn.ctb":
    "人人生而自由，在尊严和权利上一律平等。老人打开窗户，看了看花园，说晚上会下雨。明天我们一"
    "起去市场买水果和蔬菜。学生们在学校里学习语文和数学，老师对他们很好。中国是一个历史很长的"
    "国家。",
}  # fmt: skip


def frequent() -> list[str]:
    """Return how many of 300 cells are each of the 64, a line for each language."""
    lines = []
    for names, text in TEXTS.items():
        cells = "".join(open_table(name).to_cells(text, leave_out=True) for name in names.split())
        found = Counter(after for before, after in pairwise(cells) if after not in (before, BLANK))
        each = [found[chr(ord(BLANK) + k)] * 300 / found.total() for k in range(64)]
        lines.append("".join(DIGITS[min(round(count), len(DIGITS) - 1)] for count in each))
    return lines


if __name__ == "__main__":
    print("\n".join(frequent()))
