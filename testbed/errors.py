"""The one kind of error that is the user's to mend."""


class InputError(ValueError):
    """What was given cannot be used; the text says where, why, and what to write instead.

    The command line prints it without a traceback and exits with 2.
    """


class PartnerLost(InputError):
    """A program outside that the run cannot go on without is not there, or not any more."""
