"""The commands that look at one start, and those that draw what has been run."""

import csv
import dataclasses
import json
import sys

import cv2
import numpy as np
import pytest

from dc2g_jax._src.cli import commands, one_start
from dc2g_jax._src.cli.commands import draw_dataset, draw_episodes, explore_map
from dc2g_jax._src.files.class_images import write_class_image
from dc2g_jax._src.files.rows import read_rows
from dc2g_jax._src.grid.terrain import CLASS_COLORS, CLASS_NAMES, FRONT_DOOR, GRASS
from dc2g_jax._src.readers.houses import map_dataset
from dc2g_jax._src.rollouts.results import EpisodeResult
from experiments import reproduce_fig8
from tests.support import toy
from tests.support.commands import run
from tests.support.maps import drawn
from tests.support.refusals import refusal


def figure(name: str) -> set[str]:
    """The files of a figure."""
    return {f"{name}.png", f"{name}.svg", f"{name}.pdf"}


YARD = drawn("""
    ####D#
    ..#.P.
    ..##P.
    .t..P.
    SSSSSS
    RRRRRR
    RRRRRR
""")


@pytest.fixture
def yard(tmp_path):
    path = tmp_path / "yard.npy"
    np.save(path, YARD)
    return path


@pytest.fixture
def streets(tmp_path):
    """A folder of three maps of one size: streets from the start of which the door is ever further."""
    folder = tmp_path / "streets"
    folder.mkdir()
    for name, x in (("far", 11), ("middle", 7), ("near", 3)):
        street = drawn("\n".join(["." * 12, "R" + "." * 11]))
        street[1, : x + 1] = street[1, 0]
        street[0, x] = FRONT_DOOR
        street[1, 1 : x + 1] = CLASS_NAMES.index("path")
        np.save(folder / f"{name}.npy", street)
    return folder


