"""The pix2pix networks: the published shapes, layers that do what they say, and an estimator that planners can use."""

import dataclasses
import functools
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dc2g_jax as dc2g
from dc2g_jax._src.estimation.checkpoints import write_network
from dc2g_jax._src.estimation.weights import shapes_of_weights, with_weights
from dc2g_jax._src.grid import gridworld
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.sampling import resize_nearest
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.planners import DC2G
from dc2g_jax._src.planning.rules import complete_rules
from experiments.translator import images, network as pix2pix
from experiments.translator.network import (
    TRANSLATOR,
    Discriminator,
    Generator,
    TranslatorArchitecture,
    TranslatorCostToGo,
    init_weights,
    with_statistics,
)
from tests.support.refusals import refusal

TINY = TranslatorArchitecture(size=32, base_filters=4)
translate = jax.jit(lambda weights, *inputs: with_weights(Generator, TINY, weights)(*inputs))


@pytest.fixture(scope="module")
def weights():
    return init_weights(Generator, TINY, jax.random.key(0))


@pytest.fixture(scope="module")
def pictures() -> np.ndarray:
    return np.random.default_rng(0).random((2, 32, 32, 3), dtype=np.float32)


def count(tree) -> int:
    return sum(leaf.size for leaf in jax.tree.leaves(tree))


def test_the_full_size_is_that_of_pix2pix():
    full = TranslatorArchitecture()
    assert full.widths == (64, 128, 256, 512, 512, 512, 512, 512)
    assert count(shapes_of_weights(pix2pix.Generator, full)) == 54_419_459
    make = functools.partial(init_weights, Discriminator, full)
    assert count(jax.eval_shape(make, jax.random.key(0))) == 2_769_601
    picture = jax.ShapeDtypeStruct((1, 256, 256, 3), jnp.float32)
    odds = jax.eval_shape(
        lambda weights, *pair: with_weights(Discriminator, full, weights)(*pair),
        jax.eval_shape(make, jax.random.key(0)),
        picture,
        picture,
    )
    assert odds.shape == (1, 30, 30)


def test_weights_are_drawn_as_pix2pix_draws_them(weights):
    layer = weights["down1"]
    assert float(jnp.std(layer["convolution"]["kernel"])) == pytest.approx(0.02, rel=0.1)
    assert abs(float(jnp.mean(layer["norm"]["scale"])) - 1) < 0.02
    assert not np.any(layer["convolution"]["bias"])
    assert not np.array_equal(layer["convolution"]["kernel"], weights["up1"]["convolution"]["kernel"])


def test_pictures_become_pictures(weights, pictures):
    answers = translate(weights, pictures)
    assert (answers.shape, answers.dtype) == ((2, 32, 32, 3), jnp.float32)
    assert 0 <= float(answers.min()) < float(answers.max()) <= 1
    # Each picture is normalized by itself, so it does not matter which others are asked about.
    np.testing.assert_allclose(answers[:1], translate(weights, pictures[:1]), atol=1e-5)


