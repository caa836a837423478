"""The real commands, run as users run them."""

import csv
import dataclasses
import importlib
import json
import re
import runpy
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pytest
import tyro

import dc2g_jax as dc2g
from dc2g_jax._src.cli import commands
from dc2g_jax._src.cli.commands import run_episodes, sweep as sweep_losses, train
from dc2g_jax._src.cli.common import command_line
from dc2g_jax._src.estimation.checkpoints import network_in_folder
from dc2g_jax._src.estimation.estimators import ExactCostToGo
from dc2g_jax._src.estimation.weights import read_safetensors, write_safetensors
from dc2g_jax._src.grid.terrain import FRONT_DOOR, GRASS, ROAD
from dc2g_jax._src.readers.houses import load_dataset
from dc2g_jax._src.readers.starts import sample_starts
from dc2g_jax.families.procedural import PROCEDURAL_SPLIT, draw_house, house_seed
from experiments import (
    head_to_head,
    latency,
    noisy_mapping,
    objectnav_train,
    reproduce_fig5,
    reproduce_fig7,
    reproduce_fig8,
    reproduce_fig9,
)
from tests.support.commands import COMMANDS, complaint, run
from tests.support.houses import STREET, YARD, save_dataset
from tests.support.places import ROOT
from tests.support.refusals import refusal


