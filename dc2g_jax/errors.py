"""The exception type for invalid input, which a missing extra counts as."""

import importlib.util


class InputError(ValueError):
    """Invalid input from the user.

    The message is one line that names the file, the value found there and the remedy. Commands print it
    without a stack trace and exit with status 2.
    """


def require_extra(*modules: str) -> None:
    """Check that modules which come with the extra `all` are installed, without importing them.

    Raises:
      InputError: one is not.
    """
    missing = [module for module in modules if importlib.util.find_spec(module) is None]
    if missing:
        raise InputError(f'{", ".join(missing)}: not installed; run: pip install "dc2g_jax[all]"')
