"""A replay of a recording against the pipeline that traces its rays."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from ataa_jax import pipeline, world
from ataa_jax.errors import InputError
from ataa_jax.fit import recording as record
from ataa_jax.fit import replay, score
from ataa_jax.types import METHOD_ATAA

SIZE = (45, 80)


@pytest.fixture(scope="module")
def shot():
    return world.shot(world.load("builtin"), "walk", SIZE)


@pytest.fixture(scope="module")
def recording(shot, tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ATAA_CACHE", str(tmp_path_factory.mktemp("cache")))
        return record.record(shot, frames=3, lead_in=0, reference_samples=2)


def test_a_replay_gives_the_same_masks_and_images_as_the_pipeline(shot, recording):
    config, params = recording.config, recording.params
    played = replay.play(
        recording.frames,
        params,
        config=replay.replayable(config),
        choose=replay.by_criteria(config.segmentation),
    )
    live = [out for out, _ in pipeline.sequence(shot, params, config=config, frames=3)]
    traced = [int(out.statistics.ataa_pixels) for out in live]
    assert max(traced) > 100, "nothing was traced: the test shows nothing"
    for index, out in enumerate(live):
        method = np.asarray(out.segmentation.mask) & 0xFFFF
        np.testing.assert_array_equal(np.asarray(played.method[index]), method)
        # Programs compiled apart may round differently; in sRGB a step of 2⁻²³ near
        # black grows by the slope 12.92, over three frames.
        np.testing.assert_allclose(
            np.asarray(played.image[index]), np.asarray(out.image), rtol=0, atol=1e-5
        )


def test_the_replay_counts_the_rays_that_the_mask_asks_for(recording):
    played = replay.play(
        recording.frames,
        recording.params,
        config=replay.replayable(recording.config),
        choose=replay.by_criteria(recording.config.segmentation),
    )
    counted = np.sum(np.asarray(played.method) == METHOD_ATAA, axis=(1, 2))
    np.testing.assert_array_equal(np.asarray(played.traced_pixels), counted)
    expected = counted.mean() * 8 / (SIZE[0] * SIZE[1])
    assert score.rays(replay.Take.of(recording), played) == pytest.approx(expected)


def test_a_second_recording_comes_from_the_cache_bit_by_bit(
    shot, monkeypatch, tmp_path
):
    monkeypatch.setenv("ATAA_CACHE", str(tmp_path))
    first = record.record(shot, frames=1, lead_in=1, reference_samples=1)

    def fail(*args, **kwargs):
        raise AssertionError("rendered anew")

    monkeypatch.setattr(record, "_render", fail)
    second = record.record(shot, frames=1, lead_in=1, reference_samples=1)
    assert eqx.tree_equal(first.frames, second.frames)


def test_a_damaged_cache_file_is_rendered_anew(shot, monkeypatch, tmp_path):
    monkeypatch.setenv("ATAA_CACHE", str(tmp_path))
    first = record.record(shot, frames=1, lead_in=0, reference_samples=1)
    for file in (tmp_path / "record").glob("*.npz"):
        file.write_bytes(file.read_bytes()[:100])
    second = record.record(shot, frames=1, lead_in=0, reference_samples=1)
    assert eqx.tree_equal(first.frames, second.frames)


def test_no_frames_are_refused(shot):
    with pytest.raises(InputError, match="at least 1 frame"):
        record.record(shot, frames=0)


def test_the_lead_in_is_not_scored(recording):
    assert jnp.all(recording.frames.cut == jnp.array([True, False, False]))
    assert recording.truth.shape == (3, *SIZE, 3)
