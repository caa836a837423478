"""Drives from camera to door on maps drawn by hand."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure

from dc2g_jax._src.estimation.checkpoints import SHIPPED_NOISY_NETWORK, network_in_folder
from dc2g_jax._src.files.resources import resource
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.terrain import FRONT_DOOR, TRAVERSABLE
from dc2g_jax._src.planning.named import planner_with
from dc2g_jax._src.planning.planners import Frontier, Oracle
from dc2g_jax.robot.driving.vehicle import VehicleLimits
from experiments.driving import fleet
from experiments.driving.drive import ARRIVED, reset, step
from experiments.support import drive_figures as figures
from tests.support.drives import EAST, MIDDLE, RULES, SHUT_OUT, SITES, WEST, drives, made
from tests.support.refusals import refusal
from tests.support.streets import STREET


@pytest.fixture(scope="module")
def explored():
    """A robot that explores the street: every moment of its drive."""
    site = jax.tree.map(lambda leaf: leaf[0], SITES)
    robot = made(Frontier(RULES))
    first = reset(jax.random.key(0), (make_pose(9, 2, 2), False), site, robot)
    return list(fleet.moments(first, site, robot, 120.0))


def test_a_robot_with_a_camera_finds_the_door(explored):
    last = explored[-1].robot
    assert last.status == ARRIVED
    assert (last.off_ground, last.touched) == (0, 0)
    column, row = int(last.vehicle.position[0]), int(-last.vehicle.position[1])
    assert STREET[row, column] == FRONT_DOOR


def test_what_it_knows_is_what_is_there(explored):
    last = explored[-1].robot
    known = last.terrain != 0
    assert np.sum(known) > 30
    wrong = known & (last.terrain != STREET) & ~last.missed
    # The cell where it stood before it had looked at it is ground of no particular kind.
    assert np.sum(wrong) <= 1
    assert TRAVERSABLE[last.terrain[2, 9]]
    assert np.any(last.map.log_odds > 0)


def test_without_noise_it_knows_where_it_is(explored):
    for moment in explored[::10]:
        np.testing.assert_allclose(moment.believed.position, moment.robot.vehicle.position)
        np.testing.assert_allclose(moment.believed.yaw, moment.robot.vehicle.yaw, atol=1e-6)


def test_a_vehicle_keeps_its_limits_and_its_time(explored):
    limits = VehicleLimits()
    places = np.array([moment.robot.vehicle.position for moment in explored])
    assert np.max(np.linalg.norm(np.diff(places, axis=0), axis=1)) <= 2 * 0.1 * limits.max_speed + 1e-5
    assert [moment.seconds for moment in explored[:3]] == pytest.approx([0.0, 0.2, 0.4])


def test_the_predicted_cost_to_go_of_each_decision_is_shown(tmp_path, monkeypatch, explored):
    assert explored[0].cost_to_go is None  # frontier exploration predicts nothing
    site = jax.tree.map(lambda leaf: leaf[0], SITES)
    robot = made(planner_with("dc2g", RULES, network_in_folder(resource(SHIPPED_NOISY_NETWORK))))
    first = reset(jax.random.key(0), (make_pose(9, 2, 2), False), site, robot)
    drive = list(fleet.moments(first, site, robot, 4.0))
    for moment in drive:
        estimates = moment.robot.planner_state.estimates
        np.testing.assert_allclose(moment.cost_to_go, np.mean(estimates, axis=(0, 1)), rtol=1e-5)
        predicted = moment.cost_to_go[TRAVERSABLE[moment.robot.terrain]]
        assert np.isfinite(predicted).all()
        assert np.ptp(predicted) > 1
    drawn: list[Figure] = []
    monkeypatch.setattr(figures, "save_figure", lambda figure, path: drawn.append(figure))
    figures.plot_moments(tmp_path / "fig9", drive, rows=2, cell_size=1.0)
    panels = drawn[0].axes[:8]  # a row is camera, map, prediction, and path
    for moment, panel in zip((drive[0], drive[-1]), panels[2::4], strict=True):
        ground = TRAVERSABLE[moment.robot.terrain]
        assert len(np.unique(panel.images[0].get_array()[ground], axis=0)) > 3


def test_houses_that_cannot_be_stacked_are_refused():
    refusal(lambda: fleet.sites_of([STREET, STREET[:, 1:]]), "9 x 8", "10 x 8", "all of one size")
    refusal(lambda: fleet.sites_of([]), "no cells", "at least")


@pytest.mark.slow
def test_a_robot_that_knows_the_map_drives_the_shortest_path():
    # From column 9 along the road to column 2, then down and along the path: 14 m, with a start and three corners.
    done = drives(Oracle(), EAST, WEST, MIDDLE, EAST, knows_map=True, time_limit=60.0)
    assert {one.status for one in done} == {"arrived"}
    assert 14 / 1.5 < done[0].seconds < 20
    assert done[3].seconds == done[0].seconds
    assert not any(one.off_ground for one in done)


@pytest.mark.slow
def test_episodes_do_not_depend_on_each_other_and_end():
    reports: list[int] = []
    options = {"noise": 1.0, "pedestrians": 2}
    together = drives(Frontier(RULES), EAST, SHUT_OUT, WEST, MIDDLE, **options, on_progress=reports.append)
    assert [one.status for one in together] == ["arrived", "nothing_left", "arrived", "arrived"]
    assert not any(one.touched for one in together)
    assert reports[-1] == 4
    others = drives(Frontier(RULES), EAST, MIDDLE, MIDDLE, MIDDLE, **options)
    assert others[0].seconds == together[0].seconds
    assert others[1].seconds != together[1].seconds
    short = drives(Frontier(RULES), EAST, SHUT_OUT, WEST, MIDDLE, **options, time_limit=2.0)
    assert [(one.status, one.seconds) for one in short] == [("under_way", 2.0)] * 4


def test_a_robot_at_its_end_stays_there(explored):
    site = jax.tree.map(lambda leaf: leaf[0], SITES)
    last = jax.tree.map(jnp.asarray, explored[-1].robot)
    again = jax.jit(functools.partial(step, site=site, equipment=made(Frontier(RULES))))(last)
    jax.tree.map(np.testing.assert_array_equal, (again.vehicle, again.periods), (last.vehicle, last.periods))
