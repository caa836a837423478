"""Houses, maps and starts."""

from dc2g_jax._src.files.class_images import read_palette as read_palette
from dc2g_jax._src.procedural import procedural_training_houses as procedural_training_houses
from dc2g_jax._src.procedural.plain import plain_maps as plain_maps
from dc2g_jax._src.readers.houses import (
    House as House,
    HouseDataset as HouseDataset,
    open_dataset as open_dataset,
    procedural_dataset as procedural_dataset,
    stack_worlds as stack_worlds,
)
from dc2g_jax._src.readers.maps import map_from_classes as map_from_classes, read_map as read_map
from dc2g_jax._src.readers.starts import (
    PublishedEpisode as PublishedEpisode,
    Start as Start,
    published_episodes as published_episodes,
    sample_starts as sample_starts,
    why_no_episode as why_no_episode,
)
