"""The fit: threshold, relaxed loss, file, command, degenerate asks."""

import dataclasses
import json
import tomllib
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from ataa_jax import cli, parameters, pipeline, segmentation, terms, world
from ataa_jax import fit as fits
from ataa_jax.errors import InputError
from ataa_jax.fit import (
    relaxed,
    result,
    score,
    soft,
    solve,
    space,
    yardsticks,
)
from ataa_jax.fit.checkpoint import Checkpoints

SIZE = (24, 40)
TERMS = ("luminance", "depth", "response")
OPTIONS = fits.Options(terms=TERMS, steps=1, solver="bfgs")


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ATAA_CACHE", str(tmp_path_factory.mktemp("cache")))
        shot = world.shot(world.load("builtin"), "walk", SIZE)
        return fits.record(shot, frames=2, lead_in=1, reference_samples=4)


@pytest.fixture(scope="module")
def take(recording):
    plain = fits.Take.of(recording)
    return plain.under(space.switched(plain.config.segmentation, TERMS))


@pytest.fixture(scope="module")
def fitted(recording):
    return fits.fit([recording], OPTIONS, held_out=[recording])


def _pixels(dtype=jnp.float64, count=64):
    rng = np.random.default_rng(0)
    gain = rng.uniform(0.01, 1.0, count)
    cross = rng.normal(size=count) * 0.3
    return relaxed.Pixels(
        terms=jnp.asarray(rng.uniform(0.0, 1.0, (count, 3)), dtype),
        cross=jnp.asarray(cross, dtype),
        gain=jnp.asarray(gain, dtype),
        base=jnp.asarray(cross**2 / gain + 0.1, dtype),
    )


def _soft(dtype=jnp.float64, price=0.01):
    return relaxed.Soft(
        temperature=jnp.asarray(0.25, dtype),
        price=jnp.asarray(price, dtype),
        samples=jnp.asarray(8.0, dtype),
    )


def test_gradients_of_loss_and_residuals_agree_with_differences():
    with jax.enable_x64(True):
        args = (_pixels(), _soft())
        y = jnp.asarray([0.3, -0.4, -1.2])

        def loss(y):  # check_grads hands over NumPy arrays
            return relaxed.loss(jnp.asarray(y), args)

        def residuals(y):
            return jnp.concatenate(relaxed.residuals(jnp.asarray(y), args))

        check_grads(loss, (y,), order=2)
        check_grads(residuals, (y,), order=1)


def test_the_squares_of_the_residuals_are_the_loss_but_for_a_constant():
    with jax.enable_x64(True):
        pixels = _pixels()
        args = (pixels, _soft())
        constant = jnp.mean(pixels.base - pixels.cross**2 / pixels.gain)
        for y in ([0.0, 0.0, -1.0], [2.0, -3.0, 0.5]):
            error, price = relaxed.residuals(jnp.asarray(y), args)
            squares = jnp.sum(error**2) + jnp.sum(price**2) + constant
            # 1e-12 under the price's root, times price and samples.
            loss = float(relaxed.loss(jnp.asarray(y), args))
            assert float(squares) == pytest.approx(loss, rel=1e-9)


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_pixels_without_a_signal_and_masks_of_none_or_all_give_finite_gradients(value):
    pixels = _pixels(jnp.float32)
    flat = eqx.tree_at(
        lambda p: (p.terms, p.gain, p.cross),
        pixels,
        (
            jnp.full_like(pixels.terms, value),
            jnp.zeros_like(pixels.gain),
            jnp.zeros_like(pixels.cross),
        ),
    )
    for threshold in (-40.0, 0.0, 40.0):  # all traced, some, none
        y = jnp.asarray([0.0, 0.0, threshold], jnp.float32)
        for pixel in (pixels, flat):
            args = (pixel, _soft(jnp.float32))
            gradient = jax.grad(relaxed.loss)(y, args)
            columns = jax.jacfwd(relaxed.residuals)(y, args)
            assert all(jnp.all(jnp.isfinite(x)) for x in (gradient, *columns))


