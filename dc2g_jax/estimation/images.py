"""The paper's pictures: maps in the colors of their classes, cost-to-go in gray, and how such a picture is read back.

Pictures are RGB, float32 from 0 to 1 with the colors last. All functions take one; `jax.vmap` makes them take many.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, UInt8

from dc2g_jax.grid.sampling import resize_nearest
from dc2g_jax.grid.terrain import CLASS_COLORS, TRAVERSABLE, UNKNOWN

#: A pixel of a higher HSV saturation is not gray and so stands for ground that cannot be driven on (section IV-A3).
SATURATION_LIMIT = 0.3

#: Color of ground that cannot be driven on.
RED = (1.0, 0.0, 0.0)


def semantic_image(terrain: UInt8[Array, "h w"]) -> Float[Array, "h w 3"]:
    """The picture of a map: the colors of its classes, black where nothing has been observed."""
    return jnp.asarray(CLASS_COLORS / 255.0, jnp.float32)[terrain]


def largest_cost(cost_to_go: Float[Array, "h w"]) -> Float[Array, ""]:
    """The largest finite cost; 0 where there is none."""
    return jnp.max(jnp.where(jnp.isfinite(cost_to_go), cost_to_go, 0.0))


def cost_to_go_image(
    cost_to_go: Float[Array, "h w"], terrain: UInt8[Array, "h w"], largest: Float[Array, ""]
) -> Float[Array, "h w 3"]:
    """The picture of a cost-to-go: what the paper's network learns to draw (section III-A, Fig. 3).

    Gray 1 - d / `largest`; then scaled so that the brightest visible pixel is 1, which the authors' scripts do and the
    paper does not say. Red where the ground cannot be driven on. Black where nothing has been observed and where there
    is no way to a goal.

    Args:
      cost_to_go: cost of every cell, infinity where there is none.
      terrain: observed class indices, 0 where not observed.
      largest: cost of the whole map that is drawn black, whether or not it is visible; see `largest_cost`.
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
    """A picture as a file of 8 bits a color holds it, rounded down as the implementation that the paper names does.

    So black that a network draws as nearly black is black; it would have a saturation of any size otherwise.
    """
    return jnp.floor(jnp.minimum(255.5 * image, 255)) / 255


def saturation(image: Float[Array, "h w 3"]) -> Float[Array, "h w"]:
    """S of HSV: 0 for grays, 1 for pure colors; 0 for black."""
    high, low = jnp.max(image, axis=-1), jnp.min(image, axis=-1)
    return jnp.where(high > 0, (high - low) / jnp.where(high > 0, high, 1.0), 0.0)


def brightness(image: Float[Array, "h w 3"]) -> Float[Array, "h w"]:
    """V of HSV."""
    return jnp.max(image, axis=-1)


def looks_traversable(image: Float[Array, "h w 3"]) -> Bool[Array, "h w"]:
    """Pixels that are gray enough to stand for ground that can be driven on (S < 0.3)."""
    return saturation(image) < SATURATION_LIMIT


def read_cost_to_go(image: Float[Array, "h w 3"], height: int, width: int) -> Float[Array, "height width"]:
    """The cost-to-go that a picture shows, on a grid (Algorithm 2, line 10: filter and resize).

    Args:
      image: a picture such as `cost_to_go_image` makes.
      height: rows of the grid.
      width: columns of the grid.

    Returns:
      1 - brightness: 0 at the goal; 1, the worst there is, where the picture is not gray.
    """
    cost = jnp.where(looks_traversable(image), 1 - brightness(image), 1.0)
    return resize_nearest(cost, height, width)
