"""The one exception type for bad input: its message is the whole story a user needs."""


class InputError(ValueError):
    """Input the package refuses.

    The message is one line that names the file, the value found there and the remedy. Commands print it
    without a stack trace and exit with status 2.
    """
