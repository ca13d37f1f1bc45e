"""The one kind of error that is the user's to mend."""

import unicodedata

# Control and format characters, halves of characters, separators of lines and paragraphs: quoted
# from a file, they could move a terminal's cursor or turn the text around.
_HIDDEN = ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")


class InputError(ValueError):
    """What was given cannot be used; the text says where, why, and what to write instead.

    The command line prints it without a traceback and exits with 2.
    """

    def __str__(self) -> str:
        """The text, in which what cannot be seen is spelled out."""
        text = super().__str__()
        return text if text.isprintable() else "".join(map(_visible, text))


def _visible(character: str) -> str:
    hidden = character != "\n" and unicodedata.category(character) in _HIDDEN
    return repr(character)[1:-1] if hidden else character


class PartnerLost(InputError):
    """A program outside that the run cannot go on without is not there, or not any more."""
