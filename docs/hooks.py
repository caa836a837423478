"""What the site takes from elsewhere in the repository when it is built."""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

#: Leaves the width of the page to the tables.
_HEAD = "---\nhide: [navigation]\n---\n\n"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add BENCHMARKS.md, which lies beside the README, as a page; its pictures are those of the site."""
    text = (Path(config.config_file_path).parent / "BENCHMARKS.md").read_text(encoding="utf-8")
    files.append(File.generated(config, "benchmarks.md", content=_HEAD + text.replace("](docs/", "](")))
    return files
