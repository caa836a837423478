"""Commands, and what they share: options, output folders, progress, errors in one line."""

import os
import sys

from dc2g_jax._src.runtime.errors import require_extra


def prepare() -> None:
    """Before the imports of a command: check that its packages are installed, and limit progress lines in log files.

    Raises:
      InputError: the extra `all`, which every command needs, is not installed.
    """
    require_extra("cv2", "matplotlib", "orbax", "rerun", "tyro")
    if not sys.stderr.isatty():
        os.environ.setdefault("TQDM_MININTERVAL", "15")
