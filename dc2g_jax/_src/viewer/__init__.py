"""Recordings for the rerun viewer. They need the extra `all`."""

from dc2g_jax._src.runtime.errors import require_extra

require_extra("cv2", "matplotlib", "rerun")
