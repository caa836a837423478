"""The page of the documents, made from that of a run of `dc2g compare`."""

import pytest

from dc2g_jax._src.cli.commands import compare
from experiments import leaderboard
from tests.support.places import ROOT
from tests.support.refusals import refusal

SHOWN = (ROOT / "docs" / "leaderboard.md").read_text()


def test_the_page_of_a_run_becomes_that_of_the_documents(tmp_path, monkeypatch):
    plain = SHOWN
    for added in (leaderboard._BEGIN, leaderboard._NOTE, leaderboard._END):
        assert plain.count(added) == 1
        plain = plain.replace(added, "")
    assert leaderboard.docs_page(plain) == SHOWN
    refusal(lambda: leaderboard.docs_page("# Leaderboard"), "has no table")

    def run(options: compare.Options) -> None:
        (options.out / "images").mkdir(parents=True)
        (options.out / "images" / "leaderboard.png").write_text("a figure")
        (options.out / "leaderboard.md").write_text(plain)

    monkeypatch.setattr(leaderboard, "DOCS", tmp_path)
    monkeypatch.setattr(compare, "main", run)
    (tmp_path / "images").mkdir()
    leaderboard.main(leaderboard.Options(tmp_path / "run"))
    monkeypatch.setattr(compare, "main", lambda options: pytest.fail("it was run already"))
    leaderboard.main(leaderboard.Options(tmp_path / "run"))
    assert (tmp_path / "leaderboard.md").read_text() == SHOWN
    assert (tmp_path / "images" / "leaderboard.png").read_text() == "a figure"