def test_terms_of_flat_depth_equal_luminance_and_sky_are_finite_with_their_gradients():
    color = jnp.full((5, 6, 3), 0.25)
    floor, contrast = jnp.float32(0.004), jnp.float32(0.03)
    cases = {
        "depth": (terms.depth_edge, (jnp.full((5, 6), 4.0),)),
        "sky": (terms.depth_edge, (jnp.full((5, 6), jnp.inf),)),
        "luminance": (lambda a, b: terms.luminance(a, b, floor), (color, color)),
        "response": (lambda a, b: terms.response(a, b, contrast), (color, color)),
    }
    for name, (term, operands) in cases.items():
        assert jnp.all(term(*operands) == 0.0), name
        if name in ("luminance", "response"):
            slope = jax.grad(lambda *a, term=term: jnp.sum(term(*a)))(*operands)
            assert jnp.all(jnp.isfinite(slope)), name


def test_the_response_is_the_distance_of_black_from_white_at_most():
    black, white = jnp.zeros((3, 4, 3)), jnp.full((3, 4, 3), 1e30)
    contrast = jnp.float32(0.03)
    np.testing.assert_allclose(terms.response(black, white, contrast), 1.0, rtol=1e-5)
    assert jnp.all(terms.response(white, white, contrast) == 0.0)


def test_the_same_error_counts_less_where_the_picture_is_busy():
    flat = jnp.full((5, 5, 3), 0.2)
    busy = flat * (1.0 + 0.5 * (-1.0) ** jnp.arange(25.0).reshape(5, 5, 1))
    contrast = jnp.float32(0.03)
    on_flat, on_busy = (
        terms.response(x * 1.2, x, contrast)[2, 2] for x in (flat, busy)
    )
    assert on_busy < 0.5 * on_flat
    wide = terms.response(busy * 1.2, busy, jnp.float32(1e3))[2, 2]
    assert wide > 0.9 * on_flat


def test_the_solved_threshold_spends_the_budget(take, recording):
    for budget in (0.25, 0.5, 2.0):
        solved = solve.threshold((take,), recording.params, jnp.float32(budget))
        at = space.with_threshold(
            recording.params, solved.threshold, take.config.segmentation
        )
        spent = score.as_is(take, at).rays
        assert spent == pytest.approx(float(solved.rays), rel=1e-6)
        # 5 %: within it budgets count as equal. One pixel of 960 is 0.0083 rays.
        assert spent == pytest.approx(budget, rel=0.05)


def test_only_ratios_of_the_weights_matter(take, recording):
    own = recording.params
    scaled = eqx.tree_at(
        lambda p: [getattr(p.segmentation, f"{t}_weight") for t in TERMS],
        own,
        [jnp.float32(4.0)] * 3,  # a power of two: the same bits
    )
    assert score.as_is(take, own) == score.as_is(take, scaled)


def test_coordinates_and_places_are_inverse():
    quantities = (*space.weights(TERMS), *space.KNOWN)
    _, params = pipeline.preset("tuned", None, (4, 4))
    u = jnp.asarray([0.1, 0.9, 0.4, 0.5, 0.3, 0.2, 0.7, 0.6])
    placed = space.place(params, quantities, u)
    back = space.coordinates(placed, quantities)
    np.testing.assert_allclose(back, u, atol=1e-5)  # float32 logarithms
    assert placed.segmentation.hold.dtype == jnp.int32


def test_the_folded_line_stays_in_the_unit_box_and_is_the_identity_inside():
    x = jnp.linspace(-3.0, 3.0, 61)
    assert jnp.all((space.free(x) >= 0.0) & (space.free(x) <= 1.0))
    inside = jnp.linspace(0.0, 1.0, 11)
    np.testing.assert_array_equal(space.free(inside), inside)


def test_both_readings_fire_by_one_threshold(take, recording):
    either = dataclasses.replace(take.config.segmentation, reading="either")
    solved = solve.threshold((take.under(either),), recording.params, jnp.float32(0.5))
    assert float(solved.rays) == pytest.approx(0.5, rel=0.05)


@pytest.mark.parametrize("solver", ["lm", "bfgs"])
def test_the_relaxed_fit_finds_the_term_that_tells_the_gain(solver):
    rng = np.random.default_rng(1)
    told = rng.uniform(size=4096)
    noise = rng.uniform(size=(4096, 2))
    gain = np.where(told > 0.8, 1.0, 0.01)
    pixels = relaxed.Pixels(
        terms=jnp.asarray(np.stack([noise[:, 0], told, noise[:, 1]], 1), jnp.float32),
        cross=jnp.asarray(-gain, jnp.float32),  # tracing is exact: e + d = 0
        gain=jnp.asarray(gain, jnp.float32),
        base=jnp.asarray(gain, jnp.float32),
    )
    points = jnp.asarray([[0.0, 0.0, -0.7]], jnp.float32)
    args = (pixels, _soft(jnp.float32, price=0.03))
    limits = soft.limits_of(space.weights(("luminance", "depth", "response")))
    found, losses, _ = soft.minimise(points, args, limits, solver=solver)
    assert losses[0] < relaxed.loss(points[0], args)
    assert found[0, 0] > 1.0
    assert found[0, 0] > found[0, 1] + 1.0
    # The first term tells nothing: the others would grow without end.
    assert jnp.all((found[0] >= limits[0]) & (found[0] <= limits[1]))
    assert losses[0] == pytest.approx(float(relaxed.loss(found[0], args)), rel=1e-5)


