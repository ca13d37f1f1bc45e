"""Errors that the user can correct."""

import unicodedata

# Control and format characters, surrogates, line and paragraph separators: quoted from a file, they
# could move the cursor of a terminal or reverse the text.
_HIDDEN = ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")


class InputError(ValueError):
    """Invalid input; the text has the place, the reason, and what to write instead.

    The command line prints it without a traceback and exits with 2.
    """

    def __str__(self) -> str:
        """Return the text with invisible characters escaped."""
        return escape_controls(super().__str__())


def escape_controls(text: str) -> str:
    """Escape the invisible characters of a text, except line ends."""
    return text if text.isprintable() else "".join(map(_visible, text))


def _visible(character: str) -> str:
    hidden = character != "\n" and unicodedata.category(character) in _HIDDEN
    return repr(character)[1:-1] if hidden else character


class ExternalProgramLost(InputError):
    """An external program that the run needs is not reachable, or has ended."""
