"""A damaged file of weights is refused by name; files of before are read as they are."""

from __future__ import annotations

import json
from pathlib import Path
from random import Random

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from envs.door.definition import TASK
from pipeline.files.sums import DamagedError
from pipeline.policy import FRAMES, MADE, WEIGHTS, load_policy, save_weights
from pipeline.run_dir import load_recipe, save_recipe
from tests.faults.damaging import empty, truncate
from tests.pipeline.resuming import differences

POLICIES = sorted(path.parent for path in Path("docs/results/policies").rglob(WEIGHTS))


@pytest.fixture
def exported(finished: Path, tmp_path: Path) -> Path:
    recipe = load_recipe(finished)
    save_recipe(tmp_path, recipe)
    policy, _ = load_policy(recipe, TASK, finished)
    save_weights(policy, tmp_path / WEIGHTS, frames=40)
    return tmp_path


def read(folder: Path) -> tuple[dict[str, torch.Tensor], int]:
    recipe = load_recipe(folder)
    policy, origin = load_policy(recipe, recipe.find_task(), folder)
    return policy.state_dict(), origin.frames


def rewritten(path: Path, *, digest: bool, **changes: float) -> None:
    """With other first numbers of tensors."""
    with safe_open(path, framework="pt") as file:
        metadata = dict(file.metadata())
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    for name, value in changes.items():
        tensors[name].view(-1)[0] = value
    if not digest:  # as before there were checksums
        metadata = {FRAMES: str(json.loads(metadata[MADE])[FRAMES])}
    save_file(tensors, path, metadata=metadata)


def a_weight(folder: Path) -> str:
    return next(name for name in read(folder)[0] if name.endswith("weight"))


def test_what_was_saved_is_what_is_loaded(exported: Path, finished: Path):
    saved, frames = read(exported)
    assert frames == 40
    assert differences(saved, read(finished)[0]) == []
    assert sorted(path.name for path in exported.iterdir()) == ["config.yaml", WEIGHTS]


def test_another_number_is_refused(exported: Path):
    rewritten(exported / WEIGHTS, digest=True, **{a_weight(exported): 0.25})
    with pytest.raises(DamagedError, match=rf"{exported / WEIGHTS}: is not as it was written"):
        read(exported)


@pytest.mark.parametrize("digest", [True, False])
def test_nan_is_refused(digest: bool, exported: Path):
    name = a_weight(exported)
    rewritten(exported / WEIGHTS, digest=digest, **{name: float("nan")})
    with pytest.raises(DamagedError, match=rf"{exported / WEIGHTS}: {name} of its policy holds"):
        read(exported)


@pytest.mark.parametrize("kind", [truncate, empty])
def test_a_file_that_lost_its_end_is_refused(kind, exported: Path):
    kind(exported / WEIGHTS, Random(0))
    with pytest.raises(ValueError, match=rf"{exported / WEIGHTS} is damaged"):
        read(exported)


def test_no_flipped_bit_acts_otherwise(exported: Path):
    path, rng = exported / WEIGHTS, Random(0)
    expected, whole = read(exported), path.read_bytes()
    header = 8 + int.from_bytes(whole[:8], "little")
    refused = []
    for turn in range(60):
        content = bytearray(whole)
        # Half of them in the header, which is a small part of the file.
        content[rng.randrange(header if turn % 2 else len(content))] ^= 1 << rng.randrange(8)
        path.write_bytes(content)
        try:
            found = read(exported)
        except ValueError as error:
            refused.append(str(error))
        else:  # a space between two tokens of JSON
            assert found[1] == expected[1]
            assert differences(found[0], expected[0]) == []
    assert len(refused) > 50
    assert all(str(path) in message for message in refused)


def test_files_of_before_are_read_without_a_checksum(exported: Path):
    expected = read(exported)
    rewritten(exported / WEIGHTS, digest=False)
    assert differences(read(exported)[0], expected[0]) == []


@pytest.mark.parametrize("folder", POLICIES, ids=str)
def test_published_policies_are_read(folder: Path):
    state, _ = read(folder)
    assert all(torch.isfinite(tensor).all() for tensor in state.values())


def test_there_are_published_policies():
    assert len(POLICIES) >= 11
