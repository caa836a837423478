"""Drives of a simulated camera."""

from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax.robot.mapping.simulated_drives import path_to_goal
from tests.support.maps import drawn

YARD = drawn("""
    ####D#..
    ..#.P...
    ....P...
    .t..P...
    RRRRRRRR
    RRRRRRRR
""")


def test_the_path_to_the_goal_is_the_shortest():
    path = path_to_goal(YARD, make_pose(0, 4, 0))
    assert [(int(pose.x), int(pose.y)) for pose in path] == [
        *((x, 4) for x in range(5)), *((4, y) for y in range(4, -1, -1)),
    ]  # fmt: skip
    assert [int(pose.heading) for pose in path] == [0] * 5 + [3] * 5
