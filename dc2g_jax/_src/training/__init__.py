"""Training of cost-to-go networks: data, losses, steps, sweeps. It needs the extra `all`."""

from dc2g_jax._src.runtime.errors import require_extra

require_extra("cv2", "orbax")
