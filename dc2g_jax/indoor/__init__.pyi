"""The public names and the modules that define them; `__init__.py` imports each when it is first used."""

from .houses.dataset import (
    floor_plan_dataset as floor_plan_dataset,
    indoor_house as indoor_house,
    indoor_houses as indoor_houses,
)
from .houses.worlds import scene as scene
from .maps.camera import camera_pose as camera_pose, indoor_camera as indoor_camera
from .search.evaluation import results_of as results_of
from .search.guides import agent_with as agent_with
from .search.online import OnlineSearcher as OnlineSearcher
from .search.searches import sample_episodes as sample_episodes, search_all as search_all
