"""Images in narrow formats: kept narrow, used wide."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ataa_jax import formats, pipeline, resolve, segmentation, taa, types
from ataa_jax.fit import replay
from ataa_jax.fit.recording import Recorded

SIZE = (9, 11)


def images(seed=0):
    rng = np.random.default_rng(seed)

    def image(*channels):
        return jnp.asarray(rng.random((*SIZE, *channels)), jnp.float32)

    gbuffer = types.GBuffer(
        depth=image() + 1.0,
        motion=4.0 * image(2) - 2.0,
        motion_valid=jnp.ones(SIZE, bool),
        normal=image(3),
        object=jnp.zeros(SIZE, jnp.int32),
        material=jnp.zeros(SIZE, jnp.int32),
    )
    return image(3), image(3), gbuffer


def state(kept_as="float32"):
    color, _, gbuffer = images(seed=1)
    history = types.History(
        color=color.astype(kept_as),
        depth=gbuffer.depth.astype(kept_as),
        motion=gbuffer.motion.astype(kept_as),
        count=jnp.full(SIZE, 2.0, kept_as),
        valid=jnp.asarray(True),
    )
    held = types.Classification(mask=jnp.zeros(SIZE, jnp.uint32))
    return types.State(history=history, classification=held)


@pytest.mark.parametrize("kept_as", ["float16", "bfloat16"])
def test_stages_read_narrow_images_as_their_values_in_float32(kept_as):
    color, _, gbuffer = images()
    config, params = pipeline.preset("tuned", None, SIZE)
    narrow = state(kept_as)
    results = []
    for each in (narrow, formats.widen(narrow)):
        blended = taa.taa(
            each.history, color, gbuffer, jnp.zeros(2), params.taa, config=config.taa
        )
        found = segmentation.segmentation(
            each, color, gbuffer, blended.reprojected, params.segmentation,
            config=config.segmentation, blended=blended.color,
        )  # fmt: skip
        results.append((blended, found))
    jax.tree.map(np.testing.assert_array_equal, *results)
    assert results[0][0].color.dtype == jnp.float32


@pytest.mark.parametrize("kept_as", ["float16", "bfloat16", "float32"])
def test_a_sequence_keeps_its_history_in_the_format_asked_for(kept_as):
    config, params = pipeline.preset("tuned", None, SIZE)
    config = replace(config, resolve=resolve.Config(history=kept_as))
    color, traced, gbuffer = images()
    frame = Recorded(
        color=color,
        gbuffer=gbuffer,
        traced=traced,
        truth=color,
        jitter=jnp.zeros(2),
        cut=jnp.asarray(False),
    )
    start = pipeline.init(SIZE, kept_as)
    after, _, _, composite = replay.composed(
        start, frame, params, config=config,
        choose=replay.by_criteria(config.segmentation),
    )  # fmt: skip
    same = jax.tree.map(
        lambda a, b: (a.dtype, a.shape) == (b.dtype, b.shape), start, after
    )
    assert all(jax.tree.leaves(same)), "the next frame would compile anew"
    step = float(jnp.finfo(kept_as).eps)
    np.testing.assert_allclose(
        after.history.color.astype(jnp.float32), composite, rtol=step
    )


def test_narrowing_saturates_and_keeps_what_is_not_finite():
    values = jnp.asarray([1e30, -1e30, jnp.inf, -jnp.inf, jnp.nan, 0.5, 65504.0])
    kept = np.asarray(formats.narrow(values, "float16"), np.float32)
    expected = [65504.0, -65504.0, np.inf, -np.inf, np.nan, 0.5, 65504.0]
    np.testing.assert_array_equal(kept, np.float32(expected))
    assert formats.narrow(values, "bfloat16").dtype == jnp.bfloat16
    ids = {"object": jnp.arange(3), "half": jnp.zeros(3, jnp.float16)}
    wide = formats.widen(ids)
    assert wide["object"].dtype == ids["object"].dtype
    assert wide["half"].dtype == jnp.float32
