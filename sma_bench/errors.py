"""The one exception a user can cause."""


class InputError(ValueError):
    """Bad input: one line that says what, where, which value and what was expected."""
