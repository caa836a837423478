"""What the site takes from elsewhere in the repository when it is built."""

import os
import tomllib
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

#: Pages beside the README, which is the first one, and their names on the site.
_PAGES = {"README": "index", "BENCHMARKS": "benchmarks", "CONTRIBUTING": "contributing", "CHANGELOG": "changelog"}
#: Leaves the width of the page to the tables.
_HEAD = "---\nhide: [navigation]\n---\n\n"


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Name the version and, where GitHub builds the site, link to its repository."""
    project = tomllib.loads((Path(config.config_file_path).parent / "pyproject.toml").read_text())["project"]
    config.copyright = f"dc2g_jax {project['version']}, {config.copyright}"
    if repository := os.environ.get("GITHUB_REPOSITORY"):
        config.repo_name = repository
        config.repo_url = f"{os.environ['GITHUB_SERVER_URL']}/{repository}"
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that lie in the root of the repository; their links and pictures are those of the site."""
    root = Path(config.config_file_path).parent
    for name, page in _PAGES.items():
        text = (root / f"{name}.md").read_text(encoding="utf-8").replace("](docs/", "](")
        files.append(File.generated(config, f"{page}.md", content=_HEAD + text))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Turn links to these pages, from beside them or from below docs/, into those of the site."""
    for name, page in _PAGES.items():
        markdown = markdown.replace(f"]({name}.md", f"]({page}.md").replace(f"../{name}.md", f"{page}.md")
    return markdown
