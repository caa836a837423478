"""Networks on disk: what is saved comes back bit for bit, and what is damaged is refused in one line."""

import dataclasses
import json
import os
import shutil
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx, struct

from dc2g_jax._src.estimation.checkpoints import (
    Kind,
    TrainingCheckpoints,
    network_in_folder,
    newest_step,
    read_network,
    save_network,
    write_network,
)
from dc2g_jax._src.estimation.compact_unet import Architecture, init_weights
from dc2g_jax._src.estimation.estimators import Estimator, NetworkCostToGo
from dc2g_jax._src.estimation.weights import fresh_weights
from dc2g_jax._src.files.digests import tree_sha256
from dc2g_jax._src.grid.terrain import CLASS_NAMES
from dc2g_jax._src.planning.named import make_planner
from dc2g_jax._src.runtime.errors import InputError

N_SCALES = len(Architecture().widths)

#: Facts of an architecture that can be built.
GOOD = json.loads(json.dumps(dataclasses.asdict(Architecture(widths=(4,) * N_SCALES, quantiles=(0.5,), embedding=4))))


def network(width: int = 4, seed: int = 0, cost_scale: float = 20.0) -> NetworkCostToGo:
    architecture = Architecture(widths=(width,) * N_SCALES, cost_scale=cost_scale)
    return NetworkCostToGo(weights=init_weights(architecture, jax.random.key(seed)), architecture=architecture)


def assert_equal(one: Any, other: Any) -> None:
    assert one.architecture == other.architecture
    assert_same(one, other)


def assert_same(one: Any, other: Any) -> None:
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert a.dtype == b.dtype
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()


@pytest.fixture(scope="module")
def saved_once(tmp_path_factory) -> Path:
    return save_network(tmp_path_factory.mktemp("saved") / "network", network())


@pytest.fixture
def folder(saved_once, tmp_path) -> Path:
    """A saved network to do as one likes with."""
    return shutil.copytree(saved_once, tmp_path / "network")


def refusal(folder: Path, *mentions: object) -> str:
    """The message of the refusal: one line that mentions everything it should."""
    with pytest.raises(InputError) as caught:
        network_in_folder(folder)
    message = str(caught.value)
    assert "\n" not in message
    for mention in (folder, *mentions):
        assert str(mention) in message
    return message


def test_round_trip(tmp_path):
    saved = network()
    folder = save_network(tmp_path / "deep" / "network", saved, {"seed": 7, "command": "train"})
    loaded = network_in_folder(folder)
    assert_equal(loaded, saved)
    terrain = jnp.full((9, 9), 3, jnp.uint8)
    np.testing.assert_array_equal(loaded.estimate(terrain, ()), saved.estimate(terrain, ()))
    card = json.loads((folder / "network.json").read_text())
    assert (card["seed"], card["command"]) == (7, "train")
    assert card["classes"] == list(CLASS_NAMES)
    assert not [path for path in folder.iterdir() if path.name not in {"network.json", "weights.safetensors"}]


def test_the_digest_of_a_network_tells_weights_and_architectures_apart(folder):
    assert tree_sha256(network_in_folder(folder)) == tree_sha256(network())
    others = (network(), network(seed=1), network(cost_scale=30.0))
    assert len({tree_sha256(one) for one in others}) == 3


def test_a_folder_may_be_given_as_a_relative_string(folder, monkeypatch):
    monkeypatch.chdir(folder.parent)
    assert_equal(network_in_folder(folder.name), network_in_folder(folder))


def with_bias(*numbers: float):
    saved = network()
    saved.weights["head"]["bias"] = jnp.resize(jnp.array(numbers, jnp.float32), saved.weights["head"]["bias"].shape)
    return saved


def test_weights_that_are_not_numbers_of_the_usual_kind_come_back_too(tmp_path):
    saved = with_bias(-0.0, 1e-42, 3e38)
    assert_equal(network_in_folder(save_network(tmp_path / "network", saved)), saved)


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_weights_that_are_not_finite_are_refused(number, tmp_path):
    folder = save_network(tmp_path / "network", with_bias(number))
    assert str(folder / "weights.safetensors") in refusal(folder, "not finite", "train the network anew")