@pytest.mark.slow
def test_a_newcomer_sends_planners_over_a_map(compact_network, tmp_path):
    write_class_image(tmp_path / "yard.png", YARD)
    rows = [f"{name},{r},{g},{b}\n" for name, (r, g, b) in zip(CLASS_NAMES, CLASS_COLORS, strict=True)]
    (tmp_path / "palette.csv").write_text("class,r,g,b\n" + "".join(rows))
    out = tmp_path / "out"
    result = run(
        "dc2g map explore", tmp_path / "yard.png", "--palette", tmp_path / "palette.csv", "--start", 0, 6, 0,
        "--planner", "dc2g", "frontier", "oracle", "--network", compact_network, "--sensing-range", 3, "--out", out,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    lines = result.stdout.splitlines()
    assert lines[0] == "yard: 6 x 7 cells, 3-cell sensing, start at column 0, row 6, heading right"
    # Four columns to the right, a turn, six rows up.
    assert lines[2].split() == ["oracle", "11", "knows", "the", "map", "reached", "the", "goal"]
    with (out / "episodes.csv").open() as file:
        episodes = {row["planner"]: row for row in csv.DictReader(file)}
    assert list(episodes) == ["oracle", "dc2g", "frontier"]
    for line in lines[3:5]:
        planner, steps, extra, _, *outcome = line.split()
        assert steps == episodes[planner]["steps"]
        assert float(extra) == pytest.approx(100 * (int(steps) - 11) / 11, abs=0.05)
        assert " ".join(outcome) == "reached the goal"
    written = {*figure("episode"), "episode.gif", "episode.rrd", *figure("trajectories")}
    assert {path.name for path in out.iterdir()} == written | {"episodes.csv", "run.json"}
    assert all(path.stat().st_size > 0 for path in out.iterdir())
    assert f"rerun {out / 'episode.rrd'}" in result.stdout
    assert "--seed" not in result.stdout  # the start is given
    # The oracle, which was asked for, is drawn as well: rows of DC2G, of its estimate, of the frontier, of the oracle.
    assert cv2.imread(str(out / "episode.png")).shape[0] > 4 * 300


def test_what_cannot_be_run_is_refused_before_anything_is_written(yard, tmp_path):
    out = tmp_path / "out"

    def explore(**changes):
        explore_map.main(explore_map.Options(**{"map": yard, "out": out} | changes))

    wall = "column 0, row 0 is 'house', which is not traversable; the nearest cell to start from"
    refusal(lambda: explore(start=(0, 0, 0)), wall)
    refusal(lambda: explore(sensing_range=0), "sensing range 0", "1 to 64")
    refusal(lambda: explore(field_of_view=400.0), "field of view 400", "1 to 360")
    np.save(yard, np.full_like(YARD, GRASS))
    refusal(explore, "yard.npy", "no traversable ground")
    refusal(lambda: explore(start=(0, 0, 0)), "yard.npy: --start 0 0 0", "no traversable ground")
    assert not out.exists()


@pytest.mark.parametrize(
    ("row", "start", "reason"),
    [
        (0, None, "in yard: it has no front door"),
        (1, None, "in yard: no front door can be reached, none touches other traversable ground"),
        (2, (0, 6, 2), "the nearest cell to start from lies at column 4, row 1"),
    ],
)
def test_a_robot_without_a_door_in_reach_explores_and_gives_up(yard, tmp_path, capsys, row, start, reason):
    closed, out = YARD.copy(), tmp_path / "out"
    closed[row, 4] = GRASS
    np.save(yard, closed)
    explore_map.main(explore_map.Options(yard, start=start, planner=("frontier",), sensing_range=3, out=out))
    _, _, oracle, frontier, why, *_ = capsys.readouterr().out.splitlines()
    outcome = ["gave", "up:", "no", "door", "can", "be", "reached", "from", "this", "start"]
    episodes = read_rows(out / "episodes.csv", EpisodeResult)
    assert oracle.split() == ["oracle", "0", "knows", "the", "map", *outcome]
    assert frontier.split() == ["frontier", str(episodes[1].steps), *outcome]
    assert why.startswith("no goal can be reached from column")
    assert why.endswith(reason)
    assert [one[7:12] for one in episodes] == [
        (False, steps, None, None, "gave_up") for steps in (0, len(episodes[1].actions))
    ]
    assert episodes[1].steps > 5
    written = {*figure("episode"), "episode.gif", "episode.rrd", *figure("trajectories")}
    assert written <= {path.name for path in out.iterdir()}


def test_a_step_limit_that_not_even_the_oracle_keeps_is_refused(yard, tmp_path):
    options = explore_map.Options(yard, start=(0, 6, 0), planner=("frontier",), step_limit=10, out=tmp_path / "out")
    refusal(lambda: explore_map.main(options), "within 10 actions", "larger step limit")
    none = explore_map.Options(yard, start=(0, 6, 0), planner=("frontier",), step_limit=0, out=tmp_path / "none")
    refusal(lambda: explore_map.main(none), "step limit 0", "at least 1", "--step-limit")


def test_outcomes_are_told(yard, tmp_path, capsys):
    options = explore_map.Options(
        yard, start=(0, 6, 2), planner=("frontier",), sensing_range=2, step_limit=13, animation=(), out=tmp_path / "out"
    )
    explore_map.main(options)
    assert capsys.readouterr().out.splitlines()[3].endswith("stopped at the limit of 13 steps")
    assert not list((tmp_path / "out").glob("*.gif"))


def test_walls_hide_what_is_behind_them_by_other_rules(yard, tmp_path, monkeypatch):
    seen, options = [], explore_map.Options(yard, start=(1, 4, 3), planner=("frontier",), animation=(), no_record=True)
    monkeypatch.setattr(one_start, "plot_episode", lambda *args: seen.append(args[2]["frontier"].seen[0].sum()))
    for settings, degrees in (("paper", None), ("occluded", None), ("paper", 360.0)):
        explore_map.main(
            dataclasses.replace(
                options, settings=settings, field_of_view=degrees, out=tmp_path / f"{settings}{degrees}"
            )
        )
    assert seen[1] < seen[0] < seen[2]


@pytest.mark.parametrize(
    ("left_out", "written"),
    [
        ({"no_figures": True, "no_record": True}, set()),
        ({"no_figures": True}, {"episode.rrd"}),
        ({"no_record": True}, {*figure("episode"), *figure("trajectories"), "episode.gif"}),
    ],
)
def test_drawing_is_left_out(yard, tmp_path, left_out, written):
    options = explore_map.Options(yard, start=(0, 6, 2), planner=("frontier",), out=tmp_path / "out", **left_out)
    explore_map.main(options)
    assert {path.name for path in (tmp_path / "out").iterdir()} == written | {"episodes.csv", "run.json"}


def test_episodes_too_long_for_the_memory_are_not_replayed(yard, tmp_path, capsys, monkeypatch):
    short, long = (toy.RESULTS[planner] for planner in ("dc2g", "frontier"))
    monkeypatch.setattr(one_start, "_MOST_BYTES", 100 * one_start._REPLAY_BYTES * (short.steps + 1))
    assert one_start._replayable({"long": long, "short": short}, 100) == {"short": short}
    assert "long: 24 steps on 100 cells are too many" in capsys.readouterr().err
    monkeypatch.setattr(one_start, "_MOST_BYTES", 1000)
    options = explore_map.Options(yard, start=(0, 6, 0), planner=("frontier",), out=tmp_path / "out")
    explore_map.main(options)
    assert "frontier: 1" in capsys.readouterr().err
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {"episodes.csv", "run.json", *figure("trajectories")}


@pytest.mark.slow
def test_figure_8_is_of_the_start_of_median_length(streets, tmp_path, capsys):
    out = tmp_path / "out"
    options = reproduce_fig8.Options(dataset=str(streets), planner=("frontier",), animation=(), out=out)
    reproduce_fig8.main(options)
    assert "middle: 12 x 2 cells" in capsys.readouterr().out
    assert {"fig8.png", "fig8.svg", "fig8.rrd", "trajectories.png"} <= {path.name for path in out.iterdir()}
    assert json.loads((out / "run.json").read_text())["experiment"] == "reproduce_fig8"


def test_figure_8_of_a_house_that_is_named(streets, tmp_path):
    start = reproduce_fig8.median_start(map_dataset(streets), seed=0)
    assert start.house == "middle"
    refusal(
        lambda: reproduce_fig8.main(reproduce_fig8.Options(start=(0, 1, 0), dataset=str(streets))),
        "--start", "give --house",
    )  # fmt: skip
    named = reproduce_fig8.Options(house="fat", dataset=str(streets), out=tmp_path / "out")
    refusal(lambda: reproduce_fig8.main(named), "'fat'", "far")
    assert not (tmp_path / "out").exists()


def test_a_dataset_is_drawn(streets, tmp_path, capsys):
    draw_dataset.main(draw_dataset.Options(dataset=str(streets), out=tmp_path / "out"))
    assert "streets: 3 houses, pages: 1" in capsys.readouterr().out
    assert {path.name for path in (tmp_path / "out").iterdir()} == {*figure("page-1"), "run.json"}
    nothing = draw_dataset.Options(dataset=str(streets), splits=("val",), out=tmp_path / "none")
    refusal(lambda: draw_dataset.main(nothing), "streets", "no houses in val")


def test_episodes_are_drawn_from_their_table(streets, tmp_path, capsys):
    table = tmp_path / "episodes.csv"
    header = "house,x,y,heading,range,expanding_range,planner,success,steps,oracle_steps,extra,mode,actions\n"
    table.write_text(
        header
        + "near,0,1,0,8,,frontier,1,5,5,0.0,to_goal,FFFLF\n"
        + "near,0,1,3,8,,frontier,1,6,6,0.0,to_goal,RFFFLF\n"
        + "near,0,1,0,8,,oracle,1,5,5,0.0,to_goal,FFFLF\n"
    )

    def draw(**options):
        draw_episodes.main(draw_episodes.Options(**{"episodes": table, "dataset": str(streets)} | options))

    draw(house=("near",), out=tmp_path / "out")
    written = {path.name for path in (tmp_path / "out").iterdir() if path.suffix == ".png"}
    assert written == {"houses.png", "near-x0-y1-h0-r8.png", "near-x0-y1-h3-r8.png"}
    with table.open("a") as file:
        file.write("near,0,1,0,5,4,frontier,1,5,5,0.0,to_goal,FFFLF\n")
    draw(out=tmp_path / "two")
    assert {path.name for path in (tmp_path / "two").glob("*.png")} == {"houses-r8.png", "houses-r5-e4.png"}
    draw(planner=("oracle",), house=("near",), out=tmp_path / "oracle")
    assert {path.name for path in (tmp_path / "oracle").glob("*.png")} == {"near-x0-y1-h0-r8.png"}
    refusal(lambda: draw(planner=("oracle",)), "episodes.csv", "give another --planner as well, or a --house")
    refusal(lambda: draw(planner=("dc2g",)), "episodes.csv", "no episode of dc2g")
    refusal(lambda: draw(house=("far",)), "no episode in far")


def test_help_names_the_options_of_a_map(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["dc2g", "map", "explore", "--help"])
    with pytest.raises(SystemExit) as ended:
        commands.main()
    assert not ended.value.code
    shown = capsys.readouterr().out
    for option in ("--palette", "--goals", "--goal-unit", "--cells", "--start", "--planner", "--sensing-range"):
        assert option in shown
