"""Houses, maps and starts."""

from dc2g_jax._src.files.class_images import read_palette as read_palette
from dc2g_jax._src.readers.houses import (
    PROCEDURAL as PROCEDURAL,
    House as House,
    HouseDataset as HouseDataset,
    open_dataset as open_dataset,
    stack_worlds as stack_worlds,
    tell_on_stderr as tell_on_stderr,
)
from dc2g_jax._src.readers.maps import (
    CELLS_FILE as CELLS_FILE,
    SPLITS as SPLITS,
    draw_map as draw_map,
    map_from_classes as map_from_classes,
    read_map as read_map,
    sampled as sampled,
)
from dc2g_jax._src.readers.starts import (
    Start as Start,
    check_starts as check_starts,
    published_episodes as published_episodes,
    sample_starts as sample_starts,
    usable_houses as usable_houses,
    why_no_episode as why_no_episode,
)
