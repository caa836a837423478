"""The cache folder for downloads and compiled programs."""

import os
from pathlib import Path

import jax
import pooch

from dc2g_jax._src.runtime.errors import InputError


def cache_folder() -> Path:
    """The folder of downloads: `DC2G_CACHE`, else `dc2g_jax` in the user's cache folder."""
    chosen = os.environ.get("DC2G_CACHE")
    try:
        return Path(chosen or pooch.os_cache("dc2g_jax")).expanduser()
    except RuntimeError:
        raise InputError(f"DC2G_CACHE={chosen!r}: there is no such home folder; set DC2G_CACHE to a folder") from None


def keep_compiled_programs() -> None:
    """Cache compiled programs in the user's cache folder, unless JAX already has a cache."""
    folder_option = "jax_compilation_cache_dir"
    if getattr(jax.config, folder_option) is None:
        jax.config.update(folder_option, str(cache_folder() / "compiled"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
