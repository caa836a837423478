"""More classes than there are today: each limit on their number gives way or says so."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import jax.numpy as jnp
import numpy as np
import pytest

import dc2g_jax._src.grid.world
import dc2g_jax.grid
import dc2g_jax.indoor.maps.classes
import dc2g_jax.indoor.maps.mapping
import dc2g_jax.robot.mapping.semantic_map
from dc2g_jax._src.grid import bitboard, terrain
from dc2g_jax.robot.mapping.camera import Frame, level_camera
from tests.support.frames import CAMERA, SETTINGS


def loaded(module: ModuleType, monkeypatch, replace: tuple[str, str] = ("", "")) -> ModuleType:
    """A module once more, from its source with one change, in the module's place until the test ends."""
    before, after = replace
    source = Path(module.__file__).read_text()
    assert before in source
    again = importlib.util.module_from_spec(importlib.util.spec_from_loader(module.__name__, loader=None))
    package, _, name = module.__name__.rpartition(".")
    monkeypatch.setitem(sys.modules, module.__name__, again)
    monkeypatch.setattr(sys.modules[package], name, again)
    exec(compile(source.replace(before, after, 1), module.__file__, "exec"), again.__dict__)
    return again


def with_classes(number: int, monkeypatch) -> ModuleType:
    """The terrain classes and more, so many in all."""
    numbers = range(len(terrain.CLASS_NAMES), number)
    more = "".join(f'    "class {index}": ((1, 2, {index}), "#000000"),\n' for index in numbers)
    classes = loaded(terrain, monkeypatch, ("}\n\n#: Class index -> name", more + "}\n\n#: Class index -> name"))
    loaded(dc2g_jax.grid, monkeypatch)  # clients import them from here
    return classes


@pytest.mark.parametrize("number", [17, 33, 254])
def test_a_semantic_map_holds_every_class(number, monkeypatch):
    assert len(with_classes(number, monkeypatch).CLASS_NAMES) == number
    semantic_map = loaded(dc2g_jax.robot.mapping.semantic_map, monkeypatch)
    settings = semantic_map.MapSettings(**vars(SETTINGS))
    ahead = level_camera(5.25, -4.25, 0.8, 0.0)
    shape = (CAMERA.height, CAMERA.width)
    for label in (1, 15, 16, number - 1):
        frame = Frame(jnp.full(shape, 1.3, jnp.float32), jnp.full(shape, label, jnp.uint8), ahead)
        known = semantic_map.empty_map(settings)
        for _ in range(2):
            known = semantic_map.integrate(known, frame, CAMERA, settings)
        assert (int(known.classes[2, 8, 13]), int(known.confidence[2, 8, 13])) == (label, 2)
        assert np.unique(semantic_map.terrain_map(known, settings)).tolist() == [0, label]


def test_a_semantic_map_takes_two_bytes_a_voxel():
    known = dc2g_jax.robot.mapping.semantic_map.empty_map(SETTINGS)
    assert known.log_odds.nbytes + known.votes.nbytes == 2 * np.prod(SETTINGS.shape)


@pytest.mark.parametrize("number", [17, 254])
def test_a_world_holds_every_class(number, monkeypatch):
    with_classes(number, monkeypatch)
    classes = np.arange(number, dtype=np.uint8)[None]
    world = loaded(dc2g_jax._src.grid.world, monkeypatch).World.from_terrain(classes)
    np.testing.assert_array_equal(world.terrain, classes)
    opaque = np.isin(classes, np.flatnonzero(terrain.OPAQUE))
    np.testing.assert_array_equal(bitboard.unpack(world.opaque, number), opaque)


def test_more_classes_than_fit_into_a_byte_are_refused(monkeypatch):
    with pytest.raises(AssertionError, match=r"^255 terrain classes do not fit into a byte$"):
        with_classes(255, monkeypatch)


def test_more_indoor_classes_than_bits_in_a_cell_are_refused(monkeypatch):
    monkeypatch.setattr(dc2g_jax.indoor.maps.classes, "SEMANTIC_CLASSES", 31)
    with pytest.raises(ValueError, match=r"^31 indoor classes.* enough for 16 classes; merge some$"):
        loaded(dc2g_jax.indoor.maps.mapping, monkeypatch)


def test_the_first_class_is_unknown_and_black():
    assert terrain.CLASS_NAMES[terrain.UNKNOWN] == "__ignore__"
    assert terrain.CLASS_COLORS[terrain.UNKNOWN].tolist() == [0, 0, 0]
    assert not terrain.TRAVERSABLE[terrain.UNKNOWN]
    assert not terrain.OPAQUE[terrain.UNKNOWN]


def test_constants_are_the_indices_of_the_classes():
    named = {name: getattr(terrain, name.upper().replace(" ", "_"), None) for name in terrain.CLASS_NAMES}
    indices = named | {"__ignore__": terrain.UNKNOWN, "traversable": terrain.FREE}
    assert list(indices.values()) == list(range(len(terrain.CLASS_NAMES)))


def test_every_class_has_a_color_of_its_own():
    assert len(np.unique(terrain.CLASS_COLORS, axis=0)) == len(terrain.CLASS_NAMES) == len(terrain.CLASS_COLORS)


def test_colors_are_those_of_the_published_images():
    """PASCAL VOC's: the bits of the index, dealt out to red, green and blue, the lowest to the highest bit of each."""
    for index, color in enumerate(terrain.CLASS_COLORS[:-1]):
        bits = [[(index >> (3 * place + channel)) & 1 for place in range(3)] for channel in range(3)]
        assert color.tolist() == [sum(bit << (7 - place) for place, bit in enumerate(own)) for own in bits]
    assert terrain.CLASS_COLORS[-1].tolist() == [255, 255, 255]
