"""The command that compares our runs with the authors'."""

import json

import pytest

from experiments import head_to_head
from tests.support.places import PUBLISHED


@pytest.mark.slow
@pytest.mark.skipif(not PUBLISHED.is_dir(), reason="../shared is absent")
def test_a_planner_of_ones_own_in_the_place_of_dc2g(tmp_path):
    planner = "dc2g_jax._src.planning.planners:Frontier"
    head_to_head.main(head_to_head.Options(planner=planner, dataset=str(PUBLISHED), resamples=10, out=tmp_path / "out"))
    facts = json.loads((tmp_path / "out" / "results.json").read_text())
    assert facts["planner"] == planner
    assert facts["groups"]["all"]["frontier_over_dc2g"] == 0
