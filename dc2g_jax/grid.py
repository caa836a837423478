"""The gridworld as pure functions of arrays, batch axes last: terrain, poses, sets of cells, search and sensing."""

from dc2g_jax._src.grid import (
    bitboard as bitboard,
    gridworld as gridworld,
    poses as poses,
    search as search,
    terrain as terrain,
)
from dc2g_jax._src.grid.bitboard import Board as Board
from dc2g_jax._src.grid.gridworld import (
    Belief as Belief,
    belief_from_map as belief_from_map,
    reset as reset,
    step as step,
)
from dc2g_jax._src.grid.ground import (
    component_numbers as component_numbers,
    connected_to as connected_to,
    connected_to_goal as connected_to_goal,
    largest_piece as largest_piece,
)
from dc2g_jax._src.grid.label_noise import (
    NoiseLevels as NoiseLevels,
    chance as chance,
    mislabeled as mislabeled,
    scaled as scaled,
)
from dc2g_jax._src.grid.loops import until as until
from dc2g_jax._src.grid.map_frame import MapFrame as MapFrame
from dc2g_jax._src.grid.poses import (
    ACTION_LETTERS as ACTION_LETTERS,
    FORWARD as FORWARD,
    FORWARD_ACTION as FORWARD_ACTION,
    HEADINGS as HEADINGS,
    LEFT_ACTION as LEFT_ACTION,
    RIGHT_ACTION as RIGHT_ACTION,
    Pose as Pose,
    PoseSet as PoseSet,
    every_heading as every_heading,
    make_pose as make_pose,
    moved as moved,
    only as only,
)
from dc2g_jax._src.grid.sampling import (
    ClassImage as ClassImage,
    resize_nearest as resize_nearest,
    sample_grid as sample_grid,
)
from dc2g_jax._src.grid.search import FOUR_CONNECTED as FOUR_CONNECTED, first_action as first_action
from dc2g_jax._src.grid.sensing import (
    Kernel as Kernel,
    expanding_kernel as expanding_kernel,
    field_of_view as field_of_view,
)
from dc2g_jax._src.grid.squares import shifted as shifted
from dc2g_jax._src.grid.terrain import (
    BUSH as BUSH,
    CAR as CAR,
    CLASS_BITS as CLASS_BITS,
    CLASS_NAMES as CLASS_NAMES,
    DRIVEWAY as DRIVEWAY,
    FENCE as FENCE,
    FIGURE_COLORS as FIGURE_COLORS,
    FIGURE_RGB as FIGURE_RGB,
    FREE as FREE,
    FRONT_DOOR as FRONT_DOOR,
    GRASS as GRASS,
    HOUSE as HOUSE,
    NOTHING as NOTHING,
    OCCUPIED as OCCUPIED,
    PATH as PATH,
    ROAD as ROAD,
    SIDEWALK as SIDEWALK,
    TRAVERSABLE as TRAVERSABLE,
    TREE as TREE,
    UNKNOWN as UNKNOWN,
)
from dc2g_jax._src.grid.world import World as World
