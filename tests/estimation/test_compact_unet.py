"""The network: any map size, plain weights, and a loss that ignores what does not count."""

import functools
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

import dc2g_jax as dc2g
from dc2g_jax._src.estimation import compact_unet
from dc2g_jax._src.estimation.checkpoints import save_network
from dc2g_jax._src.estimation.compact_unet import Architecture, CompactUNet, init_weights
from dc2g_jax._src.estimation.estimators import ExactCostToGo, NetworkCostToGo, world_cost_to_go
from dc2g_jax._src.estimation.weights import shapes_of_weights
from dc2g_jax._src.grid.search import EIGHT_CONNECTED
from dc2g_jax._src.grid.terrain import CLASS_NAMES, OUTSIDE, UNKNOWN
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.planners import summarized
from dc2g_jax._src.planning.selection import ExpectedCost, QuantileCost
from dc2g_jax._src.runtime.errors import InputError
from tests.support import maps
from tests.support.networks import random_network
from tests.support.refusals import refusal

SMALL = Architecture(widths=(4, 4, 6), quantiles=(0.25, 0.5, 0.75), cost_scale=10.0, patch=3, embedding=5)
apply = jax.jit(functools.partial(compact_unet.apply, SMALL))


@pytest.fixture(scope="module")
def weights():
    return init_weights(SMALL, jax.random.key(0))


@pytest.mark.parametrize("shape", [(1, 1), (2, 1), (7, 33), (32, 32), (49, 50)], ids="{0[0]}x{0[1]}".format)
def test_maps_of_any_size(weights, shape):
    terrain = np.stack([maps.random_terrain(seed, shape, 0.7) for seed in range(3)])
    estimate = np.asarray(apply(weights, terrain))
    assert estimate.shape == (3, *shape, 3)
    assert estimate.dtype == np.float32
    assert np.isfinite(estimate).all()


def test_maps_of_a_batch_do_not_touch_each_other():
    weights = random_network(SMALL).weights
    terrain = np.stack([maps.random_terrain(seed, (20, 20), 0.7) for seed in range(5)])
    together = np.asarray(apply(weights, terrain))
    np.testing.assert_array_equal(apply(weights, terrain[:4]), together[:4])
    for one, alone in zip(together, terrain, strict=True):
        np.testing.assert_allclose(apply(weights, alone[None])[0], one, rtol=1e-4, atol=1e-4)


def test_what_is_observed_matters(weights):
    terrain = maps.random_terrain(0, (20, 20), 0.7)
    hidden = np.where(np.arange(20) < 10, terrain, 0).astype(np.uint8)
    assert not np.allclose(apply(weights, terrain[None]), apply(weights, hidden[None]))


def test_weights_depend_on_the_key_alone(weights):
    jax.tree.map(np.testing.assert_array_equal, init_weights(SMALL, jax.random.key(0)), weights)
    other = init_weights(SMALL, jax.random.key(1))
    assert not np.array_equal(other["embed"]["kernel"], weights["embed"]["kernel"])
    assert all(leaf.dtype == jnp.float32 for leaf in jax.tree.leaves(weights))


def test_shapes_are_known_without_weights(weights):
    shapes = shapes_of_weights(CompactUNet, SMALL)
    assert jax.tree.structure(shapes) == jax.tree.structure(weights)
    assert [leaf.shape for leaf in jax.tree.leaves(shapes)] == [leaf.shape for leaf in jax.tree.leaves(weights)]


