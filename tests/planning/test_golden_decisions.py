"""Decisions with all candidates and scores are those of the file, one a line, so that a change of any shows in a diff.

`python -m tests.planning.test_golden_decisions` writes the file anew. Commit it with the change, and say why decisions
change.
"""

import functools
import json
from typing import Any

import numpy as np
import pytest

import dc2g_jax as dc2g
from dc2g_jax._src.figures.replay import Frames, replay
from dc2g_jax._src.grid.poses import ACTION_LETTERS
from dc2g_jax._src.grid.terrain import FRONT_DOOR, ROAD
from dc2g_jax._src.planning.planners import MODE_NAMES
from dc2g_jax.families.procedural import PROCEDURAL_SPLIT
from tests.oracles import numpy_gridworld as oracle
from tests.support.places import ROOT

FILE = ROOT / "tests" / "planning" / "golden_decisions.json"

#: Planners and the rules that each goes by.
PLANNERS = (("frontier", "paper"), ("frontier", "reference"), ("true_cost_to_go", "paper"), ("dc2g", "paper"))

#: Four houses to validate on, and a training house of another style.
HOUSES = (*(name for name, split, _ in PROCEDURAL_SPLIT if split == "val"), "p000m000h000")

#: Decisions in each house.
MOMENTS = 10

#: Actions before a robot turns to the door.
ASTRAY = 50

#: Largest difference of two scores that count as equal; the file has two digits.
ROUNDING = 0.02

Decision = dict[str, Any]


@functools.cache
def walk(house: str) -> tuple[oracle.Pose, np.ndarray]:
    """First pose and actions of a robot that goes from place to place on the road, and at last to a door.

    No planner decides them, so a planner that changes does not change what is observed.
    """
    terrain = dc2g.open_dataset("procedural").house(house).terrain
    rng = np.random.default_rng(HOUSES.index(house))
    free = np.isin(terrain, oracle.TRAVERSABLE_CLASSES)
    y, x = np.nonzero(terrain == ROAD)
    places = ((int(x[i]), int(y[i]), int(rng.integers(4))) for i in rng.permutation(len(x)))
    start = pose = next(places)
    actions: list[int] = []
    while terrain[pose[1], pose[0]] != FRONT_DOOR:
        targets = np.broadcast_to(terrain == FRONT_DOOR, (4, *terrain.shape)).copy()
        if len(actions) < ASTRAY:
            place = next(places)
            targets[:] = False
            targets[place[2], place[1], place[0]] = True
        for action in oracle.shortest_actions(free, pose, targets) or ():
            pose = oracle.moved(pose, action, terrain.shape)
            actions.append(action)
    return start, np.array(actions, np.int8)


def decision(frames: Frames, moment: int) -> Decision:
    """One decision: its plan, and the score of every cell that it was chosen from."""
    heading, y, x = np.nonzero(frames.subgoals[moment])
    rows, columns = np.nonzero(~np.isnan(frames.score[moment]))
    scores = frames.score[moment][rows, columns].astype(float).round(2)
    return {
        "moment": moment,
        "pose": [int(part[moment]) for part in (frames.pose.x, frames.pose.y, frames.pose.heading)],
        "mode": MODE_NAMES[frames.mode[moment]],
        "action": ACTION_LETTERS[frames.action[moment]],
        "length": int(frames.length[moment]),
        "subgoals": np.stack([x, y, heading], axis=1).tolist(),
        "scores": [list(row) for row in zip(columns.tolist(), rows.tolist(), scores.tolist(), strict=True)],
    }


def decisions(name: str, settings: str) -> list[Decision]:
    """The decisions of one planner in all houses."""
    planner, rules = dc2g.make_planner(name, settings=settings), dc2g.SETTINGS[settings].rules()
    made = []
    for house in HOUSES:
        start, actions = walk(house)
        world = dc2g.World.from_terrain(dc2g.open_dataset("procedural").house(house).terrain)
        frames = replay(world, dc2g.make_pose(*start), actions, planner=planner, rules=rules)
        moments = np.linspace(0, len(actions) - 1, MOMENTS).astype(int).tolist()
        head = {"planner": name, "rules": settings, "house": house}
        made += [head | decision(frames, moment) for moment in moments]
    return made


def write() -> None:
    """Write the file anew."""
    lines = [json.dumps(one, separators=(",", ":")) for planner in PLANNERS for one in decisions(*planner)]
    FILE.write_text("[\n" + ",\n".join(lines) + "\n]\n")


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("frontier", "paper"),
        ("dc2g", "paper"),
        *(pytest.param(*planner, marks=pytest.mark.slow) for planner in PLANNERS[1:3]),
    ],
)
def test_decisions_are_those_of_the_file(name, settings):
    expected = [one for one in json.loads(FILE.read_text()) if (one["planner"], one["rules"]) == (name, settings)]
    made = decisions(name, settings)
    assert len(made) == len(expected)
    for one, other in zip(made, expected, strict=True):
        scores, wanted = (np.array(these.pop("scores")).reshape(-1, 3) for these in (one, other))
        assert one == other
        np.testing.assert_array_equal(scores[:, :2], wanted[:, :2], err_msg=str(one))
        np.testing.assert_allclose(scores[:, 2], wanted[:, 2], rtol=0, atol=ROUNDING, err_msg=str(one))


def test_the_file_holds_decisions_of_all_kinds():
    recorded = json.loads(FILE.read_text())
    assert len(recorded) == len(PLANNERS) * len(HOUSES) * MOMENTS
    explored = [one for one in recorded if one["mode"] == "explore"]
    assert len(explored) >= len(recorded) / 2
    assert all(one["scores"] and one["subgoals"] for one in explored)
    assert {one["mode"] for one in recorded} >= {"explore", "to_goal"}


if __name__ == "__main__":
    write()
