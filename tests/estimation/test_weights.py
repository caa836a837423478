"""Arrays in a file of the safetensors format."""

import contextlib
import json
import struct

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax.traverse_util import flatten_dict
from jax.sharding import PartitionSpec as P

from dc2g_jax._src.estimation.compact_unet import Architecture, CompactUNet, multiply_accumulates
from dc2g_jax._src.estimation.weights import read_safetensors, shapes_of_weights, write_safetensors
from dc2g_jax._src.runtime.errors import InputError
from tests.support.refusals import refusal


def test_a_file_made_by_hand_is_read(tmp_path):
    path = tmp_path / "hand.safetensors"
    header = {
        "a": {"dtype": "F16", "shape": [2, 1], "data_offsets": [0, 4]},
        "b": {"dtype": "I32", "shape": [], "data_offsets": [4, 8]},
    }
    text = json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + struct.pack("<eei", 1.5, -2.0, 7))
    tensors = read_safetensors(path)
    assert tensors["a"].tolist() == [[1.5], [-2.0]]
    assert tensors["a"].dtype == np.float16
    assert tensors["b"].tolist() == 7


def test_what_is_written_is_read(tmp_path):
    path = tmp_path / "all.safetensors"
    tree = {"a": {"b": np.arange(6, dtype=np.uint8).reshape(3, 2).T}, "c": np.asarray(jnp.asarray([1.5], jnp.bfloat16))}
    write_safetensors(path, tree)
    tensors = read_safetensors(path)
    assert list(tensors) == ["a.b", "c"]
    for name, array in flatten_dict(tree, sep=".").items():
        assert tensors[name].dtype == array.dtype
        np.testing.assert_array_equal(tensors[name], array)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_what_is_written_twice_has_the_same_bytes(tmp_path):
    for number in range(10):
        write_safetensors(tmp_path / str(number), {name: np.arange(3.0) for name in "zxy"})
    assert len({path.read_bytes() for path in tmp_path.iterdir()}) == 1


def test_what_is_written_cannot_change_without_notice(tmp_path):
    path = tmp_path / "a.safetensors"
    arrays = {"boards": np.arange(6, dtype=np.uint32).reshape(2, 3), "world": np.array([0, 1])}
    write_safetensors(path, arrays)
    whole = path.read_bytes()
    for position in range(len(whole)):
        path.write_bytes(whole[:position] + bytes([whole[position] ^ 0x10]) + whole[position + 1 :])
        with contextlib.suppress(InputError):  # only what is no part of the arrays may change
            found = read_safetensors(path)
            assert found.keys() == arrays.keys()
            for name, array in found.items():
                assert array.dtype == arrays[name].dtype
                np.testing.assert_array_equal(array, arrays[name])


@pytest.mark.parametrize(
    ("entry", "mention"),
    [
        ({"dtype": "F32", "shape": [3], "data_offsets": [0, 8]}, "invalid shape"),
        ({"dtype": "F32", "shape": [2], "data_offsets": [4, 12]}, "invalid offset"),
        ({"dtype": "F32", "shape": [-2], "data_offsets": [8, 0]}, "`-2`"),
        ({"dtype": "Q7", "shape": [2], "data_offsets": [0, 8]}, "Q7"),
        ({"dtype": "F8_E4M3", "shape": [8], "data_offsets": [0, 8]}, "cannot be read"),
        ("no entry", "no entry"),
    ],
)
def test_damaged_entries_are_refused(tmp_path, entry, mention):
    path = tmp_path / "bad.safetensors"
    text = json.dumps({"a": entry}).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + bytes(8))
    refusal(lambda: read_safetensors(path), path, mention)


@pytest.mark.parametrize("content", [b"", b"1234567", struct.pack("<Q", 1 << 60) + b"{}", struct.pack("<Q", 2) + b"[]"])
def test_files_without_a_header_are_refused(tmp_path, content):
    path = tmp_path / "bad.safetensors"
    path.write_bytes(content)
    refusal(lambda: read_safetensors(path), path, "header")


def test_what_is_no_file_is_refused(tmp_path):
    refusal(lambda: read_safetensors(tmp_path / "missing"), tmp_path / "missing", "no such file")
    refusal(lambda: read_safetensors(tmp_path), tmp_path, "cannot be read")


def test_shapes_found_inside_a_sharded_program_are_good_outside_of_it():
    architecture = Architecture(widths=(2, 2, 2, 3))  # of no other test: structures are found once

    def shapes_are_found(x):
        shapes_of_weights(CompactUNet, architecture)
        return x

    mesh = jax.make_mesh((1,), ("one",), devices=jax.devices()[:1])
    jax.jit(jax.shard_map(shapes_are_found, mesh=mesh, in_specs=P(), out_specs=P()))(jnp.zeros(1))
    assert multiply_accumulates(architecture, 16, 16) > 0
