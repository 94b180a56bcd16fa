"""Plain forms of characters for which a Braille code has no cells."""

import itertools
import re
import unicodedata
from collections.abc import Callable, Iterator

QUIET = {
    **dict.fromkeys("“”„‟«»", '"'), **dict.fromkeys("‘’‚‛‹›", "'"), **dict.fromkeys("‐‑–—―", "-"),
    "…": "...", "-": "\u00ad",
}  # fmt: skip
"""Plain forms that look almost like the original characters, so their use is not reported. A hyphen
becomes a soft hyphen, because liblouis' Italian table has a cell only for the soft hyphen."""
_FORMS = QUIET | {
    "−": "-", "⁄": "/", "∕": "/", "×": "x", "÷": "/", "·": ".", "⋅": ".", "≤": "<=", "≥": ">=",
    "≠": "/=", "≈": "~", "±": "+-", "→": "->", "←": "<-", "↔": "<->", "⇒": "=>", "′": "'",
    "″": '"', "☐": "[ ]", "☑": "[x]", "☒": "[x]", "✓": "[x]", "✔": "[x]", "✗": "[-]", "✘": "[-]",
    "ß": "ss", "ẞ": "SS", "ı": "i", "þ": "th", "Þ": "Th", "ð": "d", "Ð": "D", "€": "EUR",
    "£": "GBP", "_": "-", "^": "**", "{": "(",
    "}": ")", "`": "'", "°": " degrees ", "§": "section ", "©": "(c)", "®": "(R)", "№": "No.",
    "¡": "", "¿": "", **dict.fromkeys("•◦▪‣●○■□▸►❖➢⁃\uf0b7\uf0a7\uf0d8\uf0fc\uf076", "*"),
}  # fmt: skip
"""Plain forms that Unicode does not define. Some bullets have codes that only symbol fonts use."""
_LATIN = re.compile(r"LATIN (SMALL|CAPITAL) (?:LETTER|LIGATURE) ([A-Z]{1,2})(?: WITH .*)?")
_GREEK = re.compile(r"GREEK (SMALL|CAPITAL) LETTER (?:.* )?([A-Z]+?)(?: SYMBOL)?(?: WITH .*)?")


def plain_forms(text: str, lacks: Callable[[str], bool]) -> tuple[str, dict[str, str]]:
    """Replace characters that a code lacks. Return the new text and a dict of the replacements.

    A character without a plain form is replaced by "". Numbers keep their value: the superscript ⁶
    becomes ``^6``, the subscript ₂ becomes ``_2``, and 1½ becomes ``1 1/2``.
    """
    lacking = set(filter(lacks, set(text)))
    for mark, run in itertools.groupby(text, _script):
        script = set(run)
        if mark and not lacking.isdisjoint(script):
            lacking |= script
    forms = {sign: _form(sign, lacks) or "" for sign in lacking}
    parts: list[str] = []
    for (mark, is_lacking), group in itertools.groupby(
        text, lambda sign: (_script(sign) if sign in forms else "", sign in forms)
    ):
        signs = list(group)
        if not is_lacking:
            parts += signs
        elif prefix := (_form(mark, lacks) if lacks(mark) else mark) if mark else None:
            parts.append(prefix + "".join(forms[sign].removeprefix(prefix) for sign in signs))
        else:
            for sign in signs:
                number = parts and parts[-1][-1:].isdigit() and "/" in forms[sign]
                parts.append(f" {forms[sign]}" if number else forms[sign])
    for k in range(1, len(parts)):
        # Without brackets, a following digit would become part of the superscript or subscript.
        if parts[k][:1].isdigit() and len(parts[k - 1]) > 1 and parts[k - 1][0] in "^_":
            parts[k - 1] = f"{parts[k - 1][0]}({parts[k - 1][1:]})"
    return "".join(parts), forms


def _script(sign: str) -> str:
    """Return ``^`` for a superscript, ``_`` for a subscript, and "" for any other character."""
    kind, _, form = unicodedata.decomposition(sign).partition(" ")
    raised = kind == "<super>" and sign not in "ªº" and " " not in form
    return "^" if raised else "_" if kind == "<sub>" else ""


def _form(sign: str, lacks: Callable[[str], bool], within: str = "") -> str | None:
    """Return the first plain form that can be written in cells; None if there is no such form."""
    within += sign
    for form in _candidates(sign):
        if set(form).isdisjoint(within):
            parts = [_form(part, lacks, within) if lacks(part) else part for part in form]
            if None not in parts:
                return "".join(map(str, parts))
    return None


def _candidates(sign: str) -> Iterator[str]:
    if sign in _FORMS:
        yield _FORMS[sign]
    name = unicodedata.name(sign, "")
    if not name or (sign.isascii() and sign.isalnum()):
        return
    if latin := _LATIN.fullmatch(name):
        yield latin[2].lower() if latin[1] == "SMALL" else latin[2]
    kind, _, codes = unicodedata.decomposition(sign).rpartition("> ")
    form = "".join(chr(int(code, 16)) for code in codes.split())
    script = _script(sign)
    if script:
        yield script + form
    if form:
        yield f"({form})" if script or kind == "<circle" else form
        yield "".join(part for part in form if not unicodedata.combining(part))
    if (digit := unicodedata.decimal(sign, None)) is not None:
        yield str(digit)
    if greek := _GREEK.fullmatch(name):
        yield f"[{greek[2].lower() if greek[1] == 'SMALL' else greek[2].title()}]"
    elif unicodedata.category(sign)[0] in "SPN":
        yield f"[{name.lower()}]"
