"""The paper's images: maps in the colors of their classes, cost-to-go in gray, and reading the cost-to-go back.

Images are RGB, float32 from 0 to 1, with the colors last. All functions take one image; use `jax.vmap` for several.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, UInt8

from dc2g_jax._src.grid.sampling import resize_nearest
from dc2g_jax._src.grid.terrain import CLASS_COLORS, TRAVERSABLE, UNKNOWN

#: Pixels with a higher HSV saturation are not gray, so they are not traversable (section IV-A3).
SATURATION_LIMIT = 0.3

#: Color of ground that is not traversable.
RED = (1.0, 0.0, 0.0)


def semantic_image(terrain: UInt8[Array, "h w"]) -> Float[Array, "h w 3"]:
    """The image of a map: the colors of its classes; unobserved cells are black."""
    return jnp.asarray(CLASS_COLORS / 255.0, jnp.float32)[terrain]


def largest_cost(cost_to_go: Float[Array, "h w"]) -> Float[Array, ""]:
    """The largest finite cost; 0 if there is none."""
    return jnp.max(jnp.where(jnp.isfinite(cost_to_go), cost_to_go, 0.0))


def cost_to_go_image(
    cost_to_go: Float[Array, "h w"], terrain: UInt8[Array, "h w"], largest: Float[Array, ""]
) -> Float[Array, "h w 3"]:
    """The image of a cost-to-go, the target of the paper's network (section III-A, Fig. 3).

    Traversable cells have gray level 1 - d / `largest`, scaled so that the brightest visible pixel is 1. (The authors'
    scripts do this scaling; the paper does not mention it.) Other ground is red. Unobserved cells and cells without a
    path to a goal are black.

    Args:
      cost_to_go: cost of every cell, infinity without a path.
      terrain: observed class indices, 0 for unobserved cells.
      largest: cost drawn as black: the largest of the whole map, visible or not; see `largest_cost`.
    """
    drivable = jnp.asarray(TRAVERSABLE)[terrain]
    value = 1 - cost_to_go / jnp.maximum(largest, jnp.finfo(jnp.float32).tiny)
    value = jnp.where(drivable & jnp.isfinite(cost_to_go), value, 0.0)
    brightest = jnp.max(value)
    value = jnp.where(brightest > 0, value / jnp.where(brightest > 0, brightest, 1.0), 0.0)
    gray = jnp.clip(value, 0.0, 1.0)[..., None]
    blocked = (terrain != UNKNOWN) & ~drivable
    return jnp.where(blocked[..., None], jnp.asarray(RED, jnp.float32), gray)


def in_eight_bits(image: Float[Array, "h w 3"]) -> Float[Array, "h w 3"]:
    """Clip an image and quantize it to 8 bits per color, rounding down like the implementation that the paper names.

    A network's nearly black pixels become black. Otherwise their saturation would be arbitrary.
    """
    return jnp.floor(jnp.clip(255.5 * image, 0, 255)) / 255


def saturation(image: Float[Array, "h w 3"]) -> Float[Array, "h w"]:
    """S of HSV: 0 for grays and black, 1 for pure colors."""
    high, low = jnp.max(image, axis=-1), jnp.min(image, axis=-1)
    return jnp.where(high > 0, (high - low) / jnp.where(high > 0, high, 1.0), 0.0)


def brightness(image: Float[Array, "h w 3"]) -> Float[Array, "h w"]:
    """V of HSV."""
    return jnp.max(image, axis=-1)


def looks_traversable(image: Float[Array, "h w 3"]) -> Bool[Array, "h w"]:
    """Pixels that are gray enough to be traversable (S < 0.3)."""
    return saturation(image) < SATURATION_LIMIT


def read_cost_to_go(image: Float[Array, "s s 3"], terrain: UInt8[Array, "h w"]) -> Float[Array, "h w"]:
    """Read the cost-to-go of an image on the grid of its map (Algorithm 2, line 10: filter and resize).

    The map tells what is traversable, as in the authors' later code. Red on such ground is the network's error, so the
    cost is read from the green channel, which red leaves at zero. The authors' first code took pixels that are not gray
    enough for blocked: with our networks, 9 to 33 % of the cells that a robot may head for.

    Args:
      image: an image such as `cost_to_go_image` makes.
      terrain: observed class indices.

    Returns:
      1 - the green channel: 0 at the goal; 1, the highest cost, where the map shows no traversable ground.
    """
    cost = 1 - resize_nearest(image[..., 1], *terrain.shape)
    return jnp.where(jnp.asarray(TRAVERSABLE)[terrain], cost, 1.0)
