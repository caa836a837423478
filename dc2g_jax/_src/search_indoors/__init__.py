"""Object goals indoors: houses, semantic maps, costs of the path to an object, and control.

They need the extra `all`.
"""

from dc2g_jax._src.errors import require_extra

require_extra("cv2")