@pytest.fixture(scope="module")
def few_houses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one training, one validation and three test houses; the last has no door."""
    by_split: dict[str, list] = {}
    for index, (name, split, style) in enumerate(PROCEDURAL_SPLIT):
        by_split.setdefault(split, []).append((name, split, house_seed(0, index), style))
    chosen = [by_split["train"][0], by_split["val"][0], *by_split["test"][:3]]
    houses = [(name, split, draw_house(seed, style)) for name, split, seed, style in chosen]
    doorless = houses.pop()[2]
    doorless[doorless == FRONT_DOOR] = GRASS
    houses.append(("n009m000h000", "test", doorless))
    return save_dataset(houses, tmp_path_factory.mktemp("houses") / "few")


@pytest.fixture(scope="module")
def figure(few_houses, tmp_path_factory) -> Path:
    """What Fig. 7 of these houses is written to."""
    out = tmp_path_factory.mktemp("figure") / "out"
    result = run("reproduce_fig7", "--dataset", few_houses, "--starts-per-house", 2, "--record", "--out", out)
    assert result.returncode == 0, result.stderr
    assert "Left out: the 400 published episodes, which need the published houses, not few" in result.stderr
    assert "Left out: house n009m000h000: it has no front door" in result.stderr
    return out


@pytest.mark.slow
def test_reproduce_fig7_on_a_folder_of_houses(few_houses, figure):
    out = figure
    facts = json.loads((out / "results.json").read_text())
    assert facts["dataset"] == "few"
    assert facts["published"] == {}
    assert set(facts["paper"]) == {"oracle", "frontier", "dc2g", "dc2g_uncertain", "true_cost_to_go"}
    assert facts["paper"]["oracle"]["test"] == {
        "mean_extra": 0.0, "mean_low": 0.0, "mean_high": 0.0, "median_extra": 0.0, "success": 1.0, "episodes": 4,
    }  # fmt: skip
    with (out / "episodes.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 20
    made = json.loads((out / "run.json").read_text())
    assert made["options"]["starts_per_house"] == 2
    assert made["runs"][0]["command"].startswith("python -m experiments.reproduce_fig7 --dataset ")
    assert made["runs"][0]["versions"]["jax"] == jax.__version__
    frontier = [float(row["extra"]) for row in rows if row["planner"] == "frontier"]
    assert facts["paper"]["frontier"]["test"]["mean_extra"] == pytest.approx(np.mean(frontier), abs=1e-3)
    assert all(len(row["actions"]) == int(row["steps"]) for row in rows)
    for name in ("fig7.png", "fig7.svg", "fig7.pdf", "summary.csv", "houses.csv"):
        assert (out / name).stat().st_size > 0
    for ending in ("rrd", "png"):
        assert len(list((out / "recordings").glob(f"*.{ending}"))) == 3
    # An output folder in use is refused, and nothing in it is touched.
    before = (out / "results.json").read_text()
    again = run("reproduce_fig7", "--dataset", few_houses, "--out", out)
    assert str(out) in complaint(again)
    assert "add --resume" in complaint(again)
    assert (out / "results.json").read_text() == before


@pytest.mark.slow
def test_run_episodes_replays_what_was_asked_for(few_houses, figure, tmp_path):
    starts = tmp_path / "starts.csv"
    with (figure / "episodes.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["planner"] in ("oracle", "frontier")]
    chosen = [row for row in rows if row["planner"] == "oracle"]
    lines = [",".join(row[column] for column in ("house", "x", "y", "heading")) for row in chosen]
    starts.write_text("\n".join(["house,x,y,heading", *lines]))
    result = run(
        "dc2g run", "--starts", starts, "--planner", "oracle", "frontier", "--settings", "paper",
        "--dataset", few_houses, "--out", tmp_path / "second",
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    with (tmp_path / "second" / "episodes.csv").open() as file:
        reader = csv.DictReader(file)
        again = list(reader)
    assert reader.fieldnames == [
        "house", "x", "y", "heading", "range", "expanding_range", "planner", "success", "steps", "oracle_steps",
        "extra", "mode", "actions",
    ]  # fmt: skip
    assert again == rows


def test_an_estimator_and_rules_of_the_users_own_run_by_name(few_houses, tmp_path, capsys):
    starts, houses = tmp_path / "starts.csv", load_dataset(few_houses)
    start = sample_starts([houses.split("val")[0]], 1, seed=0)[0]
    starts.write_text(f"house,x,y,heading\n{start.house},{start.x},{start.y},{start.heading}\n")
    network, settings = "dc2g_jax._src.estimation.estimators:ExactCostToGo", "tests.planning.test_planners:NARROW"
    options = {"dataset": str(few_houses), "network": (network,), "settings": settings, "out": tmp_path / "out"}
    run_episodes.main(run_episodes.Options(starts=starts, planner=("dc2g",), **options))
    assert f"settings {settings}" in capsys.readouterr().out
    with (tmp_path / "out" / "episodes.csv").open() as file:
        (row,) = csv.DictReader(file)
    (alone,) = dc2g.evaluate("dc2g", houses, starts=[start], sensing_range=3, network=ExactCostToGo())
    assert (row["range"], row["actions"]) == ("3", alone.actions)
    options |= {"settings": "paper", "field_of_view": 360.0, "out": tmp_path / "wide"}
    run_episodes.main(run_episodes.Options(starts=starts, planner=("dc2g",), **options))
    with (tmp_path / "wide" / "episodes.csv").open() as file:
        (row,) = csv.DictReader(file)
    (alone,) = dc2g.evaluate("dc2g", houses, starts=[start], field_of_view=360, network=ExactCostToGo())
    assert row["actions"] == alone.actions


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_done_and_resume_goes_on(few_houses, tmp_path):
    starts, out = tmp_path / "starts.csv", tmp_path / "out"
    house = load_dataset(few_houses).split("test")[0]
    row, column = np.argwhere(house.terrain == ROAD)[0].tolist()
    starts.write_text(f"house,x,y,heading\n{house.name},{column},{row},0\n")
    options = ["dc2g run", "--starts", starts, "--dataset", few_houses, "--out", out, "--planner"]
    options += ["frontier", "oracle", "true_cost_to_go"]
    # A shell that runs the tests in the background has its children ignore interrupts.
    heeding = (
        "import runpy, signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "runpy.run_module('dc2g_jax', run_name='__main__', alter_sys=True)"
    )
    command = [sys.executable, "-c", heeding, "run", *(str(option) for option in options[1:])]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 200
    while not (out / "episodes.csv").exists():
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, words = process.communicate(timeout=200)
    assert process.returncode == 130, words
    assert words.splitlines()[-1] == "interrupted; what was written is kept: the same command with --resume goes on"
    kept = (out / "episodes.csv").read_text()
    assert kept.count("\n") < 4
    assert run(*options, "--resume").returncode == 0
    assert (out / "episodes.csv").read_text().startswith(kept)
    assert (out / "episodes.csv").read_text().count("\n") == 4
    assert len(json.loads((out / "run.json").read_text())["runs"]) == 2
    starts.write_text(f"house,x,y,heading\n{house.name},{column},{row},1\n")
    changed = run_episodes.Options(
        starts=starts, dataset=str(few_houses), out=out, resume=True,
        planner=("frontier", "oracle", "true_cost_to_go"),
    )  # fmt: skip
    refusal(lambda: run_episodes.main(changed), out, "what is read for --starts has changed")


def test_bad_input_is_refused_in_one_line(few_houses, tmp_path):
    starts = tmp_path / "starts.csv"
    house = load_dataset(few_houses).split("test")[0].name
    starts.write_text(f"house,x,y,heading\n{house},500,3,0\n")
    line = complaint(run("dc2g run", "--starts", starts, "--dataset", few_houses, "--out", tmp_path / "a"))
    assert "line 2" in line
    assert "column 500, row 3 is off the map" in line
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("seed", [-1, 2**32])
def test_a_seed_that_is_none_is_refused_by_every_command(seed, monkeypatch, capfd):
    monkeypatch.setattr(sys, "argv", ["reproduce_fig7.py", "--seed", str(seed)])
    with pytest.raises(SystemExit) as stopped:
        command_line(reproduce_fig7.Options, lambda options: pytest.fail("has begun"))
    assert stopped.value.code == 2
    assert capfd.readouterr().err.startswith(f"error: --seed {seed}: give a whole number from 0")


@pytest.mark.parametrize(
    ("command", "options", "remedy"),
    [
        (sweep_losses, ["--out", "out"], "lower --runs-at-once or --batch-size"),
        (train, ["--out", "out"], "lower --batch-size"),
        (reproduce_fig7, [], "end other programs that use it, or take smaller maps"),
    ],
)
def test_lack_of_memory_is_one_line_that_names_the_option_to_lower(command, options, remedy, monkeypatch, capfd):
    def needs_too_much(parsed):
        raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes.\nmore\nlines")

    monkeypatch.setattr(sys, "argv", [f"{command.__name__}.py", *options])
    with pytest.raises(SystemExit) as stopped:
        command_line(command.Options, needs_too_much)
    assert stopped.value.code == 2
    assert capfd.readouterr().err == (
        f"error: a device is out of memory; {remedy} (RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes.)\n"
    )


@pytest.mark.parametrize(
    ("command", "options"),
    [
        (train, ["--dataset", "procedural"]),
        (sweep_losses, ["--dataset", "procedural"]),
        (reproduce_fig5, ["--dataset", "procedural"]),
        (objectnav_train, []),
    ],
)
def test_batches_beyond_all_memory_are_refused_before_anything_is_collected(command, options, monkeypatch, capfd):
    words = [f"{command.__name__}.py", "--out", "out", *options, "--batch-size", str(10**9)]
    monkeypatch.setattr(sys, "argv", words)
    began = time.monotonic()
    with pytest.raises(SystemExit) as stopped:
        command_line(command.Options, command.main)
    assert stopped.value.code == 2
    error = capfd.readouterr().err
    assert re.fullmatch(r"error: --batch-size 1000000000.*: needs more than [\d.e+]+ GB of memory.*; lower it\n", error)
    assert not Path("out").exists()
    assert time.monotonic() - began < 60


WRITES = '''
import dataclasses, pathlib, resource, sys
import numpy as np
from dc2g_jax._src.cli import commands
from dc2g_jax._src.cli.common import command_line
from dc2g_jax._src.cli.options import TrainingOptions
from dc2g_jax._src.cli.outputs import output_folder
from dc2g_jax._src.files.tables import write_table

@dataclasses.dataclass(frozen=True)
class Options(TrainingOptions):
    """Write a table."""

def main(options):
    output_folder(options, "writing")
    if not options.resume:
        resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
    write_table(options.out / "table.csv", ["x"], ([x] for x in range(100_000)))
    for _ in range(100_000):
        print("written")

command_line(Options, main)
'''


@pytest.mark.skipif(sys.platform == "win32", reason="limits the size of files as POSIX does")
@pytest.mark.slow
def test_a_full_disk_and_a_closed_pipe_are_one_line_that_says_how_to_go_on(tmp_path):
    command = [sys.executable, "-c", WRITES, "--out", str(tmp_path / "out")]
    full = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert full.returncode == 2
    (line,) = full.stderr.splitlines()
    assert line.startswith("error: ")
    assert line.endswith(
        "file too large; make room on the disk; what was written is kept: the same command with --resume goes on"
    )
    with subprocess.Popen(
        [*command, "--resume"], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as piped:
        assert piped.stdout.readline() == "written\n"
        piped.stdout.close()
        told = piped.stderr.read()
    assert piped.returncode == 141
    assert told == (
        "nobody reads the output any more; what was written is kept: the same command with --resume goes on\n"
    )
    assert len((tmp_path / "out" / "table.csv").read_text().splitlines()) == 100_001


def test_help_may_be_cut_off():
    for words in (["--help"], ["train", "--help"]):
        code = f"import sys; from dc2g_jax._src.cli.commands import main; sys.argv = {['dc2g', *words]}; main()"
        command = [sys.executable, "-c", code]
        with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as cut_off:
            cut_off.stdout.close()
            assert cut_off.stderr.read() == b""
        assert cut_off.returncode == 141


def test_commands_refuse_what_they_cannot_use(few_houses, tmp_path, compact_network):
    """As above, without a process for each."""
    out = tmp_path / "out"
    starts = tmp_path / "starts.csv"
    starts.write_text("house,x,y\n")

    def refused(command, *mentions, **options):
        options = command.Options(**{"dataset": str(few_houses), "out": out} | options)
        refusal(lambda: command.main(options), *mentions)

    refused(run_episodes, "'heading'", starts=starts)
    start = sample_starts([load_dataset(few_houses).split("test")[0]], 1, seed=0)[0]
    starts.write_text(f"house,x,y,heading,expanding_range\n{start.house},{start.x},{start.y},{start.heading},4\n")
    refused(run_episodes, "expanding range 4", "'paper'", "leave expanding_range out", starts=starts)
    refused(run_episodes, "field of view 180", "'reference'", starts=starts, settings="reference", field_of_view=180.0)
    refused(reproduce_fig7, "nowhere", dataset=str(tmp_path / "nowhere"))
    refused(reproduce_fig7, "published houses", settings="published")
    refused(reproduce_fig7, "network.json", network=tmp_path)
    refused(reproduce_fig7, "step limit 0", step_limit=0)
    refused(head_to_head, "published houses")
    refused(train, "give one of quantile, l1", loss="l9")
    refused(train, "--quantiles 0.5 0.9", "equally likely", "0.25 0.75", quantiles=(0.5, 0.9))
    refused(train, "another architecture", "--widths", after=str(compact_network))
    refused(sweep_losses, "'none'", losses=("l1=none",))
    refused(run_episodes, "--planner dc2g dc2g", "once", starts=starts, planner=("dc2g", "dc2g"))
    refused(reproduce_fig5, "each once", seeds=(0, 0))
    refused(reproduce_fig5, "--seeds -1", seeds=(-1,))
    refused(reproduce_fig8, "network.json", network=tmp_path)
    refused(reproduce_fig9, "network.json", network=tmp_path)
    refused(reproduce_fig9, "--noise inf", noise=float("inf"))
    refused(noisy_mapping, "--levels 0 nan", levels=(0, float("nan")))
    refused(latency, "--sensing-range 0", sensing_range=0)
    assert not out.exists()


@pytest.mark.slow
def test_training_resumes_and_its_network_plans(few_houses, tmp_path):
    out = tmp_path / "run"
    words = [
        "--dataset", few_houses, "--out", out, "--extra-houses", 2, "--starts-per-house", 1,
        "--masks-per-episode", 2, "--steps", 4, "--batch-size", 4, "--ranges", 6, "--validate-every", 0, "--record",
        "--track", "tensorboard", "--loss", "l1,tests.training.test_losses:squares",
    ]  # fmt: skip
    first = run("dc2g train", *words)
    assert first.returncode == 0, first.stderr
    assert [path.name for path in out.glob("*.rrd")] == ["training-001.rrd"]
    assert len(list((out / "tensorboard").iterdir())) == 1
    assert (out / "curve.csv").read_text().startswith("step,loss,learning_rate\n4,")
    card = json.loads((out / "network" / "network.json").read_text())
    assert card["steps"] == 4
    finished = {path: path.stat().st_mtime_ns for path in (out / "network").rglob("*")}
    options = tyro.cli(train.Options, args=[str(word) for word in words])
    refusal(lambda: train.main(options), "add --resume")
    again = dataclasses.replace(options, resume=True)
    train.main(again)  # finished already: nothing is trained again
    assert {path: path.stat().st_mtime_ns for path in (out / "network").rglob("*")} == finished
    refusal(lambda: train.main(dataclasses.replace(again, seed=7)), "begun with --seed 0, now it is 7")
    facts = json.loads((out / "run.json").read_text())
    assert facts["inputs"] == {"dataset": load_dataset(few_houses).sha256}
    (out / "network" / "network.json").rename(out / "card")
    masks = read_safetensors(out / "masks.safetensors")
    write_safetensors(out / "masks.safetensors", masks | {"boards": masks["boards"][:, :, 1:]})
    refusal(lambda: train.main(again), "masks.safetensors", "of 50 x 50 cells")
    (out / "card").rename(out / "network" / "network.json")
    result = run(
        "reproduce_fig7", "--dataset", few_houses, "--settings", "paper", "--starts-per-house", 1, "--planner", "dc2g",
        "--network", out / "network", "--out", tmp_path / "figure",
    )  # fmt: skip
    assert result.returncode == 0, result.stderr


@pytest.mark.slow
def test_a_sweep_that_was_killed_ends_like_one_that_was_not(tmp_path):
    # Maps that are not square, so that no houses are drawn to validate in.
    for split, terrain in (("train", STREET), ("val", YARD)):
        (tmp_path / "houses" / split).mkdir(parents=True)
        np.save(tmp_path / "houses" / split / f"{split}.npy", terrain)

    def options(out: Path) -> list[object]:
        return [
            "dc2g sweep", "--dataset", tmp_path / "houses", "--out", out, "--extra-houses", 0, "--starts-per-house", 1,
            "--ranges", 6, "--steps", 300, "--batch-size", 4, "--widths", "4,4,4,4", "--losses", "l1", "l2",
            "--seeds", 0, "--validate-every", 100, "--split", "None", "--minutes-per-checkpoint", 0.01,
        ]  # fmt: skip

    whole = run(*options(tmp_path / "whole"))
    assert whole.returncode == 0, whole.stderr
    command = [str(argument) for argument in options(tmp_path / "killed")[1:]]
    process = subprocess.Popen(
        [sys.executable, "-m", "dc2g_jax", "sweep", *command], cwd=ROOT, stderr=subprocess.DEVNULL
    )
    states = tmp_path / "killed" / "runs"
    deadline = time.monotonic() + 200
    while process.poll() is None and not any(states.glob("*/states/*")):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.kill()
    process.wait()
    assert not (tmp_path / "killed" / "results.csv").exists()
    assert run(*options(tmp_path / "killed"), "--resume").returncode == 0
    for name in ("results.csv", "curve.csv"):
        assert (tmp_path / "killed" / name).read_text() == (tmp_path / "whole" / name).read_text()
    for network in (tmp_path / "whole" / "runs").glob("*/network"):
        one, other = (
            network_in_folder(tmp_path / which / network.relative_to(tmp_path / "whole"))
            for which in ("whole", "killed")
        )
        jax.tree.map(np.testing.assert_array_equal, one.weights, other.weights)


@pytest.mark.slow
def test_a_translator_is_trained_and_judged(few_houses, compact_network, tmp_path):
    network = tmp_path / "run" / "runs" / "l1+gan-seed0" / "network"
    first = run(
        "reproduce_fig5", "--dataset", few_houses, "--size", 32, "--base-filters", 2, "--train-masks", 4,
        "--validation-masks", 2, "--steps", 4, "--validate-every", 2, "--losses", "l1+gan", "--seeds", 0,
        "--out", tmp_path / "run",
    )  # fmt: skip
    assert first.returncode == 0, first.stderr
    assert "4 pairs of 1 houses" in first.stdout
    card = json.loads((network / "network.json").read_text())
    assert (card["network"], card["loss"], card["steps"]) == (reproduce_fig5.TRANSLATOR.name, "l1+gan", 4)
    fig6 = run(
        "reproduce_fig6", "--dataset", few_houses, "--network", network, compact_network, "--out", tmp_path / "fig6"
    )
    assert fig6.returncode == 0, fig6.stderr
    facts = json.loads((tmp_path / "fig6" / "results.json").read_text())
    assert facts["houses"] == 2
    assert set(facts["networks"]) == {str(network), str(compact_network)}
    with (tmp_path / "fig6" / "houses.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["network"] for row in rows] == [str(network)] * 2 + [str(compact_network)] * 2
    mean = np.mean([float(row["l1"]) for row in rows[:2]])
    assert facts["networks"][str(network)]["l1"]["mean"] == pytest.approx(mean, abs=1e-4)
    for name in ("fig6.png", "fig6.svg"):
        assert (tmp_path / "fig6" / name).stat().st_size > 0


@pytest.mark.filterwarnings("ignore:.*found in sys.modules:RuntimeWarning")
@pytest.mark.parametrize("command", COMMANDS)
def test_help_names_every_option(command, monkeypatch, capsys):
    module = COMMANDS[command]
    if command.startswith("dc2g "):
        monkeypatch.setattr(sys, "argv", [*command.split(), "--help"])
        with pytest.raises(SystemExit) as ended:
            commands.main()
    else:
        monkeypatch.setattr(sys, "argv", ["-m", "--help"])
        with pytest.raises(SystemExit) as ended:
            runpy.run_module(module, run_name="__main__", alter_sys=True)
    assert not ended.value.code
    options = importlib.import_module(module).Options
    words = "\n".join(each.__doc__ or "" for each in options.__mro__)
    for option in dataclasses.fields(options):
        assert re.search(rf"^\s+{option.name}: \S", words, re.MULTILINE), option.name
    shown = capsys.readouterr().out
    assert f"{command} " in shown
    without = ("dc2g demo", "python -m experiments.results", "python -m experiments.leaderboard")
    assert ("--out" in shown) == (command not in without)
