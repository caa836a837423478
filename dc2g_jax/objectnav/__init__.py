"""Object goals indoors: houses, the map of what stands in them, the cost of the way to it, and control.

They need the extra `all`.
"""

from dc2g_jax.errors import require_extra

require_extra("cv2")
