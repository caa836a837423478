"""The public names and the modules that define them; `__init__.py` imports each when it is first used."""

# Make, run, compare.
from ._src.planning.named import make_planner as make_planner, PLANNERS as PLANNERS
from ._src.rollouts.evaluation import evaluate as evaluate
from ._src.rollouts.results import Results as Results, EpisodeResult as EpisodeResult
from ._src.training.train import train as train
from ._src.training.sweeps import sweep as sweep
from ._src.training.sweeps import Sweep as Sweep
from ._src.training.cost_to_go import TrainingConfig as TrainingConfig
from ._src.training.cost_to_go_data import DataConfig as DataConfig
from ._src.figures.results_figures import plot_results as plot_results
from ._src.figures.training_figures import plot_sweep as plot_sweep
from ._src.planning.online import OnlinePlanner as OnlinePlanner
from ._src.planning.decisions import Decision as Decision
from ._src.planning.metric import MetricPlanner as MetricPlanner
from ._src.planning.metric_map import MetricMap as MetricMap
from ._src.environments.functional import make_env as make_env
from ._src.runtime.devices import use_cores as use_cores
from ._src.estimation.hub import load_network as load_network

# Write a planner or an estimator.
from ._src.planning.planners import Planner as Planner, Plan as Plan, Frontier as Frontier, DC2G as DC2G
from ._src.estimation.estimators import Estimator as Estimator
from ._src.rollouts.checks import check_planner as check_planner, check_estimator as check_estimator
from ._src.planning.rules import Rules as Rules, SETTINGS as SETTINGS

# Houses and starts.
from ._src.readers.houses import open_dataset as open_dataset
from ._src.readers.maps import read_map as read_map
from ._src.readers.starts import sample_starts as sample_starts
from ._src.readers.houses import HouseDataset as HouseDataset, House as House
from ._src.readers.starts import Start as Start

# The gridworld.
from ._src.grid.world import World as World
from ._src.grid.gridworld import Belief as Belief, reset as reset, step as step
from ._src.grid.poses import make_pose as make_pose
from ._src.rollouts.rollout import rollout as rollout
from ._src.runtime.errors import InputError as InputError

# More, in modules.
from . import commands as commands
from . import datasets as datasets
from . import environments as environments
from . import estimation as estimation
from . import files as files
from . import grid as grid
from . import inspection as inspection
from . import planning as planning
from . import rollouts as rollouts
from . import runtime as runtime
from . import training as training

__version__: str