def test_the_pure_function_is_the_module():
    module = CompactUNet(SMALL, rngs=nnx.Rngs(3))
    weights = nnx.to_pure_dict(nnx.split(module)[1])
    terrain = jnp.asarray(maps.random_terrain(0, (20, 20), 0.7)[None])
    np.testing.assert_allclose(apply(weights, terrain), module(terrain), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(
    ("facts", "message"),
    [
        ({"widths": (4,)}, "number of widths 1: give a number from 2 to 16"),
        ({"widths": (4, 0)}, "width 0: give a whole number from 1 to 4096 channels"),
        ({"patch": 0}, "patch 0: give a whole number from 1 to 16 cells"),
        ({"side": 4097}, "side 4097: give"),
        ({"cost_scale": 0.0}, r"cost_scale 0\.0: give a number above 0"),
        ({"embedding": -1}, "embedding -1: give"),
    ],
)
def test_invalid_architectures_are_refused(facts, message):
    with pytest.raises(InputError, match=message):
        Architecture(**facts)


@pytest.mark.parametrize("levels", [(), (0.5, 0.1), (0.5, 0.5), (0.0, 0.5), (0.5, 1.0)])
def test_quantiles_that_are_none_are_refused(levels):
    with pytest.raises(InputError, match="ascending levels"):
        Architecture(quantiles=levels)


def test_the_estimator_is_the_network_on_one_map(weights):
    terrain = maps.random_terrain(0, (20, 20), 0.7)
    network = NetworkCostToGo(weights=weights, architecture=SMALL)
    state = network.init(World.from_terrain(terrain))
    np.testing.assert_allclose(
        np.moveaxis(network.estimate(jnp.asarray(terrain), state), 0, -1),
        apply(weights, terrain[None])[0],
        rtol=1e-4,
        atol=1e-4,
    )


def test_estimates_of_a_batch_are_those_of_its_maps(weights):
    terrain = np.stack([maps.random_terrain(seed, (9, 20), 0.7) for seed in range(4)], axis=-1)
    network = NetworkCostToGo(weights=weights, architecture=SMALL)
    together = np.asarray(network.estimate(jnp.asarray(terrain), ()))
    assert together.shape == (3, 9, 20, 4)
    for index in range(4):
        alone = network.estimate(jnp.asarray(terrain[..., index]), ())
        np.testing.assert_allclose(together[..., index], alone, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    "summary",
    [
        ExpectedCost(0.5).summary,
        QuantileCost(level=0.7, distance_weight=0.5).summary,
        lambda costs: costs[1:] - 2 * costs[:1],
    ],
)
def test_a_summarized_network_computes_the_weighted_sum(weights, summary):
    terrain, network = jnp.asarray(maps.random_terrain(0, (9, 20), 0.7)), NetworkCostToGo(weights, SMALL)
    wanted = summary(network.estimate(terrain, ()))
    np.testing.assert_allclose(network.summarized(summary).estimate(terrain, ()), wanted, rtol=1e-4, atol=1e-4)


def test_the_exact_estimator_knows_the_hidden_map(street):
    world = World.from_terrain(street)
    nothing = jnp.zeros(street.shape, jnp.uint8)
    for moves in (EIGHT_CONNECTED, EIGHT_CONNECTED[:4]):
        exact = ExactCostToGo(moves=moves)
        estimate = exact.estimate(nothing, exact.init(world))
        np.testing.assert_array_equal(estimate[0], world_cost_to_go(world, moves=moves))
    assert np.asarray(estimate)[0, 4, 2] == 4  # up the path from the road
    assert np.isinf(np.asarray(estimate)[0, 0, 0])
    error = np.log(np.linspace(0.5, 2, street.size).reshape(street.shape)).astype(np.float32)
    wrong = ExactCostToGo(log_error=jnp.asarray(error))
    np.testing.assert_allclose(wrong.estimate(nothing, wrong.init(world)), estimate * np.exp(error), rtol=1e-6)


@pytest.mark.parametrize("side", [1, 2, 5, 16])
def test_the_first_layer_is_the_product_with_one_hot_classes(side):
    """Its value, and its derivative by the kernel: each of two kernels with maps of its own."""
    rng = np.random.default_rng(side)
    terrain = rng.integers(0, len(CLASS_NAMES), (2, 3, 2 * side, 4 * side), np.uint8)
    beyond = rng.random(terrain.shape) < 0.2
    terrain[beyond] = rng.integers(OUTSIDE, 256, terrain.shape, np.uint8)[beyond]
    terrain[0, 0] = UNKNOWN
    kernel = rng.normal(size=(2, side**2 * len(CLASS_NAMES), 7)).astype(np.float32)
    weight = rng.normal(size=(2, 3, 2, 4, 7)).astype(np.float32)

    def weighted(kernel, terrain, weight):
        answer = compact_unet.embedded(kernel, terrain, side)
        return jnp.sum(answer * weight), answer

    with jax.default_matmul_precision("highest"):
        both = jax.jit(jax.vmap(jax.grad(weighted, has_aux=True)))(*map(jnp.asarray, (kernel, terrain, weight)))
    expected, slope = np.zeros(weight.shape), np.zeros(kernel.shape)
    for which, number, row, column in np.ndindex(weight.shape[:4]):
        for i, j in np.ndindex(side, side):
            kind = int(terrain[which, number, side * row + i, side * column + j])
            if kind < len(CLASS_NAMES):
                place = (side * i + j) * len(CLASS_NAMES) + kind
                expected[which, number, row, column] += kernel[which, place]
                slope[which, place] += weight[which, number, row, column]
    np.testing.assert_allclose(both[0], slope, atol=1e-4)
    np.testing.assert_allclose(both[1], expected, atol=1e-4)


@pytest.mark.parametrize("shape", [(4, 5, 5), (9, 3, 3), (5, 2, 1), (8, 4, 5), (3, 3, 3), (8, 5, 6)])
def test_a_convolution_sums_over_taps(shape):
    """Its value, and its derivatives: each of two kernels with maps of its own."""
    rng = np.random.default_rng(0)
    features = rng.normal(size=(2, *shape, 6))
    kernel, weight = rng.normal(size=(2, 3, 3, 6, 7)), rng.normal(size=(2, *shape, 7))
    module = compact_unet.Convolution(6, 7, rngs=nnx.Rngs(0))
    module.bias[...] = jnp.arange(7.0)

    def convolved(features, kernel):
        return nnx.merge(nnx.graphdef(module), nnx.State({"kernel": kernel, "bias": module.bias}))(features)

    def weighted(features, kernel, weight):
        answer = convolved(features, kernel)
        return jnp.sum(answer * weight), answer

    small = shape[0] > 3 and max(shape[1:]) < 6
    given = [jnp.asarray(array, jnp.float32) for array in (features, kernel, weight)]
    assert ("minimal_filtering" in str(jax.make_jaxpr(convolved)(given[0][0], given[1][0]))) == small
    slopes, answer = jax.jit(jax.vmap(jax.grad(weighted, argnums=(0, 1), has_aux=True)))(*given)
    framed, slope = (np.pad(array, ((0, 0), (0, 0), (1, 1), (1, 1), (0, 0))) for array in (features, 0 * features))
    expected, of_kernel = np.zeros(weight.shape) + np.arange(7), np.zeros(kernel.shape)
    for row, column in np.ndindex(3, 3):
        at = np.s_[:, :, row : row + shape[1], column : column + shape[2]]
        expected += np.einsum("nbhwc,ncd->nbhwd", framed[at], kernel[:, row, column])
        slope[at] += np.einsum("nbhwd,ncd->nbhwc", weight, kernel[:, row, column])
        of_kernel[:, row, column] = np.einsum("nbhwc,nbhwd->ncd", framed[at], weight)
    for found, wanted in ((answer, expected), (slopes[0], slope[:, :, 1:-1, 1:-1]), (slopes[1], of_kernel)):
        np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())
    if shape[2] == 1:
        assert not slopes[1][:, :, ::2].any()  # taps that meet zeros alone


