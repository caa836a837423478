"""A file that is written anew is the old one or the new one, never a part of either."""

from pathlib import Path

import numpy as np
import pytest

from dc2g_jax._src.files.atomic import replacing


def test_takes_its_place_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "masks.npz"
    np.savez(path, old=1)
    with replacing(path) as unfinished:
        np.savez(unfinished, new=2)
        assert list(np.load(path)) == ["old"]
    assert list(np.load(path)) == ["new"]
    assert list(tmp_path.iterdir()) == [path]


def test_two_writers_do_not_meet(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    with replacing(path) as one, replacing(path) as other:
        one.write_text("one")
        other.write_text("other")
    assert path.read_text() == "one"  # the last to end
    assert list(tmp_path.iterdir()) == [path]


def test_a_failure_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("old")

    def fail() -> None:
        with replacing(path) as unfinished:
            unfinished.write_text("ne")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