def test_the_oracle_is_above_chance_and_tracing_nothing_is_taa(take, recording):
    oracle = yardsticks.oracle(take, recording.params, 0.5)
    chance = yardsticks.random(take, recording.params, 0.5)
    taa = yardsticks.taa_alone(take, recording.params)
    assert oracle.ssim > chance.ssim
    assert oracle.ssim > taa.ssim
    assert oracle.rays == chance.rays == pytest.approx(0.5)
    assert taa.rays == 0.0


def test_the_same_seed_gives_the_same_bytes(fitted, recording, tmp_path):
    class KilledError(Exception):
        pass

    def kill(text, done, total):
        if text.startswith("relaxed"):
            raise KilledError

    def fit(**options):
        kept = Checkpoints(folder=tmp_path / "kept", key="fit")
        return fits.fit(
            [recording], OPTIONS, held_out=[recording], checkpoints=kept, **options
        )

    with pytest.raises(KilledError):
        fit(progress=kill)
    for name, found in (("calm", fitted), ("went on", fit()), ("repeated", fit())):
        result.write(found, {recording.name: "hash"}, tmp_path / name)
    calm = (tmp_path / "calm").read_bytes()
    assert (tmp_path / "went on").read_bytes() == calm
    assert (tmp_path / "repeated").read_bytes() == calm


def test_the_file_carries_the_lowest_threshold_and_no_frame_exceeds_the_budget(fitted):
    (standing,) = fitted.standings
    assert float(fitted.params.segmentation.threshold) == pytest.approx(
        standing.threshold, rel=1e-6
    )
    # Frames that ask for more than the mean are held to it; others ask for less.
    assert 0.0 < standing.carried_rays <= OPTIONS.budget + 1e-6


def test_a_fits_file_gives_back_its_numbers_choices_and_provenance(fitted, tmp_path):
    file = tmp_path / "p.toml"
    result.write(fitted, {"garden house:walk": "hash"}, file)
    table = parameters.read(file)
    _, preset = pipeline.preset("tuned", None, (4, 4))
    loaded = parameters.override(preset, table, "p")
    assert eqx.tree_equal(loaded.segmentation, fitted.params.segmentation)
    config = parameters.choices(table, segmentation.Config(), "p")
    assert config == fitted.config
    assert table["fit"]["scene"][0]["content"] == "hash"
    assert table["fit"]["versions"]["optimistix"]
    assert table["budget"] == loaded.budget == OPTIONS.budget


def test_unknown_choices_in_a_file_are_refused():
    config = segmentation.Config()
    for given, word in (
        ({"use_magic": True}, "unknown key"),
        ({"reading": "both"}, "one of sum, either"),
        ({"use_depth": 1}, "one of true, false"),
    ):
        with pytest.raises(InputError, match=word):
            parameters.choices({"choices": {"segmentation": given}}, config, "p")


@pytest.mark.parametrize("language", ["hlsl", "glsl", "json"])
def test_exported_weights_sum_to_one_and_name_the_threshold(fitted, tmp_path, language):
    file = tmp_path / "p.toml"
    result.write(fitted, {}, file)
    text = fits.export(parameters.read(file), language, "p.toml")
    shown = f"{float(str(np.float32(fitted.params.segmentation.threshold)))!r}"
    assert shown in text
    if language == "json":
        constants = json.loads(text)
        weights = [v for k, v in constants.items() if k.endswith("_weight")]
        assert sum(weights) == pytest.approx(1.0, rel=1e-6)
    else:
        assert "const float ATAA_THRESHOLD" in text
        assert ("f;" in text) == (language == "hlsl")


def test_unknown_engine_languages_are_refused():
    with pytest.raises(InputError, match="hlsl, glsl or json"):
        fits.export({}, "wgsl", "p.toml")


