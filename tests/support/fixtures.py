"""Fixtures of the tests of commands, which `conftest.py` offers to all tests."""

from pathlib import Path

import jax
import pytest

from dc2g_jax._src.estimation.checkpoints import save_network
from dc2g_jax._src.estimation.compact_unet import Architecture, init_weights
from dc2g_jax._src.estimation.estimators import NetworkCostToGo


@pytest.fixture(scope="session")
def compact_network(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a tiny compact network that has learned nothing."""
    architecture = Architecture(widths=(4, 4, 4, 4))
    network = NetworkCostToGo(weights=init_weights(architecture, jax.random.key(0)), architecture=architecture)
    return save_network(tmp_path_factory.mktemp("compact") / "network", network)
