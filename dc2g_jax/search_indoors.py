"""Object searches indoors, and the simulated houses and camera for them."""

from dc2g_jax._src.mapping.simulator import render as render
from dc2g_jax._src.search_indoors.houses.dataset import indoor_house as indoor_house, indoor_houses as indoor_houses
from dc2g_jax._src.search_indoors.houses.worlds import scene as scene
from dc2g_jax._src.search_indoors.maps.camera import camera_pose as camera_pose, indoor_camera as indoor_camera
from dc2g_jax._src.search_indoors.search.online import OnlineSearcher as OnlineSearcher
