"""Training is a function of its configuration alone, whatever interrupts it, and it learns."""

import contextlib
import dataclasses

import jax
import numpy as np
import pytest

from dc2g_jax._src.estimation.checkpoints import TrainingCheckpoints
from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.runtime.errors import InputError
from experiments.translator.training import TranslatorConfig
from tests.support.trainings import CASES, COST_TO_GO as CONFIG, first_state, train


def test_another_seed_gives_other_weights():
    other = first_state(dataclasses.replace(CONFIG, seed=1))
    assert not np.array_equal(other.weights["embed"]["kernel"], first_state(CONFIG).weights["embed"]["kernel"])


@pytest.mark.parametrize(
    ("change", "mention"),
    [({"seed": 1}, "seed"), ({"learning_rate": 1e-4}, "learning_rate"), ({"architecture": Architecture()}, "widths")],
)
def test_a_folder_with_another_configuration_is_refused(tmp_path, change, mention):
    folder = tmp_path / "run"
    TrainingCheckpoints(folder, CONFIG, first_state=first_state).close()
    with pytest.raises(InputError) as caught:
        TrainingCheckpoints(folder, dataclasses.replace(CONFIG, **change), first_state=first_state)
    message = str(caught.value)
    assert "\n" not in message
    assert str(folder) in message
    assert mention in message
    TrainingCheckpoints(folder, CONFIG, first_state=first_state).close()  # and is as it was


def test_a_folder_with_other_facts_is_refused(tmp_path):
    folder = tmp_path / "run"
    TrainingCheckpoints(folder, CONFIG, {"dataset": "houses", "extra": 3}, first_state=first_state).close()
    TrainingCheckpoints(folder, CONFIG, {"dataset": "houses", "extra": 3}, first_state=first_state).close()
    with pytest.raises(InputError, match=r"extra was 3 .*now 4"):
        TrainingCheckpoints(folder, CONFIG, {"dataset": "houses", "extra": 4}, first_state=first_state)


def test_a_damaged_configuration_is_refused(tmp_path):
    folder = tmp_path / "run"
    TrainingCheckpoints(folder, CONFIG, first_state=first_state).close()
    for content in ("{", "[1, 2]"):
        (folder / "config.json").write_text(content)
        with pytest.raises(InputError, match=r"config\.json"):
            TrainingCheckpoints(folder, CONFIG, first_state=first_state)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # Orbax's, closed after a failure
def test_a_state_that_cannot_be_read_is_refused(tmp_path):
    with contextlib.closing(TrainingCheckpoints(tmp_path, CONFIG, first_state=first_state)) as checkpoints:
        checkpoints.save(first_state(CONFIG))
    for manifest in (tmp_path / "states").rglob("manifest.ocdbt"):
        manifest.write_bytes(b"damaged")
    with contextlib.closing(TrainingCheckpoints(tmp_path, CONFIG, first_state=first_state)) as checkpoints:
        with pytest.raises(InputError, match=r"states/0: cannot be restored"):
            checkpoints.restore()
        checkpoints.delete()
        assert int(checkpoints.restore().step) == 0


@pytest.mark.parametrize(
    ("name", "value"),
    [("steps", 0), ("batch_size", 0), ("learning_rate", float("nan")), ("learning_rate", 0.0), ("seed", -1)],
)
def test_numbers_that_no_training_can_have_are_refused(name, value):
    with pytest.raises(InputError, match=f"{name.replace('_', ' ')} {value}"):
        dataclasses.replace(CONFIG, **{name: value})
    if name in ("batch_size", "learning_rate"):
        with pytest.raises(InputError, match=f"{name.replace('_', ' ')} {value}"):
            TranslatorConfig(**{name: value})


def test_the_average_follows_the_weights():
    state = first_state(CONFIG)
    wanted = jax.tree.leaves(jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), state.weights))
    for step in range(12):
        state, _ = train(CASES["cost_to_go"], 1, state)
        decay = min(CONFIG.average_decay, (1 + step) / (10 + step))
        wanted = [
            decay * average + (1 - decay) * np.asarray(weights)
            for average, weights in zip(wanted, jax.tree.leaves(state.weights), strict=True)
        ]
    for average, expected in zip(jax.tree.leaves(state.average), wanted, strict=True):
        np.testing.assert_allclose(average, expected, rtol=1e-4, atol=1e-6)