@pytest.mark.parametrize("budget", [0.0, -1.0, 8.5, float("nan"), float("inf")])
def test_budgets_that_no_mask_can_spend_are_refused(recording, budget):
    with pytest.raises(InputError, match="budget above 0 and at most 8"):
        fits.fit([recording], dataclasses.replace(OPTIONS, budget=budget))


def test_a_reference_of_another_size_is_refused(recording):
    frames = eqx.tree_at(
        lambda f: f.truth, recording.frames, recording.frames.truth[:, 1:]
    )
    wrong = dataclasses.replace(recording, frames=frames)
    with pytest.raises(InputError, match="same size"):
        fits.fit([wrong], OPTIONS)


def test_unknown_terms_and_no_scenes_are_refused(recording):
    with pytest.raises(InputError, match="unknown term 'magic'"):
        fits.fit([recording], dataclasses.replace(OPTIONS, terms=("magic",)))
    width = dataclasses.replace(OPTIONS, quantities=("taa.variance_gamma",))
    with pytest.raises(InputError, match="rectified by 'clip'"):
        fits.fit([recording], width)
    with pytest.raises(InputError, match="at least one scene"):
        fits.fit([], OPTIONS)


def test_the_width_of_a_variance_clip_is_fitted_where_there_is_one(recording):
    taa = dataclasses.replace(recording.config.taa, rectify="variance_clip")
    config = dataclasses.replace(recording.config, taa=taa)
    clipped = dataclasses.replace(recording, config=config)
    options = dataclasses.replace(
        OPTIONS, quantities=("taa.variance_gamma",), solver="none", steps=2
    )
    found = fits.fit([clipped], options)
    told = result.table(found, {})["taa"]["variance_gamma"]
    assert told == pytest.approx(float(found.params.taa.variance_gamma), rel=1e-5)
    narrow, wide = (
        score.at_budget(
            fits.Take.of(clipped),
            space.place(recording.params, (space.CLIP,), jnp.full(1, u)),
            0.5,
        ).ssim
        for u in (0.0, 1.0)
    )
    assert narrow != wide


def test_where_taa_is_exact_nothing_is_fitted_and_that_is_said(recording):
    flat = recording.frames
    grey = jnp.full_like(flat.color, 0.2)
    from ataa_jax import color as colors

    frames = eqx.tree_at(
        lambda f: (f.color, f.traced, f.truth),
        flat,
        (grey, grey, colors.display(grey)),
    )
    exact = dataclasses.replace(recording, frames=frames)
    found = fits.fit([exact], OPTIONS)
    assert "nothing was fitted" in found.notes[0]
    assert found.standings[0].fitted == pytest.approx(1.0, abs=1e-5)


def test_the_fitted_preset_is_the_file_that_the_experiment_wrote():
    table = parameters.read(Path(__file__).parents[1] / "data" / "fitted.toml")
    config, params = pipeline.preset("tuned", None, (4, 4))
    loaded = parameters.override(params, table, "fitted.toml")
    assert eqx.tree_equal(loaded.segmentation, params.segmentation)
    assert parameters.choices(table, segmentation.Config(), "f") == config.segmentation


def test_the_papers_preset_weighs_its_two_criteria_equally():
    config, params = pipeline.preset("paper", None, (4, 4))
    own = params.segmentation
    assert config.segmentation == segmentation.Config()
    assert float(own.luminance_weight) == float(own.depth_weight)
    assert config.raytrace.footprint == "level0"


TINY = [
    *("--size", "40x24", "--frames", "2", "--lead-in", "1"),
    *("--reference-samples", "2", "--solver", "none", "--steps", "0"),
]


def test_a_fit_writes_its_file_and_exports_it(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("ATAA_CACHE", str(tmp_path / "cache"))
    file = tmp_path / "a.toml"
    assert cli.main(["fit", "builtin", *TINY, "-o", str(file)]) == 0
    table = tomllib.loads(file.read_text())
    assert table["fit"]["frames"] == 2
    assert len(table["fit"]["scene"][0]["content"]) == 40
    capsys.readouterr()
    assert cli.main(["export", str(file), "--to", "hlsl"]) == 0
    shown = capsys.readouterr().out
    assert f"ATAA_THRESHOLD = {table['segmentation']['threshold']!r}f;" in shown
    out = tmp_path / "c.glsl"
    assert cli.main(["export", str(file), "--to", "glsl", "-o", str(out)]) == 0
    assert out.read_text().count("const ") == shown.count("const ")