def test_weights_of_another_training_are_refused(tmp_path):
    save_network(tmp_path / "one", network())
    save_network(tmp_path / "other", network(seed=1))
    shutil.copy(tmp_path / "other" / "weights.safetensors", tmp_path / "one")
    with pytest.raises(InputError, match=r"one/weights\.safetensors: the SHA-256 of the weights is not [0-9a-f]{64}"):
        network_in_folder(tmp_path / "one")
    card = tmp_path / "one" / "network.json"
    facts = json.loads(card.read_text())
    del facts["sha256"]  # a card written by hand
    card.write_text(json.dumps(facts))
    told = refusal(tmp_path / "one", "network.json", 'if they belong together, add "sha256"')
    facts["sha256"] = told.split('"')[-2]
    card.write_text(json.dumps(facts))
    assert_equal(network_in_folder(tmp_path / "one"), network(seed=1))


def test_saving_again_replaces(folder):
    other = network(width=6, seed=3)
    save_network(folder, other)
    assert_equal(network_in_folder(folder), other)


def test_saving_replaces_weights_that_are_damaged(folder):
    content = (folder / "weights.safetensors").read_bytes()
    (folder / "weights.safetensors").write_bytes(content[: len(content) // 2])
    refusal(folder, "weights.safetensors", "cannot be read")
    other = network(seed=3)
    save_network(folder, other)
    assert_equal(network_in_folder(folder), other)


def test_a_folder_that_is_not_there(tmp_path):
    refusal(tmp_path / "none", "network.json", "no such file")


def test_an_empty_folder(tmp_path):
    refusal(tmp_path, "network.json", "no such file")


def test_the_folder_of_a_training_names_its_network(tmp_path):
    save_network(tmp_path / "network", network())
    refusal(tmp_path, "no such file", f"give {tmp_path / 'network'}")


@pytest.mark.parametrize("content", [b"", b"{", b"not JSON", b"[]", b"3", b"\xff\xfe\x00"])
def test_a_broken_card(folder, content):
    (folder / "network.json").write_bytes(content)
    refusal(folder, "network.json")


def changed_card(folder: Path, **changes) -> None:
    card = json.loads((folder / "network.json").read_text())
    (folder / "network.json").write_text(json.dumps({**card, **changes}))


def test_another_kind_of_network(folder):
    changed_card(folder, network="transformer")
    refusal(folder, "network.json", "transformer", "expected compact_unet or package.module:Name")


@dataclasses.dataclass(frozen=True)
class Shades:
    """Architecture of a network with other inputs than class indices."""

    count: int = 3

    def __post_init__(self):
        if self.count < 1:
            raise ValueError("no shades")


class Shading(nnx.Module):
    def __init__(self, architecture, *, rngs):
        self.mix = nnx.Linear(architecture.count, 1, rngs=rngs)


@struct.dataclass
class ShadesCostToGo(Estimator):
    """A cost-to-go of a third party."""

    weights: Any
    architecture: Shades = struct.field(pytree_node=False)

    def estimate(self, terrain, state):
        return jnp.sum(self.weights["mix"]["kernel"]) * terrain[None].astype(jnp.float32)


SHADES = Kind(f"{__name__}:SHADES", Shades, Shading, "python train_shades.py", ShadesCostToGo, dtype=np.float16)
LONE = Kind(f"{__name__}:LONE", Shades, Shading, "python train_shades.py")


def shades_in(folder: Path, kind: Kind = SHADES) -> Path:
    weights = jax.tree.map(lambda leaf: leaf.astype(jnp.float16), fresh_weights(Shading, Shades(5), jax.random.key(0)))
    return write_network(folder, weights, Shades(5), kind, {"loss": "own"})


def test_a_network_of_a_kind_of_the_users_own_leads_a_planner(tmp_path):
    loaded = make_planner("dc2g", network=shades_in(tmp_path)).estimator
    assert isinstance(loaded, ShadesCostToGo)
    assert loaded.architecture == Shades(5)
    assert json.loads((tmp_path / "network.json").read_text())["network"] == SHADES.name
    kind, weights, architecture, card = read_network(tmp_path, SHADES)
    assert (kind, architecture, card["loss"]) == (SHADES, Shades(5), "own")
    jax.tree.map(np.testing.assert_array_equal, weights, loaded.weights)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"architecture": {"count": 4}}, ["weights", "another architecture"]),
        ({"architecture": {"count": 0}}, ["network.json", "no shades"]),
        ({"classes": ["grass"]}, ["network.json", "classes"]),
        ({"network": "compact_unet"}, ["network.json", "architecture"]),
        ({"network": "no_such_module:SHADES"}, ["network.json", "no_such_module:SHADES", "cannot be imported"]),
        ({"network": "pix2pix"}, ["network.json", "'pix2pix'", "compact_unet or package.module:Name"]),
    ],
)
def test_the_card_decides_what_kind_of_network_it_is(tmp_path, changes, words):
    changed_card(shades_in(tmp_path), **changes)
    refusal(tmp_path, *words)


