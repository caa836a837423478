"""What the page of `dc2g demo` shows, without the page."""

import base64
import dataclasses
import io

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.colors import to_rgb
from PIL import Image

from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.figures.costs import COST_COLORS
from dc2g_jax._src.files.class_images import write_class_image
from dc2g_jax._src.grid.terrain import CLASS_NAMES, FIGURE_COLORS, FRONT_DOOR, GRASS, ROAD, TRAVERSABLE
from dc2g_jax._src.planning.decisions import RobotPose
from dc2g_jax._src.planning.learned_score import TERMS
from dc2g_jax._src.planning.named import make_planner
from dc2g_jax._src.planning.online import OnlinePlanner
from dc2g_jax._src.planning.rules import complete_rules
from dc2g_jax.demo.robots import Demo, Walk, cost_picture, map_picture, open_dropped, open_maps, walk_marks
from tests.oracles import learned_score_oracle, numpy_gridworld as oracle
from tests.support.networks import random_network
from tests.support.refusals import refusal
from tests.support.toy import HOUSE

START = RobotPose(9, 6, 0)
SENSING = 3

#: Weights of the score of the network.
SCORE = dict(zip(TERMS, np.linspace(-2, 2, len(TERMS), dtype=np.float32), strict=True))


def pixels(url: str) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(url.partition("base64,")[2]))))


def colored(name: str) -> list[int]:
    return [round(255 * part) for part in to_rgb(FIGURE_COLORS[name])]


@pytest.fixture
def demo() -> Demo:
    network = dataclasses.replace(random_network(Architecture(widths=(4, 4, 4, 4))), score={"90": SCORE})
    return Demo({"toy": HOUSE.terrain}, ["frontier"], network)


def walked(name: str) -> Walk:
    walk = Walk(make_planner(name, sensing_range=SENSING), HOUSE.terrain, START, complete_rules(SENSING))
    while not walk.over:
        walk.step()
    walk.step()  # nothing happens after the end
    return walk


@pytest.fixture(scope="module")
def frontier() -> Walk:
    return walked("frontier")


def test_a_walk_is_the_episode_of_the_plain_implementation(frontier):
    success, actions, _ = oracle.run_episode(
        HOUSE.terrain, START, "frontier", rules="complete", sensing_radius=SENSING, expanding_radius=SENSING,
        max_steps=99,
    )  # fmt: skip
    assert success
    assert [snapshot.decision.action for snapshot in frontier.snapshots] == [*actions, None]
    assert frontier.summary(0) == "step 0: +0 % beyond the oracle (14)"
    extra = 100 * (len(actions) - 14) / 14
    assert frontier.summary(len(actions)) == (
        f"reached the door in {len(actions)} steps: {extra:+.0f} % beyond the oracle (14)"
    )


def test_decisions_are_those_of_the_planner_on_a_robot(frontier):
    robot = OnlinePlanner("frontier", sensing_range=SENSING, largest=HOUSE.terrain.shape)
    for snapshot in frontier.snapshots:
        decision = robot.plan(np.where(snapshot.seen, HOUSE.terrain, 0).astype(np.uint8), snapshot.pose)
        assert (decision, decision.why) == (snapshot.decision, snapshot.decision.why)


def test_pictures_have_a_pixel_for_each_cell(frontier):
    snapshot = frontier.snapshots[0]
    assert frontier.snapshots[0].cost_to_go is None
    assert cost_picture(frontier, HOUSE.terrain, snapshot) == map_picture(HOUSE.terrain, snapshot.seen)
    shown, whole = pixels(map_picture(HOUSE.terrain, snapshot.seen)), pixels(map_picture(HOUSE.terrain))
    assert shown.shape == (*HOUSE.terrain.shape, 3)
    np.testing.assert_array_equal(np.all(shown == whole, axis=-1), snapshot.seen)
    assert whole[6, 9].tolist() == colored("road")


