"""Optional libraries: the extra of the distribution that installs each.

Flying, recording and checking need none of them. Each is imported by one module.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from testbed.core.errors import InputError

DISTRIBUTION = "formation-testbed"  # the name that pip installs, as in pyproject.toml


class MissingExtraError(InputError, ImportError):
    """A library of an extra is not installed; the text has the command that installs it."""


def install_command(extra: str) -> str:
    """Return the command that installs an extra."""
    return f'pip install "{DISTRIBUTION}[{extra}]"'


@contextmanager
def needs_extra(extra: str, purpose: str) -> Iterator[None]:
    """Import libraries of an extra in the block.

    Args:
        extra: of pyproject.toml.
        purpose: what needs the library, as the message begins.

    Raises:
        MissingExtraError: a library is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        raise MissingExtraError(
            f"{purpose}: {package} is not installed; write {install_command(extra)}"
        ) from None