def test_a_kind_without_an_estimator_is_for_no_planner(tmp_path):
    refusal(shades_in(tmp_path, LONE), "network.json", "architecture")
    assert read_network(tmp_path, LONE)[0] == LONE
    with pytest.raises(InputError, match=r"LONE', but expected .*SHADES; give a folder written by `python train_"):
        read_network(tmp_path, SHADES)


@pytest.mark.parametrize("classes", [None, [], [*CLASS_NAMES[:-1], "water"], [*CLASS_NAMES, "water"], 5])
def test_another_list_of_classes(folder, classes):
    changed_card(folder, classes=classes)
    refusal(folder, "network.json", "classes")


@pytest.mark.parametrize(
    "architecture",
    [
        None,
        {},
        5,
        *({key: value for key, value in GOOD.items() if key != lacking} for lacking in GOOD),
        *({**GOOD, "widths": widths} for widths in ("wide", [4], [0] * N_SCALES, [-4] * N_SCALES)),
        {**GOOD, "cost_scale": "large"},
        *({**GOOD, "cost_scale": scale} for scale in (float("nan"), float("inf"), 0, -1.0, True)),
        {**GOOD, "widths": [4.5] * N_SCALES},
        {**GOOD, "widths": [10**9] * N_SCALES},
        {**GOOD, "widths": [float("inf")] * N_SCALES},
        {**GOOD, "quantiles": [float("nan")]},
        {**GOOD, "quantiles": "0.5"},
    ],
    ids=json.dumps,
)
def test_an_architecture_that_cannot_be_built(folder, architecture):
    changed_card(folder, architecture=GOOD)
    refusal(folder, "weights of another architecture")
    changed_card(folder, architecture=architecture)
    refusal(folder, "is not one of this network's")


@pytest.mark.parametrize(
    "text",
    [
        f'{{"cost_scale": 1{"0" * 400}}}',
        f'{{"cost_scale": {"[" * 100_000}}}',
        f'{{"network": "{"x" * 300}"}}',
        '{"network": [Infinity]}',
        '{"network": "compact_unet", "classes": [Infinity]}',
    ],
    ids=["400 digits", "100,000 brackets", "a long name", "infinity as a name", "infinity as a class"],
)
def test_cards_to_break_readers_with(folder, text):
    (folder / "network.json").write_text(text)
    refusal(folder, "network.json")


def test_a_card_or_weights_that_are_not_files(folder):
    for name in ("weights.safetensors", "network.json"):
        (folder / name).unlink()
        os.mkfifo(folder / name)
        refusal(folder, name, "a device or a pipe")


def test_weights_of_another_architecture(folder, tmp_path):
    other = save_network(tmp_path / "other", network(width=6))
    shutil.copy(other / "network.json", folder / "network.json")
    refusal(folder, "weights", "another architecture")


def test_no_weights(folder):
    (folder / "weights.safetensors").unlink()
    refusal(folder, "weights.safetensors", "no such file")


@struct.dataclass
class Counted:
    """A state of a training with arrays of several types."""

    step: Any
    rest: Any


def counted(step: int) -> Counted:
    return Counted(jnp.int32(step), (jnp.full(3, step, jnp.bfloat16), {"key": jnp.uint32([1, 2])}, None))


def test_the_newest_two_states_are_kept_and_come_back_as_they_were(tmp_path):
    checkpoints = TrainingCheckpoints(tmp_path, Shades(), first_state=lambda config: counted(0))
    assert newest_step(tmp_path) == 0
    assert_same(checkpoints.restore(), counted(0))
    for step in (2, 9, 10):
        checkpoints.save(counted(step))
    assert checkpoints.steps() == [9, 10]
    assert newest_step(tmp_path) == 10
    again = TrainingCheckpoints(tmp_path, Shades(), first_state=lambda config: counted(0))
    assert_same(again.restore(), counted(10))
    assert_same(again.restore(9), counted(9))
    assert again.steps() == [9]


def test_a_state_of_another_program_is_refused(tmp_path):
    TrainingCheckpoints(tmp_path, Shades(), first_state=counted).save(counted(3))
    other = TrainingCheckpoints(tmp_path, Shades(), first_state=lambda config: Counted(jnp.int32(0), jnp.ones(2)))
    with pytest.raises(InputError, match=r"states/3: cannot be restored .*; delete it to go on"):
        other.restore()
