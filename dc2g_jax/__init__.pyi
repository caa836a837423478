"""The public names and the modules that define them; `__init__.py` imports each when it is first used."""

# Make, run, compare.
from .planning.named import make as make
from .planning.named import PLANNERS as PLANNERS
from .rollouts.evaluation import evaluate as evaluate
from .rollouts.evaluation import Results as Results
from .rollouts.evaluation import EpisodeResult as EpisodeResult
from .training.train import train as train
from .training.cost_to_go import TrainingConfig as TrainingConfig
from .training.cost_to_go_data import DataConfig as DataConfig
from .inspection.figures import plot_results as plot_results
from .planning.online import OnlinePlanner as OnlinePlanner
from .planning.decisions import Decision as Decision
from .planning.metric import MetricPlanner as MetricPlanner
from .planning.metric_map import MetricMap as MetricMap
from .grid.map_frame import MapFrame as MapFrame
from .objectnav.online import OnlineSearcher as OnlineSearcher
from .environments.task import make_env as make_env
from .rollouts.devices import use_cores as use_cores
from .estimation.hub import load as load
from .estimation.hub import push as push

# Write a planner or an estimator.
from .planning.planners import Planner as Planner
from .planning.planners import Plan as Plan
from .estimation.estimators import Estimator as Estimator
from .rollouts.checks import check_planner as check_planner
from .rollouts.checks import check_estimator as check_estimator
from .planning.rules import Rules as Rules
from .planning.rules import SETTINGS as SETTINGS
from .programs import jit as jit

# Houses and starts.
from .datasets.houses import open_dataset as open_dataset
from .datasets.houses import procedural_dataset as procedural_dataset
from .datasets.maps import read_map as read_map
from .datasets.starts import sample_starts as sample_starts
from .datasets.houses import HouseDataset as HouseDataset
from .datasets.houses import House as House
from .datasets.starts import Start as Start

# The gridworld.
from .grid.world import World as World
from .grid.world import world_from_terrain as world_from_terrain
from .grid.gridworld import Belief as Belief
from .grid.gridworld import reset as reset
from .grid.gridworld import step as step
from .grid.poses import make_pose as make_pose
from .rollouts.rollout import rollout as rollout
from .errors import InputError as InputError

__version__: str
