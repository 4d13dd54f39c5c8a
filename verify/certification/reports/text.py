"""Text that came from a file, made harmless to show: nothing invisible, nothing that moves other text.

How a format quotes its own signs is that format's business; this is what all of them need before they do.
"""

from __future__ import annotations

import unicodedata

LONGEST = 2000
"""Characters of one text that are shown; reasons and claims are far shorter."""

_HIDDEN = ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")
"""Control, format (also those that turn the direction of writing), surrogate, private, unassigned, separators."""


def visible(text: str, longest: int = LONGEST) -> str:
    r"""One line of the same text in which every character can be seen.

    Line breaks and tabs become blanks; any other character that shows nothing, or that changes how its neighbours are
    shown, becomes its code, ``\u202e``. What is left can be written as UTF-8 and stands in any XML document.

    Parameters
    ----------
    text : str
    longest : int
        A longer text is cut, and ends in "...".
    """
    cut = text if len(text) <= longest else text[: longest - 3] + "..."
    if cut.isascii() and cut.isprintable():
        return cut
    return "".join(_shown(character) for character in cut)


def _shown(character: str) -> str:
    if character in "\t\n\r\v\f\x85\u2028\u2029":
        return " "
    if character.isascii():
        return character if character.isprintable() else f"\\x{ord(character):02x}"
    if unicodedata.category(character) not in _HIDDEN:
        return character
    code = ord(character)
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
