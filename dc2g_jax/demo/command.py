"""Watch planners step by step in the browser: `dc2g demo`.

Choose or draw a map, place the robot, and see what each planner sees and why it decides as it does.
"""

import dataclasses
import secrets
from typing import Annotated

import tyro

from dc2g_jax.commands import DatasetOption, DatasetOptions, NetworkOptions, PlannersOption, check_planners
from dc2g_jax.demo.robots import open_maps
from dc2g_jax.estimation import load_network
from dc2g_jax.runtime import require_extra


@dataclasses.dataclass(frozen=True)
class Options(DatasetOptions, NetworkOptions):
    """Serve a page on this machine where planners run step by step, on a map that you choose or draw.

    Attributes:
      dataset: maps to begin with: a folder of houses, a map file, or `procedural`.
      planner: planners to run at first; package.module:Name for one of your own. The page offers the others too.
      port: port of the page.
      token: secret in the address of the page, so that other users of the machine cannot open it: letters, digits, -
        and _; random by default, and none if empty.
      no_browser: do not open the page in a browser.
    """

    dataset: DatasetOption = "procedural"
    planner: PlannersOption = ("frontier", "dc2g", "true_cost_to_go")
    port: int = 8080
    token: Annotated[str | None, tyro.conf.arg(metavar="WORD", help_behavior_hint="")] = None
    no_browser: bool = False


def main(options: Options) -> None:
    """Serve the page until Ctrl-C."""
    require_extra("nicegui", extra="demo")
    from dc2g_jax.demo.local_server import check_token
    from dc2g_jax.demo.page import check_port, serve

    check_port(options.port)
    token = secrets.token_urlsafe(24) if options.token is None else options.token
    check_token(token)
    check_planners(options.planner)
    maps, network = open_maps(options.dataset), load_network(options.network)
    serve(maps, options.planner, network, port=options.port, token=token, open_browser=not options.no_browser)