@pytest.mark.parametrize(
    "architecture",
    [
        Architecture(),
        Architecture(widths=(4, 8, 16, 32), patch=3, embedding=0),
        Architecture((16, 32, 64), patch=4, embedding=48),
    ],
)
def test_multiply_accumulates(architecture):
    """Counted layer by layer, for maps whose patches halve without rest."""
    widths, area, embedding = architecture.widths, architecture.patch**2, architecture.embedding
    side = architecture.patch * 32
    cells = [(32 >> scale) ** 2 for scale in range(len(widths))]
    residual = [2 * 9 * width * width for width in widths]
    finest = embedding or widths[0]
    linear = area * len(CLASS_NAMES) * finest + finest * area * len(architecture.quantiles)
    linear += embedding * widths[0] + (widths[0] + embedding) * embedding
    by_hand = cells[0] * (linear + 2 * residual[0])
    for scale in range(1, len(widths)):
        wider, narrower = widths[scale], widths[scale - 1]
        by_hand += cells[scale] * (9 * narrower * wider + 2 * residual[scale] + wider * narrower)
    # Where a kernel hangs over the map's edge nothing is multiplied.
    counted = compact_unet.multiply_accumulates(architecture, side, side)
    assert 0.75 * by_hand < counted < by_hand


class Own(nnx.Module):
    """A network of the user's own: a list of one convolution, with a different offset for each quantile."""

    def __init__(self, architecture, *, rngs):
        self.layers = nnx.List([nnx.Conv(len(CLASS_NAMES), len(architecture.quantiles), (3, 3), rngs=rngs)])

    def __call__(self, terrain):
        return 10 * self.layers[0](jax.nn.one_hot(terrain, len(CLASS_NAMES)))


