"""The exception type for invalid input."""


class InputError(ValueError):
    """Invalid input from the user.

    The message is one line that names the file, the value found there and the remedy. Commands print it
    without a stack trace and exit with status 2.
    """
