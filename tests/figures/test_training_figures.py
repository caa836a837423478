"""Learning curves of agents, as a table and as a figure."""

import re

import numpy as np
from PIL import Image

from dc2g_jax._src.figures.training_figures import save_learning_curve


def test_a_learning_curve_is_written_as_a_table_and_drawn(tmp_path):
    steps, episode_steps = np.array([10, 20, 1_000_000]), np.array([np.nan, 12.5, 3.0])
    files = save_learning_curve(tmp_path / "curve", steps, episode_steps, np.array([np.nan, 0.5, 1.0]))
    assert [path.name for path in files] == ["curve.csv", "curve.png", "curve.svg", "curve.pdf"]
    assert files[0].read_text() == (
        "steps,steps_per_episode,success\n10,nan,nan\n20,12.500,0.5000\n1000000,3.000,1.0000\n"
    )
    drawn = np.asarray(Image.open(files[1]).convert("RGB"))
    assert (drawn == (0x00, 0x72, 0xB2)).all(axis=-1).any()
    assert {"steps per episode", "success (%)"} <= set(re.findall(">([^<]+)</text>", files[2].read_text()))
