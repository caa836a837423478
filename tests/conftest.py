"""What all tests share: where the recorded data lie, hand-drawn maps, and type checks around the whole package."""

import gc
import os
import signal
from collections.abc import Callable
from pathlib import Path

import jax
import jaxtyping
import numpy as np
import pytest
from hypothesis import settings
from jax._src import compiler  # no public option chooses the emitters of programs that are compiled from here on

from tests.support.golden import GOLDEN, Arrays, Table, read_arrays, read_table
from tests.support.places import PUBLISHED, ROOT, SHARED

CACHE = ROOT / ".pytest_cache"

# No test asks the network for the dataset: it is the copy beside the repository, or else the procedural houses.
os.environ["DC2G_DATA"] = str(PUBLISHED) if PUBLISHED.is_dir() else "procedural"
os.environ["DC2G_CACHE"] = str(CACHE / "dc2g")

# Compiled programs are kept between runs, and shared with the commands that tests start.
os.environ["JAX_COMPILATION_CACHE_DIR"] = str(CACHE / "jax")
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.0"
jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)

# Most tests spend their time on compiling programs that run but briefly: these do without most optimizations, and
# their fusions are compiled by XLA's older and quicker emitters, which jax 0.11 no longer has. What runs for longer, or
# is compared with recorded episodes, takes `optimized`. (Users' programs are optimized: `.ci/run` runs the main job as
# they do.)
OLDER_EMITTERS = jax.__version_info__ < (0, 11)
os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"
if OLDER_EMITTERS:
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_use_fusion_emitters=false"
jax.config.update("jax_disable_most_optimizations", True)

# Work is divided among two devices, so that every test of it covers the division.
jax.config.update("jax_num_cpu_devices", 2)

# Shapes and dtypes of the package's functions are checked while they are traced, which takes a sixth of the time:
# `.ci/run` asks for it. Must precede their import.
if os.environ.get("DC2G_CHECK_SHAPES"):
    from tests.support import typechecking

    jaxtyping.jaxtyped = typechecking.jaxtyped
    jaxtyping.install_import_hook("dc2g_jax", f"{typechecking.__name__}.check")

# Tracing makes millions of objects that live on: fewer collections save an eighth of the time of tests that trace.
gc.set_threshold(100_000, 20, 100)

settings.register_profile("tests", derandomize=True, deadline=None)
settings.load_profile("tests")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Pages and notebooks first: they take longest, and no worker is to be left alone with one in the end."""
    items.sort(key=lambda item: item.path.stem not in ("test_docs", "test_notebooks"))


@pytest.fixture(scope="module", autouse=True)
def forget_programs():
    """Let go of what a module compiled: with thousands of programs in one process XLA crashes."""
    yield
    jax.clear_caches()


@pytest.fixture(scope="module")
def optimized():
    """Programs compiled as users have them."""
    default_options = compiler.get_compile_options

    def options_of_users(*args, env_options_overrides=None, **kwargs):
        newer_emitters = {"xla_cpu_use_fusion_emitters": True} if OLDER_EMITTERS else {}
        overrides = newer_emitters | (env_options_overrides or {})
        return default_options(*args, env_options_overrides=overrides, **kwargs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiler, "get_compile_options", options_of_users)
        jax.config.update("jax_disable_most_optimizations", False)
        yield
        jax.config.update("jax_disable_most_optimizations", True)


@pytest.fixture
def interruptible():
    """Ctrl-C raises KeyboardInterrupt, also in tests that a shell began in the background, where it is ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of recorded data and datasets beside the repository."""
    if not SHARED.is_dir():
        pytest.skip("../shared is absent")
    return SHARED


@pytest.fixture(scope="session")
def shared_files(shared: Path) -> Callable[[str, str], list[Path]]:
    """Files in a folder of recorded data, by the folder's name and their pattern, in order."""

    def files(folder: str, pattern: str) -> list[Path]:
        if not (shared / folder).is_dir():
            pytest.skip(f"../shared is absent in part: it has no {folder}")
        return sorted((shared / folder).glob(pattern))

    return files


@pytest.fixture(scope="session")
def golden_grids() -> dict[str, np.ndarray]:
    """House name -> class grid, as the authors' code had them."""
    grids = read_arrays(GOLDEN / "grids.npz")
    return dict(zip(grids["house"].tolist(), grids["terrain"], strict=True))


@pytest.fixture(scope="session")
def golden_episodes() -> Table:
    """Episodes of the authors' code, one a row."""
    return read_table(GOLDEN / "episodes.csv")


@pytest.fixture(scope="session")
def golden_states() -> Arrays:
    """Moments inside episodes of the authors' code."""
    return read_arrays(GOLDEN / "states.npz")


@pytest.fixture(scope="session")
def published_dataset(shared: Path):
    """The published houses, read from their images."""
    from dc2g_jax._src.readers.houses import load_dataset

    return load_dataset(PUBLISHED)


@pytest.fixture(scope="session")
def compact_network(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a tiny compact network that has learned nothing."""
    from dc2g_jax._src.estimation.checkpoints import save_network
    from dc2g_jax._src.estimation.compact_unet import Architecture, init_weights
    from dc2g_jax._src.estimation.estimators import NetworkCostToGo

    architecture = Architecture(widths=(4, 4, 4, 4))
    network = NetworkCostToGo(weights=init_weights(architecture, jax.random.key(0)), architecture=architecture)
    return save_network(tmp_path_factory.mktemp("compact") / "network", network)


@pytest.fixture(scope="session")
def street() -> np.ndarray:
    """Two doors on a street, each behind its own path or driveway; no symmetry."""
    from tests.support.houses import STREET

    return STREET


@pytest.fixture(scope="session")
def island() -> np.ndarray:
    """A door that no road leads to."""
    from tests.support.maps import drawn

    return drawn("""
        RRRRRRRRRR
        R........R
        R..DPP...R
        R........R
        RRRR.RRRRR
        R........R
        R.t....#.R
        RRRRRRRRRR
    """)


@pytest.fixture(scope="session")
def buried() -> np.ndarray:
    """A door inside a house, two cells of wall away from the path that was meant for it."""
    from tests.support.maps import drawn

    return drawn("""
        ##########
        #######D##
        ##########
        ##########
        ..P.......
        RRRRRRRRRR
        RRRRRRRRRR
        ..........
    """)
