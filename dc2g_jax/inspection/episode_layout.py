"""The initial view of an episode's recording."""

from collections.abc import Mapping, Sequence
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from dc2g_jax.inspection.columns import SO_FAR, first_view


def episode_layout(shape: tuple[int, ...], estimates: Mapping[str, bool]) -> rrb.Blueprint:
    """The true map on the left, then one column per planner; legend, curves and plan modes on the right.

    Args:
      shape: rows and columns of the map.
      estimates: planner -> whether it estimates the cost-to-go.
    """
    height, width = shape
    bounds = rrb.VisualBounds2D(x_range=[-0.5, width + 0.5], y_range=[-0.5, height + 0.5])
    entities = {label: rr.new_entity_path([label]) for label in estimates}

    def grid_view(name: str, contents: Sequence[str], robot: str | None = None) -> rrb.Spatial2DView:
        overrides: dict[Any, Any] = {} if robot is None else {f"{robot}/trajectory": SO_FAR}
        return rrb.Spatial2DView(origin="/", contents=contents, name=name, visual_bounds=bounds, overrides=overrides)

    def column(above: rrb.View, below: rrb.View, words: rrb.View) -> rrb.Vertical:
        return rrb.Vertical(above, below, words, row_shares=[6, 6, 1.4])

    def of_planner(label: str) -> rrb.Vertical:
        entity = entities[label]
        robot, plan = f"{entity}/robot", f"{entity}/plan"
        cost, whose = (f"{entity}/cost_to_go", "estimated") if estimates[label] else ("/hidden/cost_to_go", "exact")
        on_both = [f"{plan}/path", f"{plan}/subgoals", f"{robot}/**"]
        return column(
            grid_view(f"{label}: observed map", [f"{entity}/map/**", f"{plan}/frontier_expanding", *on_both], robot),
            grid_view(f"{label}: {whose} cost-to-go", [cost, f"{plan}/candidates", *on_both], robot),
            rrb.TextDocumentView(origin=f"{entity}/status", name=label),
        )

    def of_all(name: str) -> list[str]:
        return [f"{entity}/{name}" for entity in entities.values()]

    hidden = column(
        grid_view("hidden map", ["/hidden/map", "/hidden/goals"]),
        grid_view("exact cost-to-go", ["/hidden/cost_to_go", "/hidden/goals"]),
        rrb.TextDocumentView(origin="/hidden/about", name="house"),
    )

    def curves(entity: str, name: str, legend: rrb.Corner2D) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(
            origin="/", contents=of_all(entity), name=name, plot_legend=rrb.PlotLegend(corner=legend)
        )

    aside = rrb.Vertical(
        rrb.TextDocumentView(origin="/legend", name="legend"),
        curves("extra_steps", "extra steps so far (%)", rrb.Corner2D.LeftTop),
        curves("steps_to_goal", "steps left on the whole map", rrb.Corner2D.RightTop),
        rrb.TextLogView(origin="/", contents=of_all("mode"), name="plan mode"),
        row_shares=[6.4, 2.8, 2.8, 2.2],
    )
    columns = [hidden, *(of_planner(label) for label in estimates)]
    return first_view(rrb.Horizontal(*columns, aside, column_shares=[4.0] * len(columns) + [3.2]))
