import json

import numpy as np
import pytest

from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax.robot import map_recording
from dc2g_jax.robot.mapping.sequences import read_sequence
from tests.support.maps import drawn
from tests.support.recordings import read
from tests.support.refusals import refusal

YARD = drawn("""
    ####D#..
    ..#.P...
    ....P...
    .t..P...
    RRRRRRRR
    RRRRRRRR
""")
WRITTEN = {"map.npy", "map.png", "map.svg", "map.pdf", "recording.rrd", "run.json"}


@pytest.fixture(scope="module")
def yards(tmp_path_factory):
    folder = tmp_path_factory.mktemp("yards")
    np.save(folder / "yard.npy", YARD)
    return folder


@pytest.fixture(scope="module")
def simulated(yards, tmp_path_factory):
    """A drive of six steps forward, one turn, and four more to the door."""
    out = tmp_path_factory.mktemp("simulated") / "out"
    map_recording.main(
        map_recording.Options(simulate="yard", dataset=str(yards), start=(0, 4, 0), image_size=(64, 48), out=out)
    )
    return out


def test_the_path_to_the_goal_is_the_shortest():
    path = map_recording.path_to_goal(YARD, make_pose(0, 4, 0))
    assert [(int(pose.x), int(pose.y)) for pose in path] == [
        *((x, 4) for x in range(5)), *((4, y) for y in range(4, -1, -1)),
    ]  # fmt: skip
    assert [int(pose.heading) for pose in path] == [0] * 5 + [3] * 5


def test_a_simulated_drive_is_written_and_mapped(simulated):
    assert {path.name for path in simulated.iterdir()} == WRITTEN | {"sequence"}
    assert json.loads((simulated / "run.json").read_text())["experiment"] == "map_recording"
    sequence = read_sequence(simulated / "sequence")
    places = np.stack([moment.pose.position for moment in sequence.frames])
    # Along the road, a turn on the spot, and up to the door.
    np.testing.assert_allclose(places[:6, 0], [0.5, 1.5, 2.5, 3.5, 4.5, 4.5])
    np.testing.assert_allclose(places[5:, 1], [-4.5, -3.5, -2.5, -1.5, -0.5])
    terrain = np.load(simulated / "map.npy")
    known = terrain > 0
    assert known.mean() > 0.5
    assert (terrain == YARD)[known].mean() > 0.95
    recorded = read(simulated / "recording.rrd")
    cells = recorded["/map", "SegmentationImage:buffer"]
    assert sorted(cells) == list(range(len(places)))
    np.testing.assert_array_equal(np.reshape(cells[len(places) - 1][0], terrain.shape), terrain)


def test_a_recording_is_mapped_wherever_it_was_made(simulated, tmp_path, capsys):
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    for name in ("depth", "classes", "rgb", "depth.txt", "classes.txt", "rgb.txt", "camera.txt"):
        (folder / name).symlink_to(simulated / "sequence" / name)
    lines = [line.split() for line in (simulated / "sequence" / "groundtruth.txt").read_text().splitlines()[1:]]
    for number, words in enumerate(lines):
        words[1:4] = [str(float(word) + shift) for word, shift in zip(words[1:4], (-300, 70, -2.5), strict=True)]
        if number == 3:
            words[3] = "-100"  # under the ground
    (folder / "groundtruth.txt").write_text("\n".join([*map(" ".join, lines[:-1]), ""]))
    out = tmp_path / "out"
    map_recording.main(map_recording.Options(sequence=folder, ground=-2.5, reach=9.0, out=out))
    assert {path.name for path in out.iterdir()} == WRITTEN
    told = capsys.readouterr()
    assert "without class image or pose: 1; frames that were left out: 1" in told.out
    assert "left out" in told.err
    assert "not above the ground" in told.err
    terrain = np.load(out / "map.npy")
    # Cells lie as in the house, 9 m from the western end of the way and from its northern one, which is left out.
    here = terrain[8 : 8 + YARD.shape[0], 9 : 9 + YARD.shape[1]]
    known = here > 0
    assert known.mean() > 0.4
    assert (here == YARD)[known].mean() > 0.95


def test_options_that_do_not_fit_are_refused(yards, tmp_path):
    def run(**options):
        map_recording.main(map_recording.Options(**{"dataset": str(yards), "out": tmp_path / "out"} | options))

    refusal(run, "--sequence", "--simulate")
    refusal(lambda: run(sequence=tmp_path, simulate="yard"), "either")
    refusal(lambda: run(simulate="yarn"), "'yarn'", "yard")
    refusal(lambda: run(sequence=tmp_path / "nowhere"), "nowhere", "no such folder")
    refusal(lambda: run(simulate="yard", start=(0, 4, 0), image_size=(0, 4)), "--image-size 0")
    refusal(lambda: run(simulate="yard", cell_size=-1.0), "--cell-size -1")
    refusal(lambda: run(sequence=tmp_path, reach=np.inf), "--reach inf")
    refusal(lambda: run(sequence=tmp_path, ground=np.nan), "--ground nan")
    assert not (tmp_path / "out").exists()
