"""Summaries of episodes by group of houses."""

from collections.abc import Mapping, Sequence

from dc2g_jax._src.rollouts.results import EpisodeResult, Results

#: Planner -> group of houses -> summary, see `Results.summary`.
Table = Mapping[str, Mapping[str, Mapping[str, float]]]


def tabulate(results: Sequence[EpisodeResult], groups: Sequence[str], group_by_house: Mapping[str, str]) -> Table:
    """Summary by planner and group of houses; the last of the groups holds all episodes.

    Episodes from whose start no goal can be reached are left out.
    """
    by_group = {
        group: Results(one for one in results if group in (group_by_house.get(one.house), groups[-1])).summary()
        for group in groups
    }
    return {
        planner: {group: summaries[planner] for group, summaries in by_group.items() if planner in summaries}
        for planner in by_group[groups[-1]]
    }
