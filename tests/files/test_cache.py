"""The folder of what is kept between runs."""

import jax
import pytest

from dc2g_jax._src.files.cache import cache_folder, keep_compiled_programs
from dc2g_jax._src.planning.online import OnlinePlanner


@pytest.mark.parametrize("variable", ["DC2G_CACHE", "XDG_CACHE_HOME", "HOME"])
def test_cache_folder_from_the_environment(variable, tmp_path, monkeypatch):
    for name in ("DC2G_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(variable, str(tmp_path))
    expected = {"DC2G_CACHE": tmp_path, "XDG_CACHE_HOME": tmp_path / "dc2g_jax", "HOME": tmp_path / ".cache/dc2g_jax"}
    assert cache_folder() == expected[variable]


@pytest.fixture
def no_cache(monkeypatch, tmp_path):
    """JAX as it is before anybody sets a folder for compiled programs."""
    monkeypatch.setenv("DC2G_CACHE", str(tmp_path))
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = {name: getattr(jax.config, name) for name in names}
    jax.config.update(names[0], None)
    yield
    for name, value in before.items():
        jax.config.update(name, value)


def test_compiled_programs_are_kept_there(no_cache, tmp_path, monkeypatch):
    OnlinePlanner("frontier", largest=(8, 9))
    assert jax.config.jax_compilation_cache_dir == str(tmp_path / "compiled")
    monkeypatch.setenv("DC2G_CACHE", str(tmp_path / "elsewhere"))
    keep_compiled_programs()
    assert jax.config.jax_compilation_cache_dir == str(tmp_path / "compiled"), "the user's choice stays"