class Narrow(Own):
    def __call__(self, terrain):
        return super().__call__(terrain)[..., 0]


class Unmade(nnx.Module):
    def __init__(self, architecture, *, rngs):
        raise RuntimeError(f"nothing for {len(architecture.quantiles)} quantiles")


class Bare(nnx.Module):
    def __call__(self, terrain):
        return terrain


class Mismatched(Own):
    def __call__(self, terrain):
        return self.layers[0](jnp.ones((*terrain.shape, 3)))


class Twofold(Own):
    def __call__(self, terrain):
        return super().__call__(terrain), terrain


class Dropping(Own):
    def __init__(self, architecture, *, rngs):
        super().__init__(architecture, rngs=rngs)
        self.drop = nnx.Dropout(0.5, rngs=rngs)


class Normalized(Own):
    def __init__(self, architecture, *, rngs):
        super().__init__(architecture, rngs=rngs)
        self.norm = nnx.BatchNorm(len(architecture.quantiles), rngs=rngs)


OWN = Architecture(network=f"{__name__}:Own")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("another", ["no network is called 'another'", "compact_unet", "package.module:Name"]),
        (f"{__name__}:SMALL", ["give a subclass of flax.nnx.Module"]),
        (f"{__name__}:Narrow", ["float32[1, 50, 50]", "expected float32[1, 50, 50, 5]"]),
        (f"{__name__}:Unmade", ["Unmade'", "RuntimeError: nothing for 5 quantiles", "network(architecture, rngs=...)"]),
        (f"{__name__}:Bare", ["Bare'", "TypeError", "network(architecture, rngs=...)"]),
        (f"{__name__}:Mismatched", ["Mismatched'", "50 x 50 cells", "3 // 1 != 16"]),
        (f"{__name__}:Twofold", ["Twofold'", "answers with a tuple", "one array"]),
        (f"{__name__}:Dropping", ["Dropping'", "drop.rngs.count is a RngCount of uint32", "no Dropout"]),
        (f"{__name__}:Normalized", ["Normalized'", "norm.mean is a BatchStat", "GroupNorm in place of BatchNorm"]),
    ],
)
def test_what_is_no_network_is_refused(name, words):
    refusal(lambda: compact_unet.check_network(Architecture(network=name)), *words)


def test_a_network_of_the_users_own_is_kept_and_leads_a_planner(tmp_path):
    compact_unet.check_network(OWN)
    network = NetworkCostToGo(init_weights(OWN, jax.random.key(1)), OWN)
    loaded = dc2g.load_network(save_network(tmp_path / "network", network))
    assert loaded.architecture == OWN
    assert json.loads((tmp_path / "network" / "network.json").read_text())["network"] == OWN.network
    terrain = jnp.asarray(maps.random_terrain(3, (14, 12), 0.7)[..., None])
    jax.tree.map(np.testing.assert_array_equal, loaded.weights, network.weights)
    outcomes = loaded.estimate(terrain, ())
    for selection in (ExpectedCost(0.5), QuantileCost(0.7, 0.5)):
        told = summarized(loaded, selection.summary, terrain, ())
        np.testing.assert_allclose(told, selection.summary(outcomes), rtol=1e-5)
    dc2g.check_planner(dc2g.make_planner("dc2g", network=loaded))