def test_costs_lead_to_the_door_along_the_colors():
    walk = walked("true_cost_to_go")
    assert walk.summary(14) == "reached the door in 14 steps: +0 % beyond the oracle (14)"
    snapshot = walk.snapshots[5]
    ground = snapshot.seen & TRAVERSABLE[HOUSE.terrain]
    shown = pixels(cost_picture(walk, HOUSE.terrain, snapshot))
    assert np.all(shown[~snapshot.seen] == 255)
    colors = colormaps[COST_COLORS](snapshot.cost_to_go[ground] / max(HOUSE.terrain.shape))
    np.testing.assert_allclose(shown[ground], 255 * colors[:, :3], atol=0.51)
    assert snapshot.cost_to_go[0, 4] == 0


def test_marks_tell_of_each_candidate(frontier):
    svg = walk_marks(frontier, HOUSE.terrain, 0, SENSING)
    candidates = frontier.snapshots[0].decision.candidates
    assert svg.count("<circle") == len(candidates) > 0
    assert f"<title>score {candidates[0].score:.1f}: {candidates[0].distance} actions away</title>" in svg
    assert "<circle" not in walk_marks(frontier, HOUSE.terrain, len(frontier.snapshots) - 1, SENSING)


@pytest.mark.parametrize(
    ("degrees", "arc"),
    [(90, "0 0 1 2.47 2.47Z"), (180, "0 0 1 0.00 3.50Z"), (270, "0 1 1 -2.47 2.47Z"), (360, "0 0 1 -3.5 0Z")],
)
def test_the_field_of_view_is_drawn_as_wide_as_it_is(frontier, degrees, arc):
    assert f"A3.5 3.5 {arc}" in walk_marks(frontier, HOUSE.terrain, 0, 3, degrees)


def test_a_robot_that_sees_all_around(demo):
    demo.planners, demo.sensing_range, demo.field_of_view = ["frontier"], 4, 360
    demo.begin()
    demo.step()
    wanted = oracle.visible(demo.start, 4, HOUSE.terrain.shape, 360)
    np.testing.assert_array_equal(demo.walks["frontier"].snapshots[0].seen, wanted)


def test_weights_and_range_are_the_planner_s(demo):
    demo.planners, demo.start, demo.sensing_range = ["dc2g"], START._replace(heading=2), 5
    assert (demo.distance_weight, demo.gain_weight) == (SCORE["actions"], -SCORE["gain"])
    demo.distance_weight, demo.gain_weight = 1.5, 4.0
    demo.begin()
    demo.step()
    snapshot = demo.walks["dc2g"].snapshots[0]
    assert np.hypot(*(np.argwhere(snapshot.seen) - START[1::-1]).T).max() <= 5 < 6
    grid = np.where(snapshot.seen, HOUSE.terrain, 0)
    reached = oracle.reachable(TRAVERSABLE[grid], *START[:2])
    revealing = oracle.frontier_expanding_complete(snapshot.seen, reached, demo.start, 5)
    wanted = learned_score_oracle.candidates(
        grid, demo.start, revealing, None, snapshot.cost_to_go, SCORE | {"actions": 1.5, "gain": -4.0}, 5
    )
    assert len(wanted) > 1
    scores = {candidate[:3]: candidate.score for candidate in snapshot.decision.candidates}
    assert scores == pytest.approx({candidate.pose: candidate.score for candidate in wanted}, rel=1e-4)


def test_no_weight_is_added_to_algorithm_2(demo):
    demo.planners = ["dc2g_paper"]
    demo.distance_weight, demo.gain_weight = 1.5, 4.0
    demo.begin()
    demo.step()
    for candidate in demo.walks["dc2g_paper"].snapshots[0].decision.candidates:
        assert candidate.score == candidate.cost_to_go


