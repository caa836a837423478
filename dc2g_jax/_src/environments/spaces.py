"""Spaces of observations and actions with the interface of gymnax, which need not be installed."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Int, PRNGKeyArray, Shaped


@dataclasses.dataclass(frozen=True)
class Discrete:
    """The whole numbers from 0 to `n` - 1, int32.

    Attributes:
      n: number of values.
    """

    n: int
    shape: ClassVar[tuple[int, ...]] = ()
    dtype: ClassVar[Any] = jnp.int32

    def sample(self, key: PRNGKeyArray) -> Int[Array, ""]:
        """A uniformly random number."""
        return jax.random.randint(key, (), 0, self.n, self.dtype)

    def contains(self, value: ArrayLike) -> Bool[Array, "..."]:
        """Whether each number of an array is in the space."""
        return (jnp.asarray(value) >= 0) & (jnp.asarray(value) < self.n)


@dataclasses.dataclass(frozen=True)
class Box:
    """Arrays of numbers within bounds.

    Attributes:
      low: smallest number.
      high: largest number.
      shape: shape of the arrays.
      dtype: type of the numbers.
    """

    low: float
    high: float
    shape: tuple[int, ...]
    dtype: Any = jnp.float32

    def sample(self, key: PRNGKeyArray) -> Shaped[Array, "..."]:
        """An array of uniformly random numbers."""
        if jnp.issubdtype(self.dtype, jnp.integer):
            return jax.random.randint(key, self.shape, self.low, self.high + 1, self.dtype)
        return jax.random.uniform(key, self.shape, self.dtype, self.low, self.high)

    def contains(self, value: ArrayLike) -> Bool[Array, ""]:
        """Whether all numbers of an array are within the bounds."""
        return jnp.all((jnp.asarray(value) >= self.low) & (jnp.asarray(value) <= self.high))


@dataclasses.dataclass(frozen=True)
class Dict:
    """Objects whose attributes lie in given spaces.

    Attributes:
      spaces: attribute name -> space.
      make: makes an object from its attributes as keyword arguments.
    """

    spaces: Mapping[str, Any]
    make: Callable[..., Any]

    def sample(self, key: PRNGKeyArray) -> Any:
        """A random object."""
        keys = zip(self.spaces, jax.random.split(key, len(self.spaces)), strict=True)
        return self.make(**{name: self.spaces[name].sample(own) for name, own in keys})

    def contains(self, value: Any) -> Bool[Array, ""]:
        """Whether every attribute of an object is in its space."""
        return jnp.all(jnp.stack([space.contains(getattr(value, name)) for name, space in self.spaces.items()]))
