"""Figures, animations, and the replays that they show. They need the extra `all`."""

from dc2g_jax._src.runtime.errors import require_extra

require_extra("cv2", "matplotlib")
