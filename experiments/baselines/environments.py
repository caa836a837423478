"""Other gridworlds in JAX, stepped under `jit` and `vmap` at the size of ours: NAVIX and XLand-MiniGrid.

Both run with jax 0.10 (tried: NAVIX 0.7.4 and XLand-MiniGrid 0.9.3 with jax 0.10.2). They are other tasks than ours
(an empty room with a goal, always the same start, no belief kept between steps), so their steps per second say what
order of speed users are used to, not which is the better program. Each is imported when it is asked for; an
`ImportError` says what is missing.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

#: Steps that no environment here reaches, so that none resets itself in the middle.
_ENDLESS = 1_000_000


class Environment(NamedTuple):
    """A batch of environments to be stepped, none of which starts again by itself.

    Attributes:
      reset: `key ->` states of a batch.
      step: `(states, actions int32 [batch]) ->` states; actions 0, 1 and 2 turn and move.
      outcome: `states ->` the arrays of them that have to be computed.
    """

    reset: Callable[[Array], Any]
    step: Callable[[Any, Int[Array, "batch"]], Any]
    outcome: Callable[[Any], Any]


def navix(batch: int, cells: int, observed: bool = True) -> Environment:
    """NAVIX's empty room.

    Its public `step` computes a new start beside every step, for environments whose episode has ended; `_step` leaves
    that out. A picture of the whole room that every state carries is made as small as can be: nobody looks at it.

    Args:
      batch: environments side by side.
      cells: side of the room.
      observed: make the categorical first-person observation; else none at all.
    """
    from navix import observations
    from navix.environments.empty import Room
    from navix.rendering.cache import RenderingCache

    observe = observations.categorical_first_person if observed else observations.none
    room = Room.create(height=cells, width=cells, max_steps=_ENDLESS, observation_fn=observe)
    picture = RenderingCache.init(jnp.zeros((1, 1), jnp.int32))
    return Environment(
        reset=lambda key: jax.vmap(lambda key: room.reset(key, picture))(jax.random.split(key, batch)),
        step=jax.vmap(room._step),
        outcome=lambda now: (now.observation, now.reward, now.step_type, now.state.grid, now.state.entities),
    )


def xland_minigrid(batch: int, cells: int, view: int = 17) -> Environment:
    """XLand-MiniGrid's empty room.

    Args:
      batch: environments side by side.
      cells: side of the room.
      view: side of the square view, in cells; an odd number.
    """
    import xminigrid

    room, parameters = xminigrid.make(
        "MiniGrid-Empty-16x16", height=cells, width=cells, view_size=view, max_steps=_ENDLESS
    )
    return Environment(
        reset=lambda key: jax.vmap(room.reset, in_axes=(None, 0))(parameters, jax.random.split(key, batch)),
        step=lambda states, actions: jax.vmap(room.step, in_axes=(None, 0, 0))(parameters, states, actions),
        outcome=lambda now: (now.observation, now.reward, now.step_type, now.state.grid, now.state.agent),
    )
