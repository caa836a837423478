"""The command that compares planners in families of maps."""

import dataclasses
import re

import numpy as np

from dc2g_jax._src.cli.commands import compare, run_episodes
from dc2g_jax._src.readers.houses import House, HouseDataset
from dc2g_jax._src.readers.starts import sample_starts
from tests.support.maps import drawn
from tests.support.refusals import refusal

YARD = drawn("####D#.. ..#.P... ..##P... SSSSSSSS RRRRRRRR")
MINE = "dc2g_jax._src.planning.planners:Frontier"


def yards() -> HouseDataset:
    houses = [House(f"yard{number}", "val", np.roll(YARD, number, axis=1)) for number in range(2)]
    return HouseDataset("yards", "folder", tuple(houses))


def test_a_planner_and_a_family_of_ones_own(tmp_path, capsys):
    options = compare.Options(
        planner=("oracle", "frontier", MINE), family=(f"{__name__}:yards", f"{__name__}:yards@360"), split="val",
        starts=3, field_of_view=180.0, out=tmp_path / "out",
    )  # fmt: skip
    compare.main(options)
    text = (tmp_path / "out" / "leaderboard.md").read_text()
    assert f"| `{MINE}` | 1.00 | 1.00 | 1.00 |" in text.replace("**", "")
    assert "| planner | all | yards (2) | yards@360 (2) |" in text
    assert "24 episodes of 3 planners in 2 families: `" in text
    assert "8-cell sensing over 180 degrees (after @: another width), split `val`" in text
    assert (tmp_path / "out" / "images" / "leaderboard.png").stat().st_size > 1000
    assert re.search(r"; [1-9]\d* programs were compiled or loaded in \d", capsys.readouterr().out)
    compare.main(dataclasses.replace(options, resume=True))
    assert (tmp_path / "out" / "leaderboard.md").read_text() == text
    assert "episode/s" not in capsys.readouterr().err  # nothing is run again
    refusal(lambda: compare.main(dataclasses.replace(options, planner=("oracle", MINE))), "frontier", "--planner")
    refusal(lambda: compare.main(dataclasses.replace(options, planner=("oracle", "frontier"))), "another one")
    refusal(lambda: compare.main(dataclasses.replace(options, family=())), "--family")


def test_several_networks_are_compared(compact_network, tmp_path, capsys):
    exact = "dc2g_jax._src.estimation.estimators:ExactCostToGo"
    options = compare.Options(
        planner=("frontier", "dc2g"), network=(str(compact_network), exact), family=(f"{__name__}:yards",), split="val",
        starts=2, out=tmp_path / "out",
    )  # fmt: skip
    compare.main(options)
    text = (tmp_path / "out" / "leaderboard.md").read_text()
    names = [f"dc2g ({compact_network.name})", f"dc2g ({exact})"]
    assert all(f"| `{name}` |" in text and f"## Where `{name}` is first" in text for name in names)
    capsys.readouterr()
    starts = tmp_path / "starts.csv"
    start = sample_starts(yards().houses, 1, seed=0)[0]
    starts.write_text(f"house,x,y,heading\n{','.join(map(str, start[:4]))}\n")
    run_episodes.main(
        run_episodes.Options(
            starts=starts, dataset=f"{__name__}:yards", planner=("oracle", "dc2g"), network=options.network,
            out=tmp_path / "run",
        )
    )  # fmt: skip
    shown = capsys.readouterr().out
    assert all(f"\n{name} " in shown for name in ("oracle", *names))
