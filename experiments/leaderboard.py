"""The page docs/leaderboard.md: `python -m experiments.leaderboard outputs/leaderboard`."""

import dataclasses
import shutil
from pathlib import Path

import tyro

from dc2g_jax._src.cli.commands import compare
from dc2g_jax._src.cli.common import command_line
from dc2g_jax._src.cli.options import SharedOptions
from dc2g_jax._src.runtime.errors import InputError

#: Where the documents of this checkout are.
DOCS = Path(__file__).parent.parent / "docs"

_BEGIN = """---
hide: [navigation]
---

"""

_NOTE = """\
Nothing was tuned on this split, but 400 episodes in the published houses had been run before, and a network was
withdrawn with knowledge of them ([notebook](notebook/published_episodes.md)). Networks learned in published training
houses and procedural ones of other seeds, `recurrent_policy` and the score of `dc2g` in procedural houses and drawn
maps of other seeds. [Planners](reference/rivals.md).

"""

_END = """
[Your planner](tutorials/write_a_planner.md) and [your maps](tutorials/your_own_map.md) enter by name:

```bash
dc2g compare --planner frontier dc2g my_planner:MyPlanner --family mazes my_maps/ my_module:my_dataset
```
"""

#: The line that the table of a page begins with.
_TABLE = "| planner | all |"


@dataclasses.dataclass(frozen=True)
class Options(SharedOptions):
    """Write docs/leaderboard.md and its figure from a run of `dc2g compare`.

    Attributes:
      folder: the output folder of that run. If there is none, `dc2g compare` is run with its defaults.
    """

    folder: tyro.conf.Positional[Path]


def docs_page(page: str) -> str:
    """The page of the documents, made from `leaderboard.md` of a run: with links, and what is true of this package."""
    before, table, after = page.partition(_TABLE)
    if not table:
        raise InputError("leaderboard.md: has no table of planners; run dc2g compare anew")
    return f"{_BEGIN}{before}{_NOTE}{table}{after}{_END}"


def main(options: Options) -> None:
    """Run `dc2g compare` if necessary, and write the page."""
    made = options.folder / "leaderboard.md"
    if not made.exists():
        compare.main(compare.Options(out=options.folder, machine=options.machine))
    (DOCS / "leaderboard.md").write_text(docs_page(made.read_text(encoding="utf-8")), encoding="utf-8")
    shutil.copy(options.folder / "images" / "leaderboard.png", DOCS / "images" / "leaderboard.png")
    print(f"Written: {DOCS / 'leaderboard.md'}")


if __name__ == "__main__":
    command_line(Options, main)
