"""Options, output folders and the frame of a command, for packages that add commands to `dc2g` (extra `all`)."""

from dc2g_jax._src.cli.common import (
    DatasetOption as DatasetOption,
    ImageSizeOption as ImageSizeOption,
    PlannersOption as PlannersOption,
    check_planners as check_planners,
    command_line as command_line,
)
from dc2g_jax._src.cli.map_options import StartOption as StartOption, start_in as start_in
from dc2g_jax._src.cli.options import (
    DatasetOptions as DatasetOptions,
    NetworkOptions as NetworkOptions,
    OptionalInt as OptionalInt,
    OutOptions as OutOptions,
    TrainingOptions as TrainingOptions,
    require_positive as require_positive,
)
from dc2g_jax._src.cli.outputs import (
    CommandOptions as CommandOptions,
    command_written as command_written,
    commit as commit,
    output_folder as output_folder,
    print_files as print_files,
)
from dc2g_jax._src.runtime.errors import check_seed as check_seed