def test_painting_and_placing(demo):
    before = demo.terrain.copy()
    demo.paint((1, 2), (3, 2), "road", 1)
    assert np.argwhere(demo.terrain != before).tolist() == [[2, x] for x in (1, 2, 3) if before[2, x] != ROAD]
    demo.paint((9, 0), (9, 0), "front_door", 3)  # partly off the map
    assert np.argwhere(demo.terrain == FRONT_DOOR).tolist()[-4:] == [[0, 8], [0, 9], [1, 8], [1, 9]]
    np.testing.assert_array_equal(HOUSE.terrain, before)  # the chosen map stays as it was
    demo.place(5, 5)
    assert demo.start[:2] == (5, 5)
    heading = demo.start.heading
    demo.place(5, 5)
    assert demo.start == (5, 5, (heading + 1) % 4)
    demo.choose("toy")
    np.testing.assert_array_equal(demo.terrain, before)


def test_what_cannot_begin(demo):
    demo.blank()
    assert set(np.unique(demo.terrain)) == {GRASS, ROAD}
    demo.begin()
    assert list(demo.walks) == ["frontier"]
    demo.place(0, 0)
    refusal(demo.begin, "(0, 0)", "'grass'", "place the robot elsewhere")
    demo.choose("toy")
    demo.planners = []
    refusal(demo.begin, "no planner")
    demo.planners = ["nobody.knows:It"]
    refusal(demo.begin, "nobody.knows:It")
    demo.planners = ["dc2g_jax._src.planning.planners:Frontier"]
    demo.begin()
    assert list(demo.walks) == demo.planners


def test_maps_of_a_visitor(tmp_path):
    for split in ("train", "val", "test"):
        (tmp_path / "houses" / split).mkdir(parents=True)
        np.save(tmp_path / "houses" / split / f"{split}_house.npy", HOUSE.terrain)
    assert list(open_maps(str(tmp_path / "houses"))) == ["val_house"]
    np.save(tmp_path / "mine.npy", HOUSE.terrain)
    ((name, terrain),) = open_maps(str(tmp_path / "mine.npy")).items()
    assert name == "mine"
    np.testing.assert_array_equal(terrain, HOUSE.terrain)
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(tmp_path / "mine.png")
    refusal(lambda: open_maps(str(tmp_path / "mine.png")), "mine.png", "labels_colors.csv")
    (tmp_path / "labels_colors.csv").write_text("class,r,g,b\nroad,0,0,0\n")
    assert np.all(open_maps(str(tmp_path / "mine.png"))["mine"] == CLASS_NAMES.index("road"))
    refusal(lambda: open_maps(str(tmp_path / "nothing")), "nothing")


def test_what_was_painted_can_be_undone_and_travels_in_a_link(demo):
    before = demo.terrain.copy()
    demo.keep()
    demo.fill((4, 3), (2, 1), "road")
    filled = demo.terrain.copy()
    changed = np.argwhere(filled != before)
    assert {tuple(cell) for cell in changed.tolist()} <= {(y, x) for y in (1, 2, 3) for x in (2, 3, 4)}
    assert np.all(filled[1:4, 2:5] == CLASS_NAMES.index("road"))
    demo.place(1, 6)
    link, start = demo.link, demo.start
    demo.undo()
    demo.undo()  # nothing more
    np.testing.assert_array_equal(demo.terrain, before)
    demo.follow(link)
    np.testing.assert_array_equal(demo.terrain, filled)
    assert demo.start == start
    for broken in ("", "x", link[:-8], "a" + link[1:], "é"):
        refusal(lambda broken=broken: demo.follow(broken), "holds no map")


def test_maps_are_dropped_as_arrays_or_pictures(tmp_path):
    file = io.BytesIO()
    np.save(file, HOUSE.terrain)
    np.testing.assert_array_equal(open_dropped("a.npy", file.getvalue())["a"], HOUSE.terrain)
    write_class_image(tmp_path / "b.png", HOUSE.terrain)
    np.testing.assert_array_equal(open_dropped("b.png", (tmp_path / "b.png").read_bytes())["b"], HOUSE.terrain)
    refusal(lambda: open_dropped("c.txt", b""), "c.txt", "drop a .npy or .png")
    assert "/tmp" not in refusal(lambda: open_dropped("../d.npy", b"no array"), "d.npy")
