"""The public names and the modules that define them; `__init__.py` imports each when it is first used."""

from .driving.footprint import Ground as Ground, cell_at as cell_at
from .driving.mppi import (
    CostOfPose as CostOfPose,
    MPPISettings as MPPISettings,
    SampledPlans as SampledPlans,
    plan_controls as plan_controls,
    shifted_controls as shifted_controls,
)
from .driving.robot import (
    DRIVING as DRIVING,
    SimulatedRobot as SimulatedRobot,
    is_driving as is_driving,
    run_all as run_all,
    stopped_by_obstacles as stopped_by_obstacles,
)
from .driving.vehicle import (
    CONTROL_PERIOD as CONTROL_PERIOD,
    VehicleLimits as VehicleLimits,
    VehicleState as VehicleState,
    at_rest as at_rest,
    drive as drive,
    reachable_command as reachable_command,
    wrapped as wrapped,
)
from .mapping.camera import (
    CameraPose as CameraPose,
    Frame as Frame,
    Intrinsics as Intrinsics,
    check_shapes as check_shapes,
    intrinsics as intrinsics,
    level_camera as level_camera,
    points as points,
    rays as rays,
)
from .mapping.noise import (
    PAPER_LIKE as PAPER_LIKE,
    drift_on as drift_on,
    drifted as drifted,
    noisy_frame as noisy_frame,
)
from .mapping.scene import Scene as Scene, scene_from_heights as scene_from_heights
from .mapping.semantic_map import MapSettings as MapSettings
from .mapping.simulator import cast_all as cast_all, classes_of as classes_of, render as render

COMMANDS: dict[str, tuple[str, str]]
