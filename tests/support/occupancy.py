"""A ROS occupancy map on disk."""

from pathlib import Path

import numpy as np

FACTS = {
    "image": "lab.pgm", "resolution": 0.05, "origin": [0.0, 0.0, 0.0], "negate": 0, "occupied_thresh": 0.65,
    "free_thresh": 0.196,
}  # fmt: skip


def save(folder: Path, grays: np.ndarray, **facts: object) -> Path:
    """Write `lab.yaml` and `lab.pgm`; a fact that is `None` is left out."""
    height, width = grays.shape
    (folder / "lab.pgm").write_bytes(f"P5\n# by hand\n{width} {height}\n255\n".encode() + grays.tobytes())
    kept = {key: value for key, value in {**FACTS, **facts}.items() if value is not None}
    (folder / "lab.yaml").write_text("".join(f"{key}: {value}\n" for key, value in kept.items()))
    return folder / "lab.yaml"
