"""Losses between an estimated distribution of the cost-to-go and the exact value, for each cell."""

import functools
import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from dc2g_jax._src.files.digests import arrays_sha256
from dc2g_jax._src.runtime.errors import InputError, short
from dc2g_jax._src.runtime.own_parts import own_part

#: What losses get, in units of the network's cost scale, and the levels of the estimated quantiles.
_Estimate = Float[Array, "h w quantiles"]
_Target = Float[Array, "h w 1"]
_Levels = Float[Array, "quantiles"]

#: `(estimate, target, levels) ->` loss of each estimate, in units of the network's cost scale.
Loss = Callable[[_Estimate, _Target, _Levels], _Estimate]

#: Arrays for which losses are checked.
_GIVEN = tuple(jax.ShapeDtypeStruct(shape, jnp.float32) for shape in ((2, 3, 5), (2, 3, 1), (5,)))

#: The Huber loss is quadratic up to this error, in cost scales.
_HUBER_BEND = 0.25

#: The logarithmic loss measures absolute errors below this cost, in cost scales, and relative errors above it.
_LOG_BEND = 0.25


def _quantile(estimate: _Estimate, target: _Target, levels: _Levels) -> _Estimate:
    """Quantile loss: each estimate converges to its level of the distribution. At level 1/2 it is `l1`."""
    error = target - estimate
    return 2 * jnp.maximum(levels * error, (levels - 1) * error)


def _l1(estimate: _Estimate, target: _Target, _: _Levels) -> _Estimate:
    """Absolute error: estimates converge to the median."""
    return jnp.abs(target - estimate)


def _l2(estimate: _Estimate, target: _Target, _: _Levels) -> _Estimate:
    """Squared error: estimates converge to the mean."""
    return jnp.square(target - estimate)


def _huber(estimate: _Estimate, target: _Target, _: _Levels) -> _Estimate:
    """Squared for small errors, absolute for large ones."""
    error = jnp.abs(target - estimate)
    small = jnp.minimum(error, _HUBER_BEND)
    return small * (error - 0.5 * small) / _HUBER_BEND


def _log(estimate: _Estimate, target: _Target, _: _Levels) -> _Estimate:
    """Absolute error of the inverse hyperbolic sine: a relative error that is defined for all values."""
    return jnp.abs(jnp.arcsinh(target / _LOG_BEND) - jnp.arcsinh(estimate / _LOG_BEND)) * _LOG_BEND


#: Losses by name.
LOSSES: Mapping[str, Loss] = MappingProxyType(
    {"quantile": _quantile, "l1": _l1, "l2": _l2, "huber": _huber, "log": _log}
)


def named_loss(name: str) -> Loss:
    """A loss by name, one of `LOSSES` or `package.module:Name`.

    Raises:
      InputError: the name is unknown, or the loss cannot be called or is not one number for each estimate.
    """
    return LOSSES[name] if name in LOSSES else checked_loss(name, own_part("loss", name, LOSSES))


def checked_loss(name: str, loss: Any) -> Loss:
    """A loss of the user's own.

    Raises:
      InputError: it cannot be called or is not one number for each estimate.
    """
    given = f"arrays of shapes {short(tuple(one.shape for one in _GIVEN))}"
    remedy = "give a function of estimate, target and levels that returns one number for each estimate"
    try:
        answer = jax.eval_shape(loss, *_GIVEN)
    except Exception as error:  # whatever the user's function raises
        raise InputError(
            f"loss {name!r}: cannot be called with {given} ({type(error).__name__}: {error}); {remedy}"
        ) from error
    found = jax.tree.map(lambda leaf: leaf.shape, answer)
    if found != _GIVEN[0].shape:
        raise InputError(f"loss {name!r}: answers with shape {short(found)} for {given}; {remedy}")
    return loss


@functools.cache
def loss_sha256(loss: Loss) -> str:
    """A digest of what a loss and its gradient compute, however the code is written."""
    both = jax.value_and_grad(lambda *given: jnp.sum(loss(*given)), argnums=(0, 1, 2))
    traced = jax.make_jaxpr(both)(*_GIVEN)
    text = re.sub(" at 0x[0-9a-f]+", "", str(traced))  # where functions are in memory
    return hashlib.sha256(f"{text} {arrays_sha256(traced.consts)}".encode()).hexdigest()


def parse_losses(text: str) -> tuple[tuple[str, float], ...]:
    """Parse losses and their weights from text such as `l1`, `quantile=1,log=0.5` or `package.module:Name`.

    Raises:
      InputError: a loss is unknown or given twice, or a weight is not a number above 0.
    """
    losses = []
    for part in text.split(","):
        name, weighted, weight = (piece.strip() for piece in part.partition("="))
        try:
            value = float(weight) if weighted else 1.0
        except ValueError:
            value = -1.0
        named_loss(name)
        if not 0 < np.float32(value) < np.inf:
            raise InputError(
                f"loss {text!r}: the weight of {name} is {weight!r}; give a number above 0 that single precision holds"
            )
        losses.append((name, value))
    if len(dict(losses)) < len(losses):
        raise InputError(f"loss {text!r}: names a loss twice; give each once")
    return tuple(losses)


def losses_as_text(losses: Sequence[tuple[str, float]]) -> str:
    """Losses that have a weight, with weights other than 1, for people."""
    return " + ".join(name if weight == 1 else f"{weight!r} {name}" for name, weight in losses if weight)


def map_loss(
    loss: Loss,
    estimate: Float[Array, "h w quantiles"],
    target: Float[Array, "h w"],
    weight: Float[Array, "h w"],
    levels: Float[Array, "quantiles"],
) -> Float[Array, ""]:
    """Weighted mean of a loss over the cells of one map and the quantiles; 0 if all weights are 0.

    Args:
      loss: loss of a cell.
      estimate: quantiles of the cost-to-go.
      target: exact cost-to-go in the same unit; may be infinite for cells of weight 0.
      weight: weight of each cell.
      levels: levels of the quantiles.
    """
    finite = jnp.where(weight > 0, target, 0.0)[..., None]
    of_cell = jnp.mean(loss(estimate, finite, levels), axis=-1)
    return jnp.sum(of_cell * weight) / jnp.maximum(jnp.sum(weight), 1e-6)
