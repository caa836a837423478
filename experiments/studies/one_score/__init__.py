"""One score for all maps, learned from rollouts. The findings are in docs/notebook/one_score.md."""
