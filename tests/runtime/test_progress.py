"""Progress bars of episodes."""

import io
import re
import time

import pytest

from dc2g_jax._src.runtime.progress import EpisodeProgress


@pytest.mark.parametrize("leave", [True, False])
def test_a_bar_moves_within_a_long_episode_and_ends_with_the_last(leave, monkeypatch):
    shown = io.StringIO()
    monkeypatch.setattr("sys.stderr", shown)
    progress = EpisodeProgress(leave=leave)
    for _ in range(2):
        progress("dc2g", 0, 2)
        assert "compiling" in shown.getvalue()
    time.sleep(1.2)  # no part of the estimate
    progress("dc2g", 0, 2)
    shown.truncate(shown.seek(0))
    lengths = []
    for _ in range(2):  # the time moves on, though no episode has ended
        time.sleep(0.12)
        progress("dc2g", 0, 2)
        lengths.append(len(shown.getvalue()))
    assert 0 < lengths[0] < lengths[1]
    progress("dc2g", 2, 2)
    assert not re.search("compiling|00:0[1-9]", shown.getvalue())
    assert ("2/2" in shown.getvalue()) == leave
    progress("frontier", 1, 2)
    assert "frontier" in shown.getvalue()
