"""The one exception a user is meant to read."""


class GuiderError(Exception):
    """Bad input. The message is one line: what is wrong, where, and what to do."""
