"""Your own maps from the command line: looked at, and driven on."""

import csv
import re

import cv2
import numpy as np
import pytest

from dc2g_jax._src.cli.commands import draw_episodes, run_episodes
from dc2g_jax._src.cli.commands.check_map import Options, main
from dc2g_jax._src.files.class_images import write_class_image
from dc2g_jax._src.grid.terrain import CLASS_COLORS, CLASS_NAMES, FRONT_DOOR, GRASS, ROAD
from dc2g_jax._src.runtime.errors import InputError
from tests.support.maps import drawn
from tests.support.occupancy import save
from tests.support.refusals import refusal

PALETTE = "class,r,g,b\n" + "".join(
    f"{name},{r},{g},{b}\n" for name, (r, g, b) in zip(CLASS_NAMES, CLASS_COLORS, strict=True)
)
CAMPUS = drawn("""
    ....##D##......R.
    ....##P##..##D##.
    RRRRRRRRR..#####.
    RRRRRRRRR......tt
    ..P..............
    ..d........RRR...
""")


def test_check_map_reports_and_draws(tmp_path, capsys):
    colors = np.array(CLASS_COLORS, np.uint8)
    colors[ROAD] = (255, 0, 200)
    road = "road,{},{},{}"
    (tmp_path / "palette.csv").write_text(PALETTE.replace(road.format(*CLASS_COLORS[ROAD]), road.format(255, 0, 200)))
    cv2.imwrite(str(tmp_path / "campus.png"), colors[CAMPUS][..., ::-1])
    main(Options(tmp_path / "campus.png", tmp_path / "palette.csv", goals=((2, 5),), out=tmp_path / "out"))
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "campus.png: 17 x 6 cells"
    assert "        22 road (traversable)" in lines
    assert "         2 tree" in lines
    assert "goal cells: 1 at (6, 0), 1 at (13, 1), 1 at (2, 5)" in lines
    assert "traversable cells: 27, of which 85.2 % lead to a goal, 5 cells away at most" in lines
    assert "warning: traversable cells that lead to no goal: 3 around (12, 5), 1 at (15, 0)" in lines
    assert "warning: goal cells that touch no other traversable ground: 1 at (13, 1)" in lines
    # The panels of so wide a map lie below each other.
    picture = cv2.imread(str(tmp_path / "out" / "campus.png"))
    height, width, _ = picture.shape
    assert height > width
    # Classes have the palette's colors.
    assert np.sum(np.all(picture[..., ::-1] == (255, 0, 200), axis=-1)) > 1000
    assert (tmp_path / "out" / "campus.svg").read_text().count("<image") >= 3


def test_a_map_of_no_use_is_drawn_and_then_refused(tmp_path, capsys):
    np.save(tmp_path / "campus.npy", np.where(CAMPUS == FRONT_DOOR, GRASS, CAMPUS))
    with pytest.raises(InputError, match=r"campus\.npy: it has no front door; .* give a goal"):
        main(Options(tmp_path / "campus.npy", out=tmp_path / "out"))
    assert "goal cells: none" in capsys.readouterr().out
    assert (tmp_path / "out" / "campus.png").stat().st_size > 0


def test_what_cannot_be_read_is_not_drawn(tmp_path):
    (tmp_path / "palette.csv").write_text(PALETTE.replace("tree,64,128,0", "tree,64,128,9"))
    write_class_image(tmp_path / "campus.png", CAMPUS)
    options = Options(tmp_path / "campus.png", tmp_path / "palette.csv", out=tmp_path / "out")
    with pytest.raises(InputError, match=re.escape("(64, 128, 0) at x=15, y=3 and 1 more (nearest: 'tree'")):
        main(options)
    assert not (tmp_path / "out").exists()


def test_unknown_ground_that_counts_as_free_is_warned_of(tmp_path, capsys):
    grays = np.full((30, 20), 205, np.uint8)
    grays[10:20] = 254
    path = save(tmp_path, grays, free_thresh=0.25)
    main(Options(path, goals=((0.21, 0.74),), goal_unit="meters", out=tmp_path / "out"))
    printed = capsys.readouterr().out
    assert "traversable (" not in printed
    assert "goal cells: 1 at (4, 15)" in printed
    assert "warning: 400 pixels are gray 205" in printed


def test_episodes_are_run_on_a_folder_of_maps(tmp_path):
    maps = tmp_path / "maps"
    maps.mkdir()
    np.save(maps / "campus.npy", CAMPUS)
    save(maps, np.full((6, 17), 254, np.uint8))
    (maps / "goals.csv").write_text("map,x,y,unit\nlab,16,0,cells\n")
    (tmp_path / "starts.csv").write_text("house,x,y,heading\ncampus,0,3,0\nlab,0,5,3\n")
    starts, out = tmp_path / "starts.csv", tmp_path / "out"
    run_episodes.main(run_episodes.Options(starts=starts, planner=("frontier",), dataset=str(maps), out=out))
    with (out / "episodes.csv").open() as file:
        rows = list(csv.DictReader(file))
    # Five rows up, a turn, and sixteen columns to the right.
    assert [(row["house"], row["success"], row["oracle_steps"]) for row in rows] == [
        ("campus", "1", "10"), ("lab", "1", "22"),
    ]  # fmt: skip


def test_means_leave_out_starts_without_a_door_in_reach(tmp_path, capsys):
    (tmp_path / "maps").mkdir()
    np.save(tmp_path / "maps" / "campus.npy", CAMPUS)
    np.save(tmp_path / "maps" / "closed.npy", np.where(CAMPUS == FRONT_DOOR, GRASS, CAMPUS))
    table, rows = tmp_path / "starts.csv", ["house,x,y,heading", "closed,0,3,0", "campus,0,3,0"]

    def printed(*lines: str, out: str) -> list[str]:
        table.write_text("\n".join([*rows[:1], *lines]))
        options = {"starts": table, "dataset": str(tmp_path / "maps"), "out": tmp_path / out}
        run_episodes.main(run_episodes.Options(planner=("oracle", "frontier"), **options))
        return capsys.readouterr().out.splitlines()

    both, alone = printed(*rows[1:], out="both"), printed(rows[2], out="alone")
    assert both[1:4] == alone[1:4]
    with (tmp_path / "both" / "episodes.csv").open() as file:
        oracle, _, explored, _ = csv.DictReader(file)
    assert [explored[name] for name in ("success", "oracle_steps", "extra", "mode")] == ["0", "", "", "gave_up"]
    assert (oracle["steps"], oracle["oracle_steps"]) == ("0", "")
    assert both[4] == "no door can be reached from 1 of these starts, left out of extra steps and success:"
    assert [line.split() for line in both[6:8]] == [
        ["oracle", "100.0", "0.0"], ["frontier", "100.0", f"{int(explored['steps']):.1f}"],
    ]  # fmt: skip
    closed = printed(rows[1], out="closed")
    assert closed[1:5] == both[4:8]

    def draw(run: str, **options):
        episodes, out = tmp_path / run / "episodes.csv", tmp_path / f"drawn_{run}"
        draw_episodes.main(draw_episodes.Options(episodes=episodes, dataset=str(tmp_path / "maps"), out=out, **options))
        return {path.name for path in out.glob("*.png")}

    paths = "closed-x0-y3-h0-r8.png"
    assert draw("both", house=("closed",)) == {"houses.png", paths}
    refusal(lambda: draw("closed"), "episodes.csv", "a --house")
    assert draw("closed", house=("closed",)) == {paths}
