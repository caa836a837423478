"""The memory of this process, where the system tells (Linux)."""

from pathlib import Path


def memory(field: str = "VmRSS") -> int:
    """Bytes of memory of this process, `VmRSS` now or `VmHWM` at most since the last reset; 0 where unknown."""
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return 0
    return 1024 * int(status.split(f"{field}:")[1].split()[0])


def forget_most_memory() -> None:
    """Reset `VmHWM`."""
    if Path("/proc/self/clear_refs").exists():
        Path("/proc/self/clear_refs").write_text("5")
