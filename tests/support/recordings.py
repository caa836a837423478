"""Reads rerun recordings back."""

from pathlib import Path
from typing import Any

import pytest


def read(path: Path) -> dict[tuple[str, str], dict[int | None, Any]]:
    """`(entity, component) -> {step, or None for static: values}`."""
    chunks = pytest.importorskip("rerun.chunk", reason="this rerun cannot read recordings chunk by chunk")
    table: dict[tuple[str, str], dict[int | None, Any]] = {}
    for chunk in chunks.RrdReader(path).stream():
        batch = chunk.to_record_batch()
        steps = batch["step"].to_pylist() if "step" in batch.schema.names else [None] * batch.num_rows
        for name in batch.schema.names:
            if ":" in name or name == "score":
                values = zip(steps, batch[name].to_pylist(), strict=True)
                table.setdefault((chunk.entity_path, name), {}).update(values)
    return table
