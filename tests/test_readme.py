"""The README's Python example runs as printed."""

import re
from pathlib import Path

README = Path(__file__).resolve().parents[1] / "README.md"


def test_python_examples_run(capsys):
    examples = re.findall(r"```python\n(.*?)```", README.read_text(), flags=re.S)
    assert examples
    for example in examples:
        exec(compile(example, str(README), "exec"), {})
    assert "explore" in capsys.readouterr().out