def test_features_are_dropped_only_with_a_key_and_as_the_key_says(weights, pictures):
    plain = translate(weights, pictures)
    one, again, other = (translate(weights, pictures, jax.random.key(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(plain, translate(weights, pictures))
    np.testing.assert_array_equal(one, again)
    assert not np.allclose(one, plain, atol=1e-4)
    assert not np.allclose(one, other, atol=1e-4)


def test_doubling_is_a_transposed_convolution():
    layer = pix2pix._Doubling(5, 3, dtype=jnp.float32)
    layer.kernel[...] = jax.random.normal(jax.random.key(0), layer.kernel.shape)
    layer.bias[...] = jnp.arange(3.0)
    features = jax.random.normal(jax.random.key(1), (2, 4, 6, 5))
    # JAX's transposed convolution slides the kernel, whose transpose this is; hence the flip.
    expected = jax.lax.conv_transpose(
        features, layer.kernel[::-1, ::-1], (2, 2), "SAME", dimension_numbers=("NHWC", "HWIO", "NHWC")
    )
    np.testing.assert_allclose(layer(features), expected + np.arange(3.0), atol=1e-5)


@pytest.mark.parametrize("axes", [(1, 2), (0, 1, 2)])
def test_normalization_is_by_channel_and_picture_or_batch(axes):
    layer = pix2pix._Norm(3)
    layer.scale[...] = jnp.array([1.0, 2.0, -1.0])
    features = np.random.default_rng(0).normal(5, 3, (2, 8, 8, 3)).astype(np.float32)
    mean, deviation = features.mean(axis=axes, keepdims=True), features.std(axis=axes, keepdims=True)
    expected = (features - mean) / deviation * np.asarray(layer.scale[...])
    np.testing.assert_allclose(pix2pix._normalized(layer, jnp.asarray(features), axes=axes), expected, atol=1e-4)


def test_after_batch_normalization_all_pictures_are_normalized_alike(weights, pictures):
    batch = dataclasses.replace(TINY, normalization="batch")
    weights = jax.tree.map(lambda leaf: leaf + 0.01 * jnp.arange(leaf.size).reshape(leaf.shape) % 0.1, weights)
    in_training = functools.partial(pix2pix._normalized, axes=(0, 1, 2))
    expected = with_weights(Generator, batch, weights)(pictures, normalize=in_training)
    trained = with_weights(Generator, batch, with_statistics(batch, weights, pictures))
    np.testing.assert_allclose(trained(pictures), expected, atol=1e-5)
    np.testing.assert_allclose(trained(pictures[:1]), expected[:1], atol=1e-5)
    assert not np.allclose(expected, translate(weights, pictures), atol=1e-3)


@pytest.mark.parametrize("normalization", ["instance", "batch"])
def test_in_training_batch_normalization_mixes_pictures(weights, pictures, monkeypatch, normalization):
    monkeypatch.setattr(pix2pix, "_DROPOUT_LEVELS", 0)
    architecture = dataclasses.replace(TINY, normalization=normalization)
    generate = with_weights(Generator, architecture, weights)
    judge = with_weights(Discriminator, architecture, init_weights(Discriminator, architecture, jax.random.key(1)))
    for both, alone in (
        (generate(pictures, jax.random.key(0)), generate(pictures[:1], jax.random.key(0))),
        (judge(pictures, pictures), judge(pictures[:1], pictures[:1])),
    ):
        assert np.allclose(both[:1], alone, atol=1e-5) == (normalization == "instance")


@pytest.mark.parametrize(("normalization", "furthest"), [("instance", 0.0), ("batch", 1 / 18)])
def test_with_batch_normalization_outputs_reach_beyond_black_and_white(weights, pictures, normalization, furthest):
    architecture = dataclasses.replace(TINY, normalization=normalization)
    for value, color in ((-50.0, 0.0), (50.0, 1.0)):
        layer = weights["up0"] | {"convolution": weights["up0"]["convolution"] | {"bias": jnp.full(3, value)}}
        network = pix2pix.TranslatorCostToGo(weights | {"up0": layer}, architecture)
        drawn = with_weights(Generator, architecture, network.weights)(pictures)
        np.testing.assert_allclose(drawn, color + np.sign(value) * furthest, atol=1e-6)
        np.testing.assert_array_equal(network.answer(pictures), color)


def test_bfloat16_answers_about_the_same(weights, pictures):
    half = TranslatorArchitecture(size=32, base_filters=4, compute_dtype="bfloat16")
    answers = jax.jit(with_weights(Generator, half, weights))(pictures)
    assert answers.dtype == jnp.float32
    np.testing.assert_allclose(answers, translate(weights, pictures), atol=0.1)


@pytest.mark.parametrize(
    ("change", "mention"),
    [
        ({"size": 48}, "48"),
        ({"size": 16}, "16"),
        ({"base_filters": 0}, "0"),
        ({"compute_dtype": "int8"}, "bfloat16"),
        ({"normalization": "layer"}, "batch"),
    ],
)
def test_networks_that_cannot_be_built(change, mention):
    with pytest.raises(ValueError, match=mention):
        TranslatorArchitecture(**change)


def test_the_estimate_is_read_off_the_picture(weights, street):
    network = TranslatorCostToGo(weights=weights, architecture=TINY)
    ask = jax.jit(network.estimate)
    estimate = ask(jnp.asarray(street), network.init(World.from_terrain(street)))
    large = resize_nearest(jnp.asarray(street), 32, 32)
    picture = images.in_eight_bits(translate(weights, images.semantic_image(large)[None])[0])
    read = images.read_cost_to_go(picture, jnp.asarray(street))
    np.testing.assert_allclose(estimate[0], read, atol=1.01 / 255)  # a rounding error counts one
    assert estimate.shape == (1, *street.shape)
    assert np.isfinite(estimate).all()
    many = ask(jnp.stack([jnp.asarray(street)] * 3, axis=-1), ())
    np.testing.assert_allclose(many, np.repeat(np.asarray(estimate)[..., None], 3, axis=3), atol=1e-5)


def test_a_planner_uses_it(weights, street):
    rules = complete_rules(2)
    planner = DC2G(TranslatorCostToGo(weights=weights, architecture=TINY), rules)
    world = World.from_terrain(street)
    plan = jax.jit(planner.plan)
    belief, state = gridworld.reset(world, make_pose(9, 5, 2), rules.sensing), planner.init(world)
    for _ in range(3):
        decision, state = plan(belief, state)
        belief = gridworld.step(world, belief, decision.action, rules.sensing)
    assert int(belief.steps) == 3


def test_a_saved_translator_is_found_by_its_card(tmp_path, weights):
    folder = write_network(tmp_path, weights, TINY, TRANSLATOR, {"loss": "l1"})
    loaded = dc2g.load_network(folder)
    assert isinstance(loaded, TranslatorCostToGo)
    assert loaded.architecture == TINY
    jax.tree.map(np.testing.assert_array_equal, loaded.weights, weights)
    card = json.loads((folder / "network.json").read_text())
    assert card["network"] == "experiments.translator.network:TRANSLATOR"
    for wrong in ({"size": 33}, {"base_filters": 0}, {"compute_dtype": 8}):
        changed = {**card, "architecture": {**card["architecture"], **wrong}}
        (folder / "network.json").write_text(json.dumps(changed))
        refusal(lambda: dc2g.load_network(folder), "network.json", "architecture")
