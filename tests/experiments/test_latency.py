"""The command that times a robot's decisions."""

import gc
import json

import pytest

from experiments.latency import Options, main
from tests.support.refusals import refusal


@pytest.mark.slow
def test_decisions_are_timed_and_written_down(compact_network, tmp_path, capsys):
    out = tmp_path / "out"
    main(Options(cells=(20, 30), calls=25, repeats=2, dataset="procedural", network=compact_network, out=out))
    gc.unfreeze()
    facts = json.loads((out / "latency.json").read_text())
    assert [(row["cells"], row["calls"]) for row in facts["rows"]] == [(20, 25), (20, 25), (30, 25), (30, 25)]
    for row in facts["rows"]:
        assert 0 < row["p50"] <= row["p99"] <= row["worst"]
        assert row["first"] <= row["worst"]
    assert facts["machine"]["cores"] >= 1
    assert "p99" in capsys.readouterr().out


@pytest.mark.parametrize("wrong", [{"calls": 0}, {"sensing_range": 0}, {"cells": ()}, {"cells": (50, 0)}])
def test_numbers_that_are_none_are_refused(wrong, tmp_path):
    option = next(iter(wrong)).replace("_", "-")
    refusal(lambda: main(Options(**wrong, out=tmp_path / "out")), f"--{option}", "give ")
