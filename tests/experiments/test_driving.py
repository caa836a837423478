"""Driving by camera, as commands: figure, recording, tables, and going on where a run stopped."""

import dataclasses
import json

import numpy as np
import pytest

from dc2g_jax._src.files.rows import ResumableTable
from experiments import noisy_mapping, reproduce_fig9
from experiments.support.driving import DriveResult
from tests.support.refusals import refusal
from tests.support.streets import STREET

#: Images small enough to be rendered quickly.
IMAGE = (64, 48)


@pytest.fixture
def street(tmp_path):
    """A folder of one map."""
    (tmp_path / "street").mkdir()
    np.save(tmp_path / "street" / "street.npy", STREET)
    return str(tmp_path / "street")


@pytest.mark.slow
def test_figure_9_shows_and_records_a_drive(street, tmp_path, capsys):
    out = tmp_path / "out"
    options = reproduce_fig9.Options(
        dataset=street, start=(9, 2, 2), noise=0.0, pedestrians=1, image_size=IMAGE, out=out
    )
    reproduce_fig9.main(options)
    told = capsys.readouterr().out
    assert "street: arrived after" in told
    assert "% are as in the house" in told
    assert {path.name for path in out.iterdir()} == {"fig9.png", "fig9.svg", "fig9.pdf", "fig9.rrd", "run.json"}
    assert (out / "fig9.rrd").stat().st_size > 10_000
    refusal(lambda: reproduce_fig9.main(dataclasses.replace(options, noise=-1.0)), "--noise -1", "at least 0")


@pytest.mark.slow
def test_noise_is_swept_and_a_run_goes_on_where_it_stopped(street, tmp_path, capsys):
    out = tmp_path / "out"
    options = noisy_mapping.Options(
        dataset=street, starts_per_house=2, levels=(0.0, 2.0), image_size=IMAGE, pedestrians=1, out=out
    )
    noisy_mapping.main(options)
    results = json.loads((out / "results.json").read_text())
    runs = {f"trained {network}, noise {level}" for network in ("clean", "noisy") for level in (0, 2)}
    assert set(results) == {"gridworld, paper", "gridworld, occluded", *runs}
    clean = results["trained clean, noise 0"]
    assert clean["success"] == 1
    assert clean["extra_low"] <= clean["extra"] <= clean["extra_high"]
    assert (clean["seconds_off_ground"], clean["seconds_touching_people"]) == (0, 0)
    first = capsys.readouterr().out
    kept = (out / "drives" / "clean_0.csv").read_text()
    (out / "drives" / "clean_2.csv").unlink()
    noisy_mapping.main(dataclasses.replace(options, resume=True))
    assert capsys.readouterr().out == first
    assert (out / "drives" / "clean_0.csv").read_text() == kept
    assert json.loads((out / "results.json").read_text()) == results


@pytest.mark.parametrize(
    ("options", "mentions"),
    [
        ({"levels": ()}, ["--levels", "give one at least"]),
        ({"levels": (1.0, -1.0)}, ["--levels 1.0 -1.0", "from 0 on"]),
        ({"pedestrians": -1}, ["--pedestrians -1", "at least 0"]),
        ({"image_size": (4, 100)}, ["--image-size 4", "at least 8"]),
    ],
)
def test_options_of_no_use_are_refused(street, tmp_path, options, mentions):
    refusal(
        lambda: noisy_mapping.main(noisy_mapping.Options(dataset=street, out=tmp_path / "out", **options)), *mentions
    )


DRIVE = "street,9,2,2,4.0,arrived,0.0,0.0"


@pytest.mark.parametrize(
    ("lines", "mentions"),
    [
        ([], ["oracle.csv", "no rows"]),
        ([DRIVE.replace("9", "8")], ["oracle.csv", "street,8,2,2 where", "street,9,2,2", "remove the file"]),
        ([DRIVE.replace("arrived", "flown")], ["oracle.csv: line 2", "'flown'", "arrived", "remove the file"]),
        ([DRIVE.replace("4.0", "soon")], ["oracle.csv: line 2", "soon", "remove the file"]),
    ],
)
def test_kept_drives_that_are_not_of_this_run_are_refused(tmp_path, lines, mentions):
    header = "house,x,y,heading,seconds,status,off_ground,touched"
    (tmp_path / "oracle.csv").write_text("\n".join([header, *lines]) + "\n")
    asked = [("street", 9, 2, 2), ("street", 9, 3, 2)]

    def resume() -> None:
        table = ResumableTable(tmp_path / "oracle.csv", DriveResult)
        table.next_results(asked, lambda: pytest.fail("they are there"))

    refusal(resume, *mentions)
