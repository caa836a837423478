"""The gridworld as pure functions of arrays, batch axes last: terrain, poses, sets of cells, search and sensing."""

from dc2g_jax._src.grid import bitboard as bitboard, gridworld as gridworld, poses as poses, search as search
from dc2g_jax._src.grid.fast_marching import geodesic_distance as geodesic_distance
from dc2g_jax._src.grid.gridworld import (
    Belief as Belief,
    belief_from_map as belief_from_map,
    reset as reset,
    step as step,
)
from dc2g_jax._src.grid.map_frame import MapFrame as MapFrame
from dc2g_jax._src.grid.poses import (
    ACTION_LETTERS as ACTION_LETTERS,
    FORWARD_ACTION as FORWARD_ACTION,
    Pose as Pose,
    make_pose as make_pose,
)
from dc2g_jax._src.grid.sampling import sample_grid as sample_grid
from dc2g_jax._src.grid.sensing import expanding_kernel as expanding_kernel, field_of_view as field_of_view
from dc2g_jax._src.grid.terrain import (
    CLASS_NAMES as CLASS_NAMES,
    DRIVEWAY as DRIVEWAY,
    FRONT_DOOR as FRONT_DOOR,
    HOUSE as HOUSE,
    PATH as PATH,
    ROAD as ROAD,
    SIDEWALK as SIDEWALK,
    TRAVERSABLE as TRAVERSABLE,
    UNKNOWN as UNKNOWN,
)
from dc2g_jax._src.grid.world import World as World
